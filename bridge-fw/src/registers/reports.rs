//! Counters and versions as input registers.

use super::events::{EVENT_LEN, EVENTS_KEPT, Events};
use super::rows::{Rows, assembled, count, report_rows};
use super::{RegisterError, Report, StoreReports};
use crate::arbiter::ControlSource;
use crate::config::BusConfig;
use wsg_protocol::frame;
use wsg_protocol::session::Session;

/// The address of the first of [`REPORTS`].
pub const FIRST_REPORT: u16 = 100;

/// The version of the register map: the last register or meaning that was added or changed.
pub const MAP_VERSION: u16 = 7;

report_rows! { ReportSource<'_> as it:
    100 "MAP_VERSION" "version of this register map" MAP_VERSION;
    101 "BRIDGE_VERSION" "high byte: major, low byte: minor version of the firmware"
        const {
            let [major, minor] = [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR")];
            u16::from_be_bytes([number(major), number(minor)])
        };
    102 "BRIDGE_PATCH" "patch level of the firmware"
        const { number(env!("CARGO_PKG_VERSION_PATCH")) }.into();
    103 "GRIPPER_TYPE" "the gripper's type (command set, 3.5.1); 0: unknown"
        it.session.known().info.map_or(0, |info| info.device.code().into());
    104 "GRIPPER_FIRMWARE" "its version, four digits (command set, 3.5.1); 0: unknown"
        it.session.known().info.map_or(0, |info| info.firmware.bits());
    105 "SERIAL_HIGH" "its serial number, bits 31 to 16" (it.serial_number() >> 16) as u16;
    106 "SERIAL_LOW" "its serial number, bits 15 to 0" it.serial_number() as u16;
    107 "GRIPPER_LINK" "0: has never answered, 1: is silent, 2: answers" it.link as u16;
    108 "COMMANDER" "who gave the last motion command: 0 nobody, 1 the wires, 2 the bus"
        it.control_source as u16;
    111 "LINE_DROPPED" "bytes of the gripper that belonged to no intact frame" it.line.dropped;
    112 "LINE_CHECKSUM" "frames of the gripper with a wrong checksum" it.line.bad_checksum;
    113 "LINE_OVERSIZE" "frames of the gripper that were too long" it.line.oversize;
    114 "UNASKED" "replies of the gripper that nobody asked for, or late ones"
        it.session.counters().unsolicited;
    115 "REFUSED" "replies of the gripper that the manual forbids" it.session.counters().refused;
    116 "REPEATED" "requests to the gripper that were sent again" it.session.counters().repeated;
    117 "DISCONNECTS" "how often the gripper fell silent" it.session.counters().disconnects;
    125 "BUS_TIMEOUTS" "how often the PLC that commanded was silent for too long" it.timeouts;
    132 "RESET_CAUSE" "why the bridge started: 0 unknown, 1 power-on or brown-out, 2 reset pin, 3 watchdog, 4 fault or panic of the firmware"
        it.reset_cause as u16;
    133 "ERROR_CAUSE" "why ERROR is high: the code of an event; 0: it is low" it.error_cause.into();
    134 "EVENTS" "how many events there were" it.events.count();
    135 "FAST_STOP_CAUSE" "why the last FAST STOP was: the code of an event; 0: there was none"
        it.events.fast_stop_register(0);
    136 "FAST_STOP_COMMAND" "the command that it ended, by its id; 0: none"
        it.events.fast_stop_register(1);
    137 "FAST_STOP_VALUE" "its value, see the table of events" it.events.fast_stop_register(2);
    138 "FAST_STOP_AGE" "how long ago it was asked for, in s" it.events.fast_stop_register(3);
    203 "SETTINGS_FROM" "where the settings are from: 0 the image, 1 stored, 2 stored by older firmware; refused, and the image's instead: 3 newer firmware's, 4 a wrong value, 5 damaged; 6 no flash"
        it.store.from as u16;
    204 "SAVE_STATE" "the last SAVE or DEFAULTS: 0 none since the start, 1 runs, 2 stored, 3 failed: what was stored before still is"
        it.store.save as u16;
    205 "SETTINGS_CHANGED" "1: a setting was changed and not stored" it.settings_are_changed.into();
    210 "COMMANDS_REFUSED" "commands of the PLC that the bridge refused, from wires and bus (events 30 to 34 and 39)"
        it.events.refusals();
}

report_rows! { BusConfig as it:
    109 "BUS_RATE" "rate of this bus in 100 bit/s"
        u16::try_from(it.baud / 100).unwrap_or(u16::MAX);
    110 "BUS_FORMAT" "format of this bus: 0 8E1, 1 8N1, 2 8N2" it.format as u16;
}

report_rows! { BusCounts as it:
    118 "BUS_MESSAGES" "intact frames on the bus (FC 8, 0Bh)" it.messages;
    119 "BUS_ERRORS" "broken ones (FC 8, 0Ch)" it.errors;
    120 "BUS_EXCEPTIONS" "exceptions (FC 8, 0Dh)" it.exceptions;
    121 "SERVER_MESSAGES" "frames for this unit, and broadcasts (FC 8, 0Eh)" it.own_messages;
    122 "NO_RESPONSES" "those of them without a response (FC 8, 0Fh)" it.no_responses;
    123 "SERVER_BUSY" "exceptions 06 (FC 8, 11h)" it.busy;
    124 "BUS_OVERRUNS" "frames with a damaged or lost character (FC 8, 12h)" it.overruns;
}

report_rows! { CanReports as it:
    126 "CAN_STATE" "CAN: 0 on the bus, 1 bus-off, 2 recovering, 3 given up; plus 128: error passive. Without CAN all of these are 0"
        it.0[0];
    127 "CAN_TEC" "CAN: transmit error counter" it.0[1];
    128 "CAN_REC" "CAN: receive error counter" it.0[2];
    129 "CAN_BUS_OFFS" "CAN: how often the controller went bus-off" it.0[3];
    130 "CAN_OVERRUNS" "CAN: frames for which the controller had no room" it.0[4];
    131 "CAN_DROPPED" "CAN: frames of the gripper that belonged to no intact message" it.0[5];
}

report_rows! { ProfibusReports as it:
    206 "PROFIBUS_STATE" "PROFIBUS: 0 it is not the PLC's bus, 1 no telegram is heard, 2 a master has to send parameters, 3 its configuration, 4 data exchange"
        it.0[0];
    207 "PROFIBUS_LINE" "PROFIBUS: the line's rate in 100 bit/s; with state 1 one that is tried"
        it.0[1];
    208 "PROFIBUS_TELEGRAMS" "PROFIBUS: intact telegrams, for whatever station" it.0[2];
    209 "PROFIBUS_DAMAGED" "PROFIBUS: what was no telegram, such as noise or one with a wrong check sum"
        it.0[3];
}

/// The register of the last event's code.
const FIRST_EVENT: u16 = 139;

/// The rows of the last events, by their numbers.
macro_rules! event_rows {
    ($first:literal $($number:literal)*) => {[
        event_rows!(@ $first
            "the last event: its code; 0: none. `EVENT2_CODE` to `EVENT16_AGE` behind these four are those before it"
            "the command concerned, by its id (command set, chapter 3); 0: none"
            "its value, see the table of events"
            "how long ago it was, in s"),
        $(event_rows!(@ $number "" "" "" "")),*
    ]};
    (@ $number:literal $code:literal $command:literal $value:literal $age:literal) => {[
        event_row($number, 0, concat!("EVENT", $number, "_CODE"), $code),
        event_row($number, 1, concat!("EVENT", $number, "_COMMAND"), $command),
        event_row($number, 2, concat!("EVENT", $number, "_VALUE"), $value),
        event_row($number, 3, concat!("EVENT", $number, "_AGE"), $age),
    ]};
}

const fn event_row(number: u16, field: u16, name: &'static str, meaning: &'static str) -> (u16, Report) {
    (FIRST_EVENT + (number - 1) * EVENT_LEN as u16 + field, Report { name, meaning })
}

const EVENT_ROWS: [[(u16, Report); EVENT_LEN]; EVENTS_KEPT] =
    event_rows!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16);

