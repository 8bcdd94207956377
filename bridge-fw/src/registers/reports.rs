//! Counters and versions as input registers.

use super::events::{EVENT_LEN, EVENTS_KEPT, Events};
use super::table::joined;
use super::{RegisterError, StoreReports};
use crate::arbiter::ControlSource;
use crate::config::BusConfig;
use wsg_protocol::frame;
use wsg_protocol::session::Session;

/// The address of the first of [`REPORTS`].
pub const FIRST_REPORT: u16 = 100;

/// The version of the register map: the last register or meaning that was added or changed.
pub const MAP_VERSION: u16 = 7;

/// An input register that reports on the bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Its name.
    pub name: &'static str,
    /// What it says.
    pub meaning: &'static str,
    subject: Subject,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    MapVersion,
    BridgeVersion,
    BridgePatch,
    GripperType,
    GripperFirmware,
    SerialNumberHigh,
    SerialNumberLow,
    GripperLink,
    Commander,
    Rate,
    Format,
    LineDropped,
    LineChecksum,
    LineOversize,
    Unsolicited,
    Refused,
    Repeated,
    Disconnects,
    BusMessages,
    BusErrors,
    BusExceptions,
    ServerMessages,
    NoResponses,
    Busy,
    Overruns,
    BusTimeouts,
    CanState,
    CanTransmitErrors,
    CanReceiveErrors,
    CanBusOffs,
    CanOverruns,
    CanDropped,
    ResetCause,
    ErrorCause,
    EventCount,
    /// A field of the last FAST STOP.
    FastStop(u8),
    /// A field of one of the last events.
    Event(u8, u8),
    SettingsFrom,
    SaveState,
    SettingsChanged,
    /// One of [`ProfibusReports`].
    Profibus(u8),
    CommandsRefused,
}

/// The names and meanings of the last events' registers, by their numbers.
macro_rules! event_reports {
    ($first:literal $($number:literal)*) => {[
        event_reports!(@ $first
            "the last event: its code; 0: none. `EVENT2_CODE` to `EVENT16_AGE` behind these four are those before it"
            "the command concerned, by its id (command set, chapter 3); 0: none"
            "its value, see the table of events"
            "how long ago it was, in s"),
        $(event_reports!(@ $number "" "" "" "")),*
    ]};
    (@ $number:literal $code:literal $command:literal $value:literal $age:literal) => {[
        report(concat!("EVENT", $number, "_CODE"), Subject::Event($number - 1, 0), $code),
        report(concat!("EVENT", $number, "_COMMAND"), Subject::Event($number - 1, 1), $command),
        report(concat!("EVENT", $number, "_VALUE"), Subject::Event($number - 1, 2), $value),
        report(concat!("EVENT", $number, "_AGE"), Subject::Event($number - 1, 3), $age),
    ]};
}

const EVENT_REPORTS: [[Report; EVENT_LEN]; EVENTS_KEPT] =
    event_reports!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16);

const fn report(name: &'static str, subject: Subject, meaning: &'static str) -> Report {
    Report { name, meaning, subject }
}

/// The reports, from [`FIRST_REPORT`] on. Counters stop at 65 535.
pub const REPORTS: [Report; BEFORE_EVENTS.len() + EVENTS_KEPT * EVENT_LEN + BEHIND_EVENTS.len()] =
    joined(BEFORE_EVENTS, EVENT_REPORTS, BEHIND_EVENTS);

/// What stands behind the events.
const BEHIND_EVENTS: [Report; 8] = [
    report(
        "SETTINGS_FROM",
        Subject::SettingsFrom,
        "where the settings are from: 0 the image, 1 stored, 2 stored by older firmware; refused, and the image's instead: 3 newer firmware's, 4 a wrong value, 5 damaged; 6 no flash",
    ),
    report(
        "SAVE_STATE",
        Subject::SaveState,
        "the last SAVE or DEFAULTS: 0 none since the start, 1 runs, 2 stored, 3 failed: what was stored before still is",
    ),
    report("SETTINGS_CHANGED", Subject::SettingsChanged, "1: a setting was changed and not stored"),
    report(
        "PROFIBUS_STATE",
        Subject::Profibus(0),
        "PROFIBUS: 0 it is not the PLC's bus, 1 no telegram is heard, 2 a master has to send parameters, 3 its configuration, 4 data exchange",
    ),
    report(
        "PROFIBUS_LINE",
        Subject::Profibus(1),
        "PROFIBUS: the line's rate in 100 bit/s; with state 1 one that is tried",
    ),
    report("PROFIBUS_TELEGRAMS", Subject::Profibus(2), "PROFIBUS: intact telegrams, for whatever station"),
    report(
        "PROFIBUS_DAMAGED",
        Subject::Profibus(3),
        "PROFIBUS: what was no telegram, such as noise or one with a wrong check sum",
    ),
    report(
        "COMMANDS_REFUSED",
        Subject::CommandsRefused,
        "commands of the PLC that the bridge refused, from wires and bus (events 30 to 34 and 39)",
    ),
];

