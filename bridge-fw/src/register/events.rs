//! Event log: recent events, including the causes of ERROR and FAST STOP.

use core::hash::{Hash, Hasher};

use super::{Report, Rows};
use wsg_fieldbus::{Cause, Incident};
use wsg_protocol::{Instant, SystemFlags};

/// Text of an event, for documents and tools.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventText {
    /// Code in the event registers.
    pub code: EventCode,
    /// Name in the table of events.
    pub name: &'static str,
    /// The event in words.
    pub meaning: &'static str,
    /// Meaning of the event's value; empty if it has none.
    pub value: &'static str,
    /// Recommended action.
    pub remedy: &'static str,
}

macro_rules! define_events {
    ($($code:literal $variant:ident $name:literal $meaning:literal $value:literal $remedy:literal;)*) => {
        /// Code of an event.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum EventCode {
            $(#[doc = $meaning] $variant = $code,)*
        }

        /// All events, in the order of their codes.
        pub const EVENTS: [EventText; [$($code),*].len()] = [$(EventText {
            code: EventCode::$variant,
            name: $name,
            meaning: $meaning,
            value: $value,
            remedy: $remedy,
        }),*];
    };
}

define_events! {
    1 Start "START" "the bridge started" "RESET_CAUSE" "none; report a watchdog or firmware reset to the maintainers";
    10 Wire "FAST_STOP_WIRE" "FAST STOP: the wire FAST_STOP_OK was low" "" "find the cause, such as a broken wire; then STOP_ACK";
    11 BusFlag "FAST_STOP_FLAG" "FAST STOP: the bus wrote FASTSTOP = 1" "" "check the PLC program; write FASTSTOP 0, then STOP/ACK";
    12 ParameterChanged "PARAMETER_CHANGED" "FAST STOP: WIDTH, SPEED or FORCELIMIT changed while the fingers moved" "the new value" "change parameters only while the fingers are at rest";
    13 OutsideLimits "OUTSIDE_LIMITS" "FAST STOP: SPEED or FORCELIMIT is outside the gripper's limits" "the rejected value, in the register's unit" "stay within the limits of the gripper's data sheet; for recipes: RECIPEn_SPEED, RECIPEn_FORCE";
    14 PlcSilent "PLC_SILENT" "FAST STOP: the commanding PLC was silent and BUS_REACTION is 2, or no other stop was possible" "" "see BUS_SILENT";
    15 StopFailed "STOP_FAILED" "FAST STOP: a Stop was rejected or not answered while the fingers may have been moving" "its status" "check the gripper's line; then STOP/ACK";
    16 ConnectionLost "CONNECTION_LOST" "FAST STOP: the gripper stopped answering during a jog" "" "see GRIPPER_SILENT";
    17 UpdateRestart "UPDATE_RESTARTS" "FAST STOP: the bridge restarts with new firmware" "" "none; STOP/ACK after the restart";
    18 GripperFastStop "GRIPPER_FAST_STOP" "the gripper reports a FAST STOP that the bridge did not request" "" "check the gripper for a fault, another client, or a FAST STOP from before the bridge started; then STOP/ACK";
    30 NotConnected "NOT_CONNECTED" "a command was given while the gripper did not answer" "" "wait for LINK_OK";
    31 FastStopLasts "FAST_STOP_LASTS" "a command was given during FAST STOP, or STOP/ACK before the gripper confirmed it" "" "remove the cause, give an edge on STOP/ACK, then command";
    32 MotionRuns "MOTION_RUNS" "a motion was commanded while the fingers moved" "" "wait for the end of the motion, or STOP first";
    33 NotReady "NOT_READY" "a command wire rose while READY was low" "" "wait for READY";
    34 PartHeld "PART_HELD" "MOVE or a jog was commanded while a part was held" "" "RELEASE first";
    35 Refused "REFUSED" "the gripper rejected the command or ended it with an error" "its status" "see the status codes";
    36 Unanswered "UNANSWERED" "the gripper did not answer a command, which may have been executed" "" "check the line; check the finger position before the next command";
    37 Withdrawn "WITHDRAWN" "the command was withdrawn before it was sent, for example by a stop" "" "repeat the command";
    38 MovedAtStart "MOVED_AT_START" "the gripper moved when the bridge started, and was stopped" "" "check the finger position, then home";
    39 NotIdle "NOT_IDLE" "MOVE was commanded while GSTATE was NO_PART, PART_LOST or ERROR" "" "RELEASE first; after an error STOP/ACK";
    50 GripperSilent "GRIPPER_SILENT" "the gripper stopped answering" "" "check its supply, its line and its interface setting";
    51 TempFault "TEMP_FAULT" "the gripper is too hot" "" "let it cool down; use less force or fewer cycles";
    52 PowerFault "POWER_FAULT" "the gripper's supply is out of range" "" "check the supply";
    53 CurrFault "CURR_FAULT" "the gripper's motor drew too much current for too long" "" "wait until the flag clears; check for blocked fingers";
    54 FingerFault "FINGER_FAULT" "a finger reports a fault" "" "check the finger and its cable";
    60 BusSilent "BUS_SILENT" "the PLC that commanded over the bus was silent for BUS_TIMEOUT" "BUS_REACTION" "check the bus wiring and the master, or increase BUS_TIMEOUT";
    61 BusOff "BUS_OFF" "the CAN controller went bus-off" "" "check rate, termination and wiring of the CAN bus";
    70 SettingsRefused "SETTINGS_REFUSED" "the stored settings are unusable and the defaults apply: no motion is possible" "SETTINGS_FROM" "set the bridge up again and SAVE, or DEFAULTS";
    71 SaveFailed "SAVE_FAILED" "the settings were not stored; the previous ones are kept" "1 flash busy, 2 flash write-protected, 3 flash not erased, 4 another flash fault, 5 flash cannot be erased, 6 wrong data in flash, 7 save numbers used up" "SAVE again; if that fails too, the flash is worn or protected";
    72 UpdateRuns "UPDATE_RUNS" "an update began: no motion is possible until its end" "" "wait for the restart; an abandoned update ends after 5 s";
    73 UpdateRefused "UPDATE_REFUSED" "a block, a command or an image of an update was refused" "UPDATE_REFUSAL" "see the reason; the running firmware is kept";
}