const PARTS: [Rows<Report>; 6] = [
    ReportSource::REPORTS,
    EVENT_ROWS.as_flattened(),
    BusConfig::REPORTS,
    BusCounts::REPORTS,
    CanReports::REPORTS,
    ProfibusReports::REPORTS,
];

/// The reports, from [`FIRST_REPORT`] on. Counters stop at 65 535.
pub const REPORTS: [Report; count(&PARTS)] = assembled(FIRST_REPORT, &PARTS);

/// Whether the gripper answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Link {
    /// It has not answered since power-up.
    #[default]
    Never,
    /// It answered, and does not any more.
    Silent,
    /// It does.
    Up,
}

/// Why the MCU was reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ResetCause {
    /// The board does not say.
    #[default]
    Unknown,
    /// Power-on, or a supply that was too low.
    PowerOn,
    /// The reset pin.
    Pin,
    /// The watchdog: the main loop did not come round, or not all of it.
    Watchdog,
    /// The firmware itself: a fault or a panic.
    Firmware,
}

/// What a PLC side has counted on its bus; a side that does not count something leaves it at 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounts {
    /// Intact messages on the bus, whoever they were for.
    pub messages: u16,
    /// Damaged messages.
    pub errors: u16,
    /// Requests that were refused.
    pub exceptions: u16,
    /// Messages for this device.
    pub own_messages: u16,
    /// Those of them that got no answer.
    pub no_responses: u16,
    /// Those of them that were put off.
    pub busy: u16,
    /// Messages that were lost because they were too long or came too fast.
    pub overruns: u16,
}

