//! The bridge as a PLC side reads and changes it while serving its PLC.

use super::SideReports;
use super::motion_end::MotionEnd;
use super::settings::Settings;
use crate::arbiter::{Arbiter, ControlSource};
use crate::can::CanReports;
use crate::gripper::MAX_REPLY_LEN;
use crate::register::{
    BusCounts, EventCode, Events, FIRST_REPORT, Link, MAP_VERSION, RegisterError, ResetCause, SaveState,
    StoreCommand, StoreReports, UpdateCommand, UpdateRefusal, report_rows,
};
use crate::update::{Master, Update};
use wsg_fieldbus::{Controller, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::session::{Known, Session};
use wsg_protocol::{FrameParser, Status};

/// Bridge-level state.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Facts {
    /// The gripper has answered since power-up.
    pub(crate) was_connected: bool,
    /// The fingers moved, or a motion was in progress, when the gripper was last connected.
    pub(crate) moved: bool,
    /// The link to the gripper is known to be down, as after bus-off.
    pub(crate) link_is_lost: bool,
    /// Number of time-outs of a commanding PLC on the bus.
    pub(crate) bus_timeouts: u16,
    /// A PLC on the bus has timed out, whether it commanded or not, and is still silent.
    pub(crate) bus_is_silent: bool,
    pub(crate) can: CanReports,
    pub(crate) sides: SideReports,
    pub(crate) reset_cause: ResetCause,
    pub(crate) motion_end: MotionEnd,
    /// Event code of the cause of ERROR at the end of the last turn; 0: ERROR was low.
    pub(crate) error_cause: u8,
    pub(crate) events: Events,
    pub(crate) store: StoreReports,
    pub(crate) update: Update,
}

impl Facts {
    /// Returns whether all motions are refused: the stored settings are unusable, or an update is in progress.
    pub(crate) const fn is_locked(&self) -> bool {
        self.store.from.is_refusal() || self.update.is_active()
    }

    /// Records the outcome of a block or command of an update, or of its turn.
    pub(crate) fn note_update<T>(
        &mut self,
        was_active: bool,
        done: Result<T, UpdateRefusal>,
    ) -> Result<T, UpdateRefusal> {
        if let Err(why) = done {
            if self.update.refuse(why) {
                self.events.happened(EventCode::UpdateRefused, why as u16);
            }
        } else if self.update.is_active() && !was_active {
            self.events.happened(EventCode::UpdateRuns, 0);
        }
        done
    }

    /// Returns the state of the link to the gripper.
    pub(crate) const fn link(&self, session: &Session) -> Link {
        match (session.is_connected(), self.was_connected) {
            (true, _) => Link::Up,
            (false, true) => Link::Silent,
            (false, false) => Link::Never,
        }
    }

    /// Returns the current input image.
    pub(crate) fn image(&self, controller: &Controller, session: &Session) -> InputImage {
        let mut image = controller.input(session.known());
        if self.link_is_lost {
            image.state = GripperFlags::ERROR;
            image.status = Status::IoError;
        } else if self.is_locked() && session.is_connected() {
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

/// The bridge as seen by a [`PlcSide`](super::PlcSide): the images, and the registers (`docs/registers.md`).
#[derive(Debug)]
pub struct View<'a> {
    pub(crate) controller: &'a Controller,
    pub(crate) session: &'a Session,
    pub(crate) parser: &'a FrameParser<MAX_REPLY_LEN>,
    pub(crate) arbiter: &'a Arbiter,
    pub(crate) facts: &'a mut Facts,
    pub(crate) settings: &'a mut Settings,
}

impl View<'_> {
    /// Returns the input image for a bus. It shows the end of a motion up to 10 ms late, with width and force measured after
    /// it.
    #[must_use]
    pub fn image(&self) -> InputImage {
        self.facts.motion_end.shown(self.facts.image(self.controller, self.session))
    }

    /// Returns the last output image from the PLC's bus, or zeros before the first one. It may have no effect while wires
    /// command.
    #[must_use]
    pub const fn bus_image(&self) -> &OutputImage {
        self.arbiter.bus_image()
    }

    /// Returns the state of the link to the gripper.
    #[must_use]
    pub const fn link(&self) -> Link {
        self.facts.link(self.session)
    }

    /// Returns whether the fingers move or a motion is in progress. If the connection was lost meanwhile, this is assumed
    /// until the gripper reports its state again.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.controller.is_moving(self.session.known()) || (self.facts.moved && !self.session.is_connected())
    }