/// What stands before them.
const BEFORE_EVENTS: [Report; 39] = [
    report("MAP_VERSION", Subject::MapVersion, "version of this register map"),
    report(
        "BRIDGE_VERSION",
        Subject::BridgeVersion,
        "high byte: major, low byte: minor version of the firmware",
    ),
    report("BRIDGE_PATCH", Subject::BridgePatch, "patch level of the firmware"),
    report("GRIPPER_TYPE", Subject::GripperType, "the gripper's type (command set, 3.5.1); 0: unknown"),
    report(
        "GRIPPER_FIRMWARE",
        Subject::GripperFirmware,
        "its version, four digits (command set, 3.5.1); 0: unknown",
    ),
    report("SERIAL_HIGH", Subject::SerialNumberHigh, "its serial number, bits 31 to 16"),
    report("SERIAL_LOW", Subject::SerialNumberLow, "its serial number, bits 15 to 0"),
    report("GRIPPER_LINK", Subject::GripperLink, "0: has never answered, 1: is silent, 2: answers"),
    report(
        "COMMANDER",
        Subject::Commander,
        "who gave the last motion command: 0 nobody, 1 the wires, 2 the bus",
    ),
    report("BUS_RATE", Subject::Rate, "rate of this bus in 100 bit/s"),
    report("BUS_FORMAT", Subject::Format, "format of this bus: 0 8E1, 1 8N1, 2 8N2"),
    report("LINE_DROPPED", Subject::LineDropped, "bytes of the gripper that belonged to no intact frame"),
    report("LINE_CHECKSUM", Subject::LineChecksum, "frames of the gripper with a wrong checksum"),
    report("LINE_OVERSIZE", Subject::LineOversize, "frames of the gripper that were too long"),
    report("UNASKED", Subject::Unsolicited, "replies of the gripper that nobody asked for, or late ones"),
    report("REFUSED", Subject::Refused, "replies of the gripper that the manual forbids"),
    report("REPEATED", Subject::Repeated, "requests to the gripper that were sent again"),
    report("DISCONNECTS", Subject::Disconnects, "how often the gripper fell silent"),
    report("BUS_MESSAGES", Subject::BusMessages, "intact frames on the bus (FC 8, 0Bh)"),
    report("BUS_ERRORS", Subject::BusErrors, "broken ones (FC 8, 0Ch)"),
    report("BUS_EXCEPTIONS", Subject::BusExceptions, "exceptions (FC 8, 0Dh)"),
    report("SERVER_MESSAGES", Subject::ServerMessages, "frames for this unit, and broadcasts (FC 8, 0Eh)"),
    report("NO_RESPONSES", Subject::NoResponses, "those of them without a response (FC 8, 0Fh)"),
    report("SERVER_BUSY", Subject::Busy, "exceptions 06 (FC 8, 11h)"),
    report("BUS_OVERRUNS", Subject::Overruns, "frames with a damaged or lost character (FC 8, 12h)"),
    report("BUS_TIMEOUTS", Subject::BusTimeouts, "how often the PLC that commanded was silent for too long"),
    report(
        "CAN_STATE",
        Subject::CanState,
        "CAN: 0 on the bus, 1 bus-off, 2 recovering, 3 given up; plus 128: error passive. Without CAN all of these are 0",
    ),
    report("CAN_TEC", Subject::CanTransmitErrors, "CAN: transmit error counter"),
    report("CAN_REC", Subject::CanReceiveErrors, "CAN: receive error counter"),
    report("CAN_BUS_OFFS", Subject::CanBusOffs, "CAN: how often the controller went bus-off"),
    report("CAN_OVERRUNS", Subject::CanOverruns, "CAN: frames for which the controller had no room"),
    report(
        "CAN_DROPPED",
        Subject::CanDropped,
        "CAN: frames of the gripper that belonged to no intact message",
    ),
    report(
        "RESET_CAUSE",
        Subject::ResetCause,
        "why the bridge started: 0 unknown, 1 power-on or brown-out, 2 reset pin, 3 watchdog, 4 fault or panic of the firmware",
    ),
    report("ERROR_CAUSE", Subject::ErrorCause, "why ERROR is high: the code of an event; 0: it is low"),
    report("EVENTS", Subject::EventCount, "how many events there were"),
    report(
        "FAST_STOP_CAUSE",
        Subject::FastStop(0),
        "why the last FAST STOP was: the code of an event; 0: there was none",
    ),
    report("FAST_STOP_COMMAND", Subject::FastStop(1), "the command that it ended, by its id; 0: none"),
    report("FAST_STOP_VALUE", Subject::FastStop(2), "its value, see the table of events"),
    report("FAST_STOP_AGE", Subject::FastStop(3), "how long ago it was asked for, in s"),
];