impl EventCode {
    /// Returns the code for a cause of the controller. `flag` is the code of FASTSTOP.
    const fn of(cause: Cause, flag: Self) -> Self {
        match cause {
            Cause::Flag => flag,
            Cause::ParameterChanged => Self::ParameterChanged,
            Cause::OutsideLimits => Self::OutsideLimits,
            Cause::PlcSilent => Self::PlcSilent,
            Cause::StopFailed => Self::StopFailed,
            Cause::ConnectionLost => Self::ConnectionLost,
            Cause::MovedAtStart => Self::MovedAtStart,
            Cause::NotConnected => Self::NotConnected,
            Cause::FastStopLasts => Self::FastStopLasts,
            Cause::MotionRuns => Self::MotionRuns,
            Cause::NotReady => Self::NotReady,
            Cause::PartHeld => Self::PartHeld,
            Cause::NotIdle => Self::NotIdle,
            Cause::Gripper => Self::Refused,
            Cause::Unanswered => Self::Unanswered,
            Cause::Withdrawn => Self::Withdrawn,
        }
    }
}

/// Gripper flags that log an event when they rise.
const FAULTS: [(SystemFlags, EventCode); 4] = [
    (SystemFlags::TEMP_FAULT, EventCode::TempFault),
    (SystemFlags::POWER_FAULT, EventCode::PowerFault),
    (SystemFlags::CURR_FAULT, EventCode::CurrFault),
    (SystemFlags::FINGER_FAULT, EventCode::FingerFault),
];

/// Number of events kept.
pub const EVENTS_KEPT: usize = 16;

/// Registers per event: code, command, value, age.
const EVENT_LEN: usize = 4;

/// Register of the last event's code.
const FIRST_EVENT: u16 = 139;

