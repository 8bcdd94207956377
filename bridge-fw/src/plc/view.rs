//! What a PLC side may look at and change while it serves its PLC.

use super::motion_end::MotionEnd;
use crate::arbiter::{Arbiter, ControlSource};
use crate::config::{BusConfig, MAX_REPLY_LEN};
use crate::registers::{
    BusCounts, CanReports, Events, Link, ProfibusReports, RegisterError, ReportSource, ResetCause, SaveState,
    Settings, StoreCommand, StoreReports,
};
use wsg_fieldbus::{Controller, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::session::{Known, Session};
use wsg_protocol::{FrameParser, Status};

/// What the bridge knows besides what its parts know.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Facts {
    pub(crate) bus_config: BusConfig,
    /// A gripper has answered since power-up.
    pub(crate) was_connected: bool,
    /// The way to the gripper is known to be gone, as a bus is after bus-off.
    pub(crate) link_is_lost: bool,
    /// How often a PLC on the bus was silent for too long.
    pub(crate) bus_timeouts: u16,
    /// A PLC on the bus, whether it commanded or not, was silent for too long, and has not come back.
    pub(crate) bus_is_silent: bool,
    pub(crate) can: CanReports,
    pub(crate) profibus: ProfibusReports,
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
        values: impl Iterator<Item = u16>,
    ) -> Result<(), RegisterError> {
        // What exists and what it takes is said before that it is not the time.
        let changed = self.settings.with(first, values)?;
        self.may_change_settings()?;
        self.settings.take(&changed);
        Ok(())
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
        ReportSource {
            config: &self.facts.bus_config,
            session: self.session,
            link: self.link(),
            line: self.parser.counters(),
            control_source: self.control_source(),
            bus,
            timeouts: self.facts.bus_timeouts,
            can: &self.facts.can,
            profibus: &self.facts.profibus,
            reset_cause: self.facts.reset_cause,
            error_cause: self.facts.error_cause,
            events: &self.facts.events,
            store: self.facts.store,
            settings_are_changed: self.settings.are_changed(),
        }
        .register(index)
    }

    /// Returns whose motion command was the last.
    #[must_use]
    pub const fn control_source(&self) -> ControlSource {
        self.arbiter.control_source()
    }
}