/// The subjects alone, so that the words of the table stay out of the image.
const SUBJECTS: [Subject; REPORTS.len()] = {
    let mut subjects = [Subject::MapVersion; REPORTS.len()];
    let mut at = 0;
    while at < REPORTS.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            subjects[at] = REPORTS[at].subject;
        }
        at += 1;
    }
    subjects
};

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
        let subject = *SUBJECTS.get(usize::from(index)).ok_or(RegisterError::Missing)?;
        let gripper = self.session.known().info;
        let serial_number = gripper.map_or(0, |info| info.serial_number);
        let (line, session) = (self.line, self.session.counters());
        Ok(match subject {
            Subject::MapVersion => MAP_VERSION,
            Subject::BridgeVersion => {
                const {
                    let [major, minor] = [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR")];
                    u16::from_be_bytes([number(major), number(minor)])
                }
            }
            Subject::BridgePatch => const { number(env!("CARGO_PKG_VERSION_PATCH")) }.into(),
            Subject::GripperType => gripper.map_or(0, |info| info.device.code().into()),
            Subject::GripperFirmware => gripper.map_or(0, |info| info.firmware.bits()),
            Subject::SerialNumberHigh => (serial_number >> 16) as u16,
            Subject::SerialNumberLow => serial_number as u16,
            Subject::GripperLink => self.link as u16,
            Subject::Commander => self.control_source as u16,
            Subject::Rate => u16::try_from(self.config.baud / 100).unwrap_or(u16::MAX),
            Subject::Format => self.config.format as u16,
            Subject::LineDropped => line.dropped,
            Subject::LineChecksum => line.bad_checksum,
            Subject::LineOversize => line.oversize,
            Subject::Unsolicited => session.unsolicited,
            Subject::Refused => session.refused,
            Subject::Repeated => session.repeated,
            Subject::Disconnects => session.disconnects,
            Subject::BusMessages => self.bus.messages,
            Subject::BusErrors => self.bus.errors,
            Subject::BusExceptions => self.bus.exceptions,
            Subject::ServerMessages => self.bus.own_messages,
            Subject::NoResponses => self.bus.no_responses,
            Subject::Busy => self.bus.busy,
            Subject::Overruns => self.bus.overruns,
            Subject::BusTimeouts => self.timeouts,
            Subject::CanState => self.can.0[0],
            Subject::CanTransmitErrors => self.can.0[1],
            Subject::CanReceiveErrors => self.can.0[2],
            Subject::CanBusOffs => self.can.0[3],
            Subject::CanOverruns => self.can.0[4],
            Subject::CanDropped => self.can.0[5],
            Subject::ResetCause => self.reset_cause as u16,
            Subject::ErrorCause => self.error_cause.into(),
            Subject::CommandsRefused => self.events.refusals(),
            Subject::EventCount => self.events.count(),
            Subject::FastStop(field) => self.events.fast_stop_register(field),
            Subject::Event(number, field) => self.events.register(number, field),
            Subject::SettingsFrom => self.store.from as u16,
            Subject::SaveState => self.store.save as u16,
            Subject::SettingsChanged => self.settings_are_changed.into(),
            Subject::Profibus(at) => self.profibus.0.get(usize::from(at)).copied().unwrap_or_default(),
        })
    }
}

/// The number that these digits are.
const fn number(digits: &str) -> u8 {
    match u8::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => 0,
    }
}