/// Rows of the last events, by number.
macro_rules! event_rows {
    ($first:literal $($number:literal)*) => {[
        event_rows!(@ $first
            "code of the last event (earlier ones follow in `EVENT2_CODE` to `EVENT16_AGE`); 0: none"
            "id of the command concerned (command set, chapter 3); 0: none"
            "value of the event, see the table of events"
            "time since the event, in s"),
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

#[derive(Clone, Copy, Debug)]
struct Entry {
    code: EventCode,
    /// Id of the command concerned; 0: none.
    command: u8,
    value: u16,
    age_s: u16,
}

impl Entry {
    /// Returns code, command, value and age in seconds.
    const fn registers(self) -> [u16; EVENT_LEN] {
        [self.code as u16, self.command as u16, self.value, self.age_s]
    }
}

/// Log of the last [`EVENTS_KEPT`] events.
#[derive(Clone, Debug)]
pub(crate) struct Events {
    /// Ring buffer; `next` is the index of the next entry.
    ring: [Option<Entry>; EVENTS_KEPT],
    next: u8,
    count: u16,
    refusals: u16,
    /// Last FAST STOP.
    fast_stop: Option<Entry>,
    /// Time of the last update of the ages.
    counted_at: Instant,
    /// Last reported flags of the gripper.
    flags: SystemFlags,
}

impl Events {
    pub(crate) const REPORTS: Rows<Report> = EVENT_ROWS.as_flattened();

    pub(crate) const fn new() -> Self {
        Self {
            ring: [None; EVENTS_KEPT],
            next: 0,
            count: 0,
            refusals: 0,
            fast_stop: None,
            counted_at: Instant::from_millis(0),
            flags: SystemFlags::empty(),
        }
    }

    /// Updates the ages. Must be called at least once in 24 days.
    pub(crate) fn grow_old(&mut self, now: Instant) {
        let seconds = now.since(self.counted_at) / 1_000;
        if seconds == 0 {
            return;
        }
        self.counted_at = self.counted_at.plus(seconds.saturating_mul(1_000));
        for entry in self.ring.iter_mut().chain([&mut self.fast_stop]).flatten() {
            entry.age_s = entry.age_s.saturating_add(seconds.try_into().unwrap_or(u16::MAX));
        }
    }

    /// Logs an event without a command.
    pub(crate) fn happened(&mut self, code: EventCode, value: u16) {
        self.push(Entry { code, command: 0, value, age_s: 0 });
    }

    /// Logs an incident of the controller. `flag` is the code of FASTSTOP.
    pub(crate) fn note(&mut self, incident: Incident, flag: EventCode) {
        let Incident { cause, command, value } = incident;
        let command = command.map_or(0, |id| id.code());
        let entry = Entry { code: EventCode::of(cause, flag), command, value, age_s: 0 };
        if cause.is_fast_stop() {
            self.fast_stop = Some(entry);
        }
        self.refusals = self.refusals.saturating_add(cause.is_refusal().into());
        self.push(entry);
    }

    /// Logs rising flags of the gripper. `is_own`: the bridge itself has requested FAST STOP.
    pub(crate) fn see_flags(&mut self, flags: SystemFlags, is_own: bool) {
        let rising = flags.difference(core::mem::replace(&mut self.flags, flags));
        for (_, code) in FAULTS.iter().filter(|(flag, _)| rising.intersects(*flag)) {
            self.happened(*code, 0);
        }
        if rising.contains(SystemFlags::FAST_STOP) && !is_own {
            let entry = Entry { code: EventCode::GripperFastStop, command: 0, value: 0, age_s: 0 };
            self.fast_stop = Some(entry);
            self.push(entry);
        }
    }

    fn push(&mut self, entry: Entry) {
        if let Some(place) = self.ring.get_mut(usize::from(self.next) % EVENTS_KEPT) {
            *place = Some(entry);
        }
        self.next = self.next.wrapping_add(1);
        self.count = self.count.saturating_add(1);
    }

    /// Returns the number of events, saturating at 65 535.
    pub(crate) const fn count(&self) -> u16 {
        self.count
    }

    /// Returns the number of commands that the bridge refused.
    pub(crate) const fn refusals(&self) -> u16 {
        self.refusals
    }

    /// Returns the report in a register, or `None` if it is not an event register.
    pub(crate) fn value_of(&self, register: u16) -> Option<u16> {
        let place = u8::try_from(register.checked_sub(FIRST_EVENT)?).ok()?;
        let (number, field) = (place / EVENT_LEN as u8, place % EVENT_LEN as u8);
        (usize::from(number) < EVENTS_KEPT).then(|| self.register(number, field))
    }

    /// Returns a register of an event, counted from the latest (0). Returns 0 if there is no such event.
    fn register(&self, number: u8, field: u8) -> u16 {
        let at = usize::from(self.next.wrapping_sub(1).wrapping_sub(number)) % EVENTS_KEPT;
        field_of(self.ring.get(at).copied().flatten(), field)
    }

    /// Returns a register of the last FAST STOP.
    pub(crate) fn fast_stop_register(&self, field: u8) -> u16 {
        field_of(self.fast_stop, field)
    }

    /// Returns the cause of ERROR: the last FAST STOP if one is active, otherwise the last event.
    pub(crate) fn cause_of_error(&self, is_fast_stopped: bool) -> u8 {
        let code = if is_fast_stopped { self.fast_stop_register(0) } else { self.register(0, 0) };
        code.try_into().unwrap_or(0)
    }
}

fn field_of(entry: Option<Entry>, field: u8) -> u16 {
    entry.and_then(|entry| entry.registers().get(usize::from(field)).copied()).unwrap_or(0)
}

/// Excludes the log, which does not affect future behaviour.
impl Hash for Events {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

const _: () = assert!(256 % EVENTS_KEPT == 0, "a counter of 8 bits wraps at a multiple of the ring");

#[cfg(test)]
mod tests;
