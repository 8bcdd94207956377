//! What happened, and why: the last events, with the causes of ERROR and FAST STOP among them.

use core::hash::{Hash, Hasher};

use super::{Report, Rows};
use wsg_fieldbus::{Cause, Incident};
use wsg_protocol::{Instant, SystemFlags};

/// An event of the table, for those who read its code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventText {
    /// Its code.
    pub code: EventCode,
    /// Its name.
    pub name: &'static str,
    /// What happened.
    pub meaning: &'static str,
    /// What its value is; empty where it has none.
    pub value: &'static str,
    /// What to do.
    pub remedy: &'static str,
}

macro_rules! define_events {
    ($($code:literal $variant:ident $name:literal $meaning:literal $value:literal $remedy:literal;)*) => {
        /// What happened.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum EventCode {
            $(#[doc = $meaning] $variant = $code,)*
        }

        /// All events, by their codes.
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
    1 Start "START" "the bridge started" "RESET_CAUSE" "none; after a watchdog or firmware reset tell the maintainers";
    10 Wire "FAST_STOP_WIRE" "FAST STOP: the wire FAST_STOP_OK was low" "" "find out who pulled it, or a broken wire; then STOP_ACK";
    11 BusFlag "FAST_STOP_FLAG" "FAST STOP: the bus wrote FASTSTOP = 1" "" "look at the PLC's program; write FASTSTOP 0, then STOP/ACK";
    12 ParameterChanged "PARAMETER_CHANGED" "FAST STOP: WIDTH, SPEED or FORCELIMIT changed while the fingers moved" "the new one" "change parameters only while the fingers stand";
    13 OutsideLimits "OUTSIDE_LIMITS" "FAST STOP: SPEED or FORCELIMIT is outside the gripper's limits" "the one that is, as its register has it" "stay within the gripper's data sheet; recipes: RECIPEn_SPEED, RECIPEn_FORCE";
    14 PlcSilent "PLC_SILENT" "FAST STOP: the PLC that commanded fell silent, and BUS_REACTION is 2 (or the gripper could not be stopped otherwise)" "" "see BUS_SILENT";
    15 StopFailed "STOP_FAILED" "FAST STOP: a Stop was not answered or refused while the fingers were not known to stand" "its status" "look at the gripper's line; then STOP/ACK";
    16 ConnectionLost "CONNECTION_LOST" "FAST STOP: the gripper fell silent during a jog" "" "see GRIPPER_SILENT";
    18 GripperFastStop "GRIPPER_FAST_STOP" "the gripper shows a FAST STOP that the bridge did not ask for" "" "look at the gripper: a fault, another client, or one from before the bridge started; then STOP/ACK";
    30 NotConnected "NOT_CONNECTED" "a command came while the gripper did not answer" "" "wait for LINK_OK";
    31 FastStopLasts "FAST_STOP_LASTS" "a command came during FAST STOP, or STOP/ACK before the gripper had confirmed it" "" "give STOP/ACK an edge once the cause is gone, then command";
    32 MotionRuns "MOTION_RUNS" "a motion was asked for while the fingers moved" "" "wait for the end, or STOP first";
    33 NotReady "NOT_READY" "a command wire rose while READY was low" "" "wait for READY";
    34 PartHeld "PART_HELD" "MOVE or a jog was asked for while a part is held" "" "RELEASE first";
    35 Refused "REFUSED" "the gripper refused the command or ended it with an error" "its status" "see the status codes";
    36 Unanswered "UNANSWERED" "the gripper did not answer a command: nobody knows whether it was carried out" "" "look at the line; see where the fingers are before the next command";
    37 Withdrawn "WITHDRAWN" "something overtook the command before it left" "" "give it again";
    38 MovedAtStart "MOVED_AT_START" "the gripper moved when the bridge started, and was stopped" "" "see where the fingers are, then home";
    39 NotIdle "NOT_IDLE" "MOVE was asked for while GSTATE was NO_PART, PART_LOST or ERROR" "" "RELEASE first; after an error STOP/ACK";
    50 GripperSilent "GRIPPER_SILENT" "the gripper fell silent" "" "its supply, its line, its setting for the interface";
    51 TempFault "TEMP_FAULT" "the gripper is too hot" "" "let it cool down; less force or fewer cycles";
    52 PowerFault "POWER_FAULT" "the gripper's supply is out of range" "" "look at its supply";
    53 CurrFault "CURR_FAULT" "the gripper's motor took too much for too long" "" "wait until the flag is gone; look for what blocks the fingers";
    54 FingerFault "FINGER_FAULT" "a finger tells a fault" "" "look at the finger and its cable";
    60 BusSilent "BUS_SILENT" "the PLC that commanded over the bus was silent for BUS_TIMEOUT" "BUS_REACTION" "the bus's wiring and its master; a longer BUS_TIMEOUT";
    61 BusOff "BUS_OFF" "the CAN controller went bus-off" "" "rate, termination and wiring of the CAN bus";
    70 SettingsRefused "SETTINGS_REFUSED" "the stored settings cannot be used, and those that count are not those that were set up: nothing moves" "SETTINGS_FROM" "set the bridge up again and SAVE, or DEFAULTS";
    71 SaveFailed "SAVE_FAILED" "the settings were not stored; what was stored before still is" "why: the flash 1 stays busy, 2 is write protected, 3 was not erased, 4 reports another fault, 5 does not become erased, 6 reads otherwise than written, 7 has no number left for a save" "SAVE again; if that fails too, the flash is worn or protected";
}

impl EventCode {
    /// What the controller calls it. `by_wires`: a FASTSTOP was a wire's.
    const fn of(cause: Cause, by_wires: bool) -> Self {
        match cause {
            Cause::Flag if by_wires => Self::Wire,
            Cause::Flag => Self::BusFlag,
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

/// Flags of the gripper that are an event when they rise.
const FAULTS: [(SystemFlags, EventCode); 4] = [
    (SystemFlags::TEMP_FAULT, EventCode::TempFault),
    (SystemFlags::POWER_FAULT, EventCode::PowerFault),
    (SystemFlags::CURR_FAULT, EventCode::CurrFault),
    (SystemFlags::FINGER_FAULT, EventCode::FingerFault),
];

/// Events that are kept.
pub const EVENTS_KEPT: usize = 16;

/// Registers of each: code, command, value, age.
const EVENT_LEN: usize = 4;

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

#[derive(Clone, Copy, Debug)]
struct Entry {
    code: EventCode,
    /// The command concerned, by its id; 0: none.
    command: u8,
    value: u16,
    age_s: u16,
}

impl Entry {
    /// Code, command, value and age in seconds.
    const fn registers(self) -> [u16; EVENT_LEN] {
        [self.code as u16, self.command as u16, self.value, self.age_s]
    }
}

/// The last events.
#[derive(Clone, Debug)]
pub(crate) struct Events {
    /// A ring; `next` is where the next goes.
    ring: [Option<Entry>; EVENTS_KEPT],
    next: u8,
    count: u16,
    refusals: u16,
    /// The FAST STOP that was asked for last.
    fast_stop: Option<Entry>,
    /// When ages were counted last.
    counted_at: Instant,
    /// The gripper's flags as they were told last.
    flags: SystemFlags,
}

impl Events {
    /// The rows of the last events.
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

    /// Lets the events grow old. To be called at least once in 24 days.
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

    /// Something happened, with no command concerned.
    pub(crate) fn happened(&mut self, code: EventCode, value: u16) {
        self.push(Entry { code, command: 0, value, age_s: 0 });
    }

    /// What the controller has noted. `by_wires`: the wires ask for FAST STOP, be it beside a bus.
    pub(crate) fn note(&mut self, incident: Incident, by_wires: bool) {
        let Incident { cause, command, value } = incident;
        let command = command.map_or(0, |id| id.code());
        let entry = Entry { code: EventCode::of(cause, by_wires), command, value, age_s: 0 };
        if cause.is_fast_stop() {
            self.fast_stop = Some(entry);
        }
        self.refusals = self.refusals.saturating_add(cause.is_refusal().into());
        self.push(entry);
    }

    /// The gripper has told its flags. `is_own`: a FAST STOP that they may show is one that was asked for.
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

    /// How many there were.
    pub(crate) const fn count(&self) -> u16 {
        self.count
    }

    /// How many commands the bridge has refused.
    pub(crate) const fn refusals(&self) -> u16 {
        self.refusals
    }

    /// Returns the report in a register, or `None` if it is not one of these.
    pub(crate) fn value_of(&self, register: u16) -> Option<u16> {
        let place = u8::try_from(register.checked_sub(FIRST_EVENT)?).ok()?;
        let (number, field) = (place / EVENT_LEN as u8, place % EVENT_LEN as u8);
        (usize::from(number) < EVENTS_KEPT).then(|| self.register(number, field))
    }

    /// A register of one of them, the last first; 0 of one that has not happened.
    fn register(&self, number: u8, field: u8) -> u16 {
        let at = usize::from(self.next.wrapping_sub(1).wrapping_sub(number)) % EVENTS_KEPT;
        field_of(self.ring.get(at).copied().flatten(), field)
    }

    /// A register of the last FAST STOP.
    pub(crate) fn fast_stop_register(&self, field: u8) -> u16 {
        field_of(self.fast_stop, field)
    }

    /// Why ERROR is high: a FAST STOP if one lasts, else what happened last.
    pub(crate) fn cause_of_error(&self, is_fast_stopped: bool) -> u8 {
        let code = if is_fast_stopped { self.fast_stop_register(0) } else { self.register(0, 0) };
        code.try_into().unwrap_or(0)
    }
}

fn field_of(entry: Option<Entry>, field: u8) -> u16 {
    entry.and_then(|entry| entry.registers().get(usize::from(field)).copied()).unwrap_or(0)
}

/// What was says nothing of what comes: two bridges that differ in their record alone do the same.
impl Hash for Events {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

const _: () = assert!(256 % EVENTS_KEPT == 0, "a counter of 8 bits wraps at a multiple of the ring");

#[cfg(test)]
mod tests;
