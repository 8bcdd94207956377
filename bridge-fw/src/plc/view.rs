//! What a PLC side may look at and change while it serves its PLC.

use super::SideReports;
use super::motion_end::MotionEnd;
use super::settings::Settings;
use crate::arbiter::{Arbiter, ControlSource};
use crate::can::CanReports;
use crate::gripper::MAX_REPLY_LEN;
use crate::register::{
    BusCounts, Events, FIRST_REPORT, Link, MAP_VERSION, RegisterError, ResetCause, SaveState, StoreCommand,
    StoreReports, report_rows,
};
use wsg_fieldbus::{Controller, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::session::{Known, Session};
use wsg_protocol::{FrameParser, Status};

/// What the bridge knows besides what its parts know.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Facts {
    /// A gripper has answered since power-up.
    pub(crate) was_connected: bool,
    /// The way to the gripper is known to be gone, as a bus is after bus-off.
    pub(crate) link_is_lost: bool,
    /// How often a PLC on the bus was silent for too long.
    pub(crate) bus_timeouts: u16,
    /// A PLC on the bus, whether it commanded or not, was silent for too long, and has not come back.
    pub(crate) bus_is_silent: bool,
    pub(crate) can: CanReports,
    pub(crate) sides: SideReports,
    pub(crate) reset_cause: ResetCause,
    pub(crate) motion_end: MotionEnd,
    /// Why ERROR was high at the end of the last turn, by the code of an event; 0: it was low.
    pub(crate) error_cause: u8,
    pub(crate) events: Events,
    pub(crate) store: StoreReports,
}

impl Facts {
    /// Whether the gripper answers.
    pub(crate) const fn link(&self, session: &Session) -> Link {
        match (session.is_connected(), self.was_connected) {
            (true, _) => Link::Up,
            (false, true) => Link::Silent,
            (false, false) => Link::Never,
        }
    }

    /// The input image as it is now.
    pub(crate) fn image(&self, controller: &Controller, session: &Session) -> InputImage {
        let mut image = controller.input(session.known());
        if self.link_is_lost {
            image.state = GripperFlags::ERROR;
            image.status = Status::IoError;
        } else if self.store.from.is_refusal() && session.is_connected() {
            image.state = GripperFlags::ERROR;
            image.status = Status::InconsistentData;
        }
        image
    }
}

/// The unit of the gripper's force registers.
pub(crate) fn force_unit(known: &Known) -> ForceUnit {
    known.info.map_or(ForceUnit::default(), |info| ForceUnit::of(info.device))
}

/// The bridge as a [`PlcSide`](super::PlcSide) sees it: the images, and the registers (`docs/registers.md`).
#[derive(Debug)]
pub struct View<'a> {
    pub(crate) controller: &'a Controller,
    pub(crate) session: &'a Session,
    pub(crate) parser: &'a FrameParser<MAX_REPLY_LEN>,
    pub(crate) arbiter: &'a Arbiter,
    pub(crate) facts: &'a Facts,
    pub(crate) settings: &'a mut Settings,
}