    /// Returns the unit of the gripper's force registers.
    #[must_use]
    pub fn force_unit(&self) -> ForceUnit {
        force_unit(self.session.known())
    }

    /// Returns the setting at `index`, counted from the first setting.
    ///
    /// # Errors
    /// [`RegisterError::Missing`].
    pub fn setting(&self, index: u16) -> Result<u16, RegisterError> {
        self.settings.register(index)
    }

    /// Writes consecutive settings from index `first`, all or none. The caller then returns
    /// [`PlcEvent::Configured`](super::PlcEvent).
    ///
    /// # Errors
    /// [`RegisterError::Missing`] or [`RegisterError::Value`] for an invalid write. For a valid write,
    /// [`RegisterError::Moving`] while the fingers move and [`RegisterError::Saving`] while a save is running: a later
    /// attempt succeeds.
    pub fn write_settings(
        &mut self,
        first: u16,
        values: impl Iterator<Item = u16> + Clone,
    ) -> Result<(), RegisterError> {
        // An invalid write is reported as such, even while no write is possible.
        self.settings.check(first, values.clone())?;
        self.may_change_settings()?;
        self.settings.write(first, values)
    }

    /// Restores the stored settings, or schedules a save for the end of this turn. The caller then returns
    /// [`PlcEvent::Configured`](super::PlcEvent).
    ///
    /// # Errors
    /// [`RegisterError::Moving`] while the fingers move, [`RegisterError::Saving`] while a save is running.
    pub fn command_store(&mut self, command: StoreCommand) -> Result<(), RegisterError> {
        self.may_change_settings()?;
        match command {
            StoreCommand::Restore => self.settings.restore(),
            _ if self.facts.update.is_on_trial() => return Err(RegisterError::Updating),
            StoreCommand::Save | StoreCommand::Defaults => self.settings.ask(command),
        }
        Ok(())
    }

    /// Restores the stored settings even while the fingers move, as a master's reset of the device requires. Does nothing
    /// while a save is running.
    pub(crate) fn reset_settings(&mut self) {
        if self.save_state() != SaveState::Saving {
            self.settings.restore();
        }
    }

    /// Returns the state of the last save. A save that is scheduled for the end of this turn counts as running.
    pub(crate) const fn save_state(&self) -> SaveState {
        if self.settings.is_requested() { SaveState::Saving } else { self.facts.store.save }
    }

    fn may_change_settings(&self) -> Result<(), RegisterError> {
        if self.is_moving() {
            Err(RegisterError::Moving)
        } else if self.save_state() == SaveState::Saving {
            Err(RegisterError::Saving)
        } else if self.facts.update.is_active() {
            Err(RegisterError::Updating)
        } else {
            Ok(())
        }
    }

    /// Takes a block of an image at this offset.
    ///
    /// # Errors
    /// [`UpdateRefusal`]; the image received so far is unchanged.
    pub(crate) fn write_image(&mut self, master: Master, at: u32, bytes: &[u8]) -> Result<(), UpdateRefusal> {
        self.update(|update, may_begin| update.take_block(master, at, bytes, may_begin))
    }

    /// Executes a command of an update.
    ///
    /// # Errors
    /// [`UpdateRefusal`].
    pub(crate) fn command_update(
        &mut self,
        master: Master,
        command: UpdateCommand,
    ) -> Result<(), UpdateRefusal> {
        self.update(|update, may_begin| update.take_command(master, command, may_begin))
    }

    fn update(
        &mut self,
        take: impl FnOnce(&mut Update, Result<(), UpdateRefusal>) -> Result<(), UpdateRefusal>,
    ) -> Result<(), UpdateRefusal> {
        let may_begin = if self.is_moving() || self.session.motion_is_open() {
            Err(UpdateRefusal::Moving)
        } else if self.save_state() == SaveState::Saving {
            Err(UpdateRefusal::Saving)
        } else {
            Ok(())
        };
        let was_active = self.facts.update.is_active();
        let taken = take(&mut self.facts.update, may_begin);
        self.facts.note_update(was_active, taken)
    }