/// What the reports are about, at the moment of a request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReportSource<'a> {
    pub(crate) config: &'a BusConfig,
    pub(crate) session: &'a Session,
    pub(crate) link: Link,
    pub(crate) line: frame::FrameCounters,
    pub(crate) control_source: ControlSource,
    pub(crate) bus: BusCounts,
    pub(crate) timeouts: u16,
    pub(crate) can: &'a CanReports,
    pub(crate) profibus: &'a ProfibusReports,
    pub(crate) reset_cause: ResetCause,
    pub(crate) error_cause: u8,
    pub(crate) events: &'a Events,
    pub(crate) store: StoreReports,
    pub(crate) settings_are_changed: bool,
}

/// What is reported about CAN: state, transmit and receive errors, bus-offs, overruns, dropped frames, as registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CanReports(pub [u16; 6]);

impl CanReports {
    /// There is no CAN.
    pub const NONE: Self = Self([0; 6]);

    /// Whether the controller is off the bus: bus-off, recovering or given up.
    pub(crate) const fn is_off(&self) -> bool {
        self.0[0] & 0x7F != 0
    }

    /// How often the controller went bus-off.
    pub(crate) const fn bus_offs(&self) -> u16 {
        self.0[3]
    }
}

/// What is reported about PROFIBUS: state, rate of the line, intact telegrams, damaged ones, as registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ProfibusReports(pub [u16; 4]);

impl ProfibusReports {
    /// The PLC is not on PROFIBUS.
    pub const NONE: Self = Self([0; 4]);
}

impl ReportSource<'_> {
    /// The register at this address, counted from [`FIRST_REPORT`].
    pub(crate) fn register(&self, index: u16) -> Result<u16, RegisterError> {
        let register = FIRST_REPORT.checked_add(index).ok_or(RegisterError::Missing)?;
        self.report(register)
            .or_else(|| self.event(register))
            .or_else(|| self.config.report(register))
            .or_else(|| self.bus.report(register))
            .or_else(|| self.can.report(register))
            .or_else(|| self.profibus.report(register))
            .ok_or(RegisterError::Missing)
    }

    fn event(&self, register: u16) -> Option<u16> {
        let place = u8::try_from(register.checked_sub(FIRST_EVENT)?).ok()?;
        let (number, field) = (place / EVENT_LEN as u8, place % EVENT_LEN as u8);
        (usize::from(number) < EVENTS_KEPT).then(|| self.events.register(number, field))
    }

    fn serial_number(&self) -> u32 {
        self.session.known().info.map_or(0, |info| info.serial_number)
    }
}

/// The number that these digits are.
const fn number(digits: &str) -> u8 {
    match u8::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => 0,
    }
}