impl View<'_> {
    /// Returns the input image as a bus shows it: the end of a motion with width and force from after it, up to 10 ms later.
    #[must_use]
    pub fn image(&self) -> InputImage {
        self.facts.motion_end.shown(self.facts.image(self.controller, self.session))
    }

    /// Returns the output image that the PLC's bus wrote last, zeros before it wrote any. It need not count: wires may
    /// command.
    #[must_use]
    pub const fn bus_image(&self) -> &OutputImage {
        self.arbiter.bus_image()
    }

    /// Returns whether the gripper answers.
    #[must_use]
    pub const fn link(&self) -> Link {
        self.facts.link(self.session)
    }

    /// Returns whether the fingers move, or a motion is under way.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.controller.is_moving(self.session.known())
    }

    /// Returns the unit of the gripper's force registers.
    #[must_use]
    pub fn force_unit(&self) -> ForceUnit {
        force_unit(self.session.known())
    }

    /// Returns the setting at `index`, counted from the first.
    ///
    /// # Errors
    /// [`RegisterError::Missing`].
    pub fn setting(&self, index: u16) -> Result<u16, RegisterError> {
        self.settings.register(index)
    }

    /// Writes consecutive settings from `first` on, all or none. Return [`PlcEvent::Configured`](super::PlcEvent) then.
    ///
    /// # Errors
    /// [`RegisterError::Missing`], [`RegisterError::Value`]; [`RegisterError::Moving`] if they would be taken while the fingers
    /// stand, [`RegisterError::Saving`] if they would be taken a moment later.
    pub fn write_settings(
        &mut self,
        first: u16,
        values: impl Iterator<Item = u16> + Clone,
    ) -> Result<(), RegisterError> {
        // What exists and what it takes is said before that it is not the time.
        self.settings.check(first, values.clone())?;
        self.may_change_settings()?;
        self.settings.write(first, values)
    }

    /// Takes the stored settings, or has others stored at the end of this turn. Return
    /// [`PlcEvent::Configured`](super::PlcEvent) then.
    ///
    /// # Errors
    /// As for [`write_settings`](Self::write_settings).
    pub fn command_store(&mut self, command: StoreCommand) -> Result<(), RegisterError> {
        self.may_change_settings()?;
        match command {
            StoreCommand::Restore => self.settings.restore(),
            StoreCommand::Save | StoreCommand::Defaults => self.settings.ask(command),
        }
        Ok(())
    }

    /// Takes the stored settings, whatever the fingers do: what a master's reset of the device asks for. Those that are being
    /// stored stay.
    pub(crate) fn reset_settings(&mut self) {
        if self.save_state() != SaveState::Saving {
            self.settings.restore();
        }
    }

    /// How the last save goes, one included that begins at the end of this turn.
    pub(crate) const fn save_state(&self) -> SaveState {
        if self.settings.is_asked() { SaveState::Saving } else { self.facts.store.save }
    }

    fn may_change_settings(&self) -> Result<(), RegisterError> {
        if self.is_moving() {
            Err(RegisterError::Moving)
        } else if self.save_state() == SaveState::Saving {
            Err(RegisterError::Saving)
        } else {
            Ok(())
        }
    }

    /// Returns the report at `index`, counted from the first. `bus`: the side's own counters.
    ///
    /// # Errors
    /// [`RegisterError::Missing`].
    pub fn report(&self, index: u16, bus: BusCounts) -> Result<u16, RegisterError> {
        let register = FIRST_REPORT.checked_add(index).ok_or(RegisterError::Missing)?;
        self.value_of(register)
            .or_else(|| self.facts.events.value_of(register))
            .or_else(|| bus.value_of(register))
            .or_else(|| self.facts.can.value_of(register))
            .or_else(|| self.facts.sides.value_of(register))
            .ok_or(RegisterError::Missing)
    }

    /// Returns whose motion command was the last.
    #[must_use]
    pub const fn control_source(&self) -> ControlSource {
        self.arbiter.control_source()
    }

    fn serial_number(&self) -> u32 {
        self.session.known().info.map_or(0, |info| info.serial_number)
    }
}

report_rows! { View<'_> as it:
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
    107 "GRIPPER_LINK" "0: has never answered, 1: is silent, 2: answers" it.link() as u16;
    108 "COMMANDER" "who gave the last motion command: 0 nobody, 1 the wires, 2 the bus"
        it.control_source() as u16;
    111 "LINE_DROPPED" "bytes of the gripper that belonged to no intact frame" it.parser.counters().dropped;
    112 "LINE_CHECKSUM" "frames of the gripper with a wrong checksum" it.parser.counters().bad_checksum;
    113 "LINE_OVERSIZE" "frames of the gripper that were too long" it.parser.counters().oversize;
    114 "UNASKED" "replies of the gripper that nobody asked for, or late ones"
        it.session.counters().unsolicited;
    115 "REFUSED" "replies of the gripper that the manual forbids" it.session.counters().refused;
    116 "REPEATED" "requests to the gripper that were sent again" it.session.counters().repeated;
    117 "DISCONNECTS" "how often the gripper fell silent" it.session.counters().disconnects;
    125 "BUS_TIMEOUTS" "how often the PLC that commanded was silent for too long" it.facts.bus_timeouts;
    132 "RESET_CAUSE" "why the bridge started: 0 unknown, 1 power-on or brown-out, 2 reset pin, 3 watchdog, 4 fault or panic of the firmware"
        it.facts.reset_cause as u16;
    133 "ERROR_CAUSE" "why ERROR is high: the code of an event; 0: it is low" it.facts.error_cause.into();
    134 "EVENTS" "how many events there were" it.facts.events.count();
    135 "FAST_STOP_CAUSE" "why the last FAST STOP was: the code of an event; 0: there was none"
        it.facts.events.fast_stop_register(0);
    136 "FAST_STOP_COMMAND" "the command that it ended, by its id; 0: none"
        it.facts.events.fast_stop_register(1);
    137 "FAST_STOP_VALUE" "its value, see the table of events" it.facts.events.fast_stop_register(2);
    138 "FAST_STOP_AGE" "how long ago it was asked for, in s" it.facts.events.fast_stop_register(3);
    203 "SETTINGS_FROM" "where the settings are from: 0 the image, 1 stored, 2 stored by older firmware; refused, and the image's instead: 3 newer firmware's, 4 a wrong value, 5 damaged; 6 no flash"
        it.facts.store.from as u16;
    204 "SAVE_STATE" "the last SAVE or DEFAULTS: 0 none since the start, 1 runs, 2 stored, 3 failed: what was stored before still is"
        it.facts.store.save as u16;
    205 "SETTINGS_CHANGED" "1: a setting was changed and not stored" it.settings.are_changed().into();
    210 "COMMANDS_REFUSED" "commands of the PLC that the bridge refused, from wires and bus (events 30 to 34 and 39)"
        it.facts.events.refusals();
}

/// The number that these digits are.
const fn number(digits: &str) -> u8 {
    match u8::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => 0,
    }
}
