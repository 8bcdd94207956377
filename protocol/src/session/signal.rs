//! The values that a gripper sends by itself (command set, 3.4), and which of them are subscribed to.

use super::Config;
use crate::command::{Command, CommandId};
use crate::types::{AutoUpdate, UpdateFlags};

/// A value that can be subscribed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Signal {
    /// The system state flags (40h). The session always asks for them.
    SystemState,
    /// The gripper state (41h). The session always asks for it.
    GripperState,
    /// The opening width in mm (43h); not sent while the fingers are not referenced.
    Width,
    /// The finger speed in mm/s (44h).
    Speed,
    /// The gripping force in N, summed over both fingers (45h).
    Force,
}

impl Signal {
    /// Every one, by command id.
    pub const ALL: [Self; 5] = [Self::SystemState, Self::GripperState, Self::Width, Self::Speed, Self::Force];

    /// The command that asks for it.
    #[must_use]
    pub const fn id(self) -> CommandId {
        match self {
            Self::SystemState => CommandId::GetSystemState,
            Self::GripperState => CommandId::GetGripperState,
            Self::Width => CommandId::GetOpeningWidth,
            Self::Speed => CommandId::GetSpeed,
            Self::Force => CommandId::GetForce,
        }
    }

    /// The one that this command asks for.
    #[must_use]
    pub fn of(id: CommandId) -> Option<Self> {
        Self::ALL.into_iter().find(|signal| signal.id() == id)
    }

    /// The one that this command asks for, and how.
    const fn asked_by(command: &Command<'_>) -> Option<(Self, AutoUpdate)> {
        match *command {
            Command::GetSystemState { update } => Some((Self::SystemState, update)),
            Command::GetGripperState { update } => Some((Self::GripperState, update)),
            Command::GetOpeningWidth { update } => Some((Self::Width, update)),
            Command::GetSpeed { update } => Some((Self::Speed, update)),
            Command::GetForce { update } => Some((Self::Force, update)),
            _ => None,
        }
    }

    const fn request(self, update: AutoUpdate) -> Command<'static> {
        match self {
            Self::SystemState => Command::GetSystemState { update },
            Self::GripperState => Command::GetGripperState { update },
            Self::Width => Command::GetOpeningWidth { update },
            Self::Speed => Command::GetSpeed { update },
            Self::Force => Command::GetForce { update },
        }
    }

    const fn bit(self) -> u8 {
        1 << self as u8
    }
}

/// What is subscribed to, and how.
#[derive(Clone, Debug, Hash)]
pub(super) struct Subscriptions {
    updates: [AutoUpdate; Signal::ALL.len()],
    /// Those that were changed while connected and that the gripper has not confirmed; one bit each.
    changed: u8,
}

impl Subscriptions {
    pub(super) const fn new(config: &Config) -> Self {
        let period_ms = if config.update_period_ms < AutoUpdate::MIN_PERIOD_MS {
            AutoUpdate::MIN_PERIOD_MS
        } else {
            config.update_period_ms
        };
        let on = AutoUpdate::on_change(period_ms);
        let off = AutoUpdate::once();
        Self {
            updates: [
                on,
                on,
                if config.width { on } else { off },
                if config.speed { on } else { off },
                if config.force { on } else { off },
            ],
            changed: 0,
        }
    }

    pub(super) fn set(&mut self, signal: Signal, update: AutoUpdate) {
        let is_on = update.flags.contains(UpdateFlags::AUTOMATIC);
        let update = if is_on {
            AutoUpdate { period_ms: update.period_ms.max(AutoUpdate::MIN_PERIOD_MS), ..update }
        } else {
            AutoUpdate::once()
        };
        if let Some(slot) = self.updates.get_mut(signal as usize) {
            *slot = update;
            self.changed |= signal.bit();
        }
    }

    fn update(&self, signal: Signal) -> AutoUpdate {
        self.updates.get(signal as usize).copied().unwrap_or(AutoUpdate::once())
    }

    /// Whether it is asked for again and again. The two states are, with updates or without: the session needs them.
    pub(super) fn wants(&self, signal: Signal) -> bool {
        matches!(signal, Signal::SystemState | Signal::GripperState)
            || self.update(signal).flags.contains(UpdateFlags::AUTOMATIC)
    }

    /// The request for the `n`th of those that are asked for again and again.
    pub(super) fn nth(&self, n: u8) -> Option<Command<'static>> {
        let signal = Signal::ALL.into_iter().filter(|signal| self.wants(*signal)).nth(n as usize)?;
        Some(signal.request(self.update(signal)))
    }

    /// The request for one that was changed.
    pub(super) fn changed(&self) -> Option<Command<'static>> {
        let signal = Signal::ALL.into_iter().find(|signal| self.changed & signal.bit() != 0)?;
        Some(signal.request(self.update(signal)))
    }

    /// The gripper has answered this request of the session's own.
    pub(super) fn confirm(&mut self, command: Command<'static>) {
        // Unless it was changed again in the meantime.
        if let Some((signal, update)) = Signal::asked_by(&command)
            && update == self.update(signal)
        {
            self.changed &= !signal.bit();
        }
    }

    /// Changes the command so that it does not end the subscription, as to ask once would (command set, 3.4.1).
    pub(super) fn keep(&self, command: &mut Command<'static>) {
        if let Some((signal, _)) =
            Signal::asked_by(command).filter(|(_, update)| *update == AutoUpdate::once())
        {
            *command = signal.request(self.update(signal));
        }
    }
}