    /// Returns the report at `index`, counted from the first report. `bus` are the counters of the calling side.
    ///
    /// # Errors
    /// [`RegisterError::Missing`].
    pub fn report(&self, index: u16, bus: BusCounts) -> Result<u16, RegisterError> {
        let register = FIRST_REPORT.checked_add(index).ok_or(RegisterError::Missing)?;
        self.value_of(register)
            .or_else(|| self.facts.update.value_of(register))
            .or_else(|| self.facts.events.value_of(register))
            .or_else(|| bus.value_of(register))
            .or_else(|| self.facts.can.value_of(register))
            .or_else(|| self.facts.sides.value_of(register))
            .ok_or(RegisterError::Missing)
    }

    /// Returns the source of the last motion command.
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
    101 "BRIDGE_VERSION" "firmware version: high byte major, low byte minor"
        const {
            let [major, minor] = [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR")];
            u16::from_be_bytes([number(major), number(minor)])
        };
    102 "BRIDGE_PATCH" "firmware patch level"
        const { number(env!("CARGO_PKG_VERSION_PATCH")) }.into();
    103 "GRIPPER_TYPE" "gripper type (command set, 3.5.1); 0: unknown"
        it.session.known().info.map_or(0, |info| info.device.code().into());
    104 "GRIPPER_FIRMWARE" "gripper firmware version, four digits (command set, 3.5.1); 0: unknown"
        it.session.known().info.map_or(0, |info| info.firmware.bits());
    105 "SERIAL_HIGH" "gripper serial number, bits 31 to 16" (it.serial_number() >> 16) as u16;
    106 "SERIAL_LOW" "gripper serial number, bits 15 to 0" it.serial_number() as u16;
    107 "GRIPPER_LINK" "gripper link: 0 never answered, 1 lost, 2 connected" it.link() as u16;
    108 "CONTROL_SOURCE" "source of the last motion command: 0 none, 1 wires, 2 bus"
        it.control_source() as u16;
    111 "LINE_DROPPED" "bytes from the gripper outside of intact frames" it.parser.counters().dropped;
    112 "LINE_CHECKSUM" "frames from the gripper with a wrong checksum" it.parser.counters().bad_checksum;
    113 "LINE_OVERSIZE" "frames from the gripper that were too long" it.parser.counters().oversize;
    114 "UNSOLICITED" "unsolicited or late replies from the gripper"
        it.session.counters().unsolicited;
    115 "REFUSED" "replies from the gripper that violate the manual" it.session.counters().refused;
    116 "REPEATED" "requests to the gripper that were repeated" it.session.counters().repeated;
    117 "DISCONNECTS" "losses of the connection to the gripper" it.session.counters().disconnects;
    125 "BUS_TIMEOUTS" "time-outs of a commanding PLC on the bus" it.facts.bus_timeouts;
    132 "RESET_CAUSE" "cause of the last reset: 0 unknown, 1 power-on or brown-out, 2 reset pin, 3 watchdog, 4 firmware fault or panic"
        it.facts.reset_cause as u16;
    133 "ERROR_CAUSE" "event code of the cause of ERROR; 0: ERROR is low" it.facts.error_cause.into();
    134 "EVENTS" "number of events since the start" it.facts.events.count();
    135 "FAST_STOP_CAUSE" "event code of the last FAST STOP; 0: none"
        it.facts.events.fast_stop_register(0);
    136 "FAST_STOP_COMMAND" "id of the command ended by the last FAST STOP; 0: none"
        it.facts.events.fast_stop_register(1);
    137 "FAST_STOP_VALUE" "value of the event, see the table of events" it.facts.events.fast_stop_register(2);
    138 "FAST_STOP_AGE" "time since the event, in s" it.facts.events.fast_stop_register(3);
    203 "SETTINGS_FROM" "source of the settings: 0 defaults, 1 stored, 2 stored by older firmware; defaults, stored ones refused: 3 from newer firmware, 4 invalid, 5 damaged; 6 defaults, no flash"
        it.facts.store.from as u16;
    204 "SAVE_STATE" "last SAVE or DEFAULTS: 0 none since the start, 1 running, 2 stored, 3 failed, previous settings kept"
        it.facts.store.save as u16;
    205 "SETTINGS_CHANGED" "1: changed settings are not stored yet" it.settings.are_changed().into();
    210 "COMMANDS_REFUSED" "PLC commands refused by the bridge, from wires and bus (events 30 to 34 and 39)"
        it.facts.events.refusals();
}

/// Parses decimal digits. Returns 0 if they are not a `u8`.
const fn number(digits: &str) -> u8 {
    match u8::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => 0,
    }
}
