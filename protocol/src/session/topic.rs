//! The values that a gripper can send periodically (command set, 3.4).

use super::config::Config;
use super::subscriptions::{Subscription, Subscriptions};
use crate::command::{Command, CommandId};
use crate::types::{AutoUpdate, UpdateFlags};

/// A value that can be subscribed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub enum Topic {
    /// The system state flags (40h). The session always polls them.
    SystemState,
    /// The gripper state (41h). The session always polls it.
    GripperState,
    /// The opening width in mm (43h). Not sent while the fingers are not referenced.
    Width,
    /// The finger speed in mm/s (44h).
    Speed,
    /// The gripping force in N, summed over both fingers (45h).
    Force,
}

impl Topic {
    /// All topics, in the order of their command ids.
    pub const ALL: [Self; 5] = [Self::SystemState, Self::GripperState, Self::Width, Self::Speed, Self::Force];

    /// Returns the id of the command that queries the value.
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

    /// Returns the topic that this command queries.
    #[must_use]
    pub fn of(id: CommandId) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.id() == id)
    }
}

/// A value and its update settings.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub struct Update {
    pub(super) topic: Topic,
    pub(super) update: AutoUpdate,
}

impl Update {
    /// Creates an update as the gripper confirms it: disabled, or with a period of at least 10 ms.
    pub(super) fn new(topic: Topic, update: AutoUpdate) -> Self {
        let update = if update.flags.contains(UpdateFlags::AUTOMATIC) {
            AutoUpdate { period_ms: update.period_ms.max(AutoUpdate::MIN_PERIOD_MS), ..update }
        } else {
            AutoUpdate::once()
        };
        Self { topic, update }
    }
}

impl Subscription for Update {
    type Request = Command<'static>;

    fn name(&self) -> CommandId {
        self.topic.id()
    }

    fn is_wanted(&self) -> bool {
        matches!(self.topic, Topic::SystemState | Topic::GripperState)
            || self.update.flags.contains(UpdateFlags::AUTOMATIC)
    }

    fn request(&self) -> Command<'static> {
        let update = self.update;
        match self.topic {
            Topic::SystemState => Command::GetSystemState { update },
            Topic::GripperState => Command::GetGripperState { update },
            Topic::Width => Command::GetOpeningWidth { update },
            Topic::Speed => Command::GetSpeed { update },
            Topic::Force => Command::GetForce { update },
        }
    }

    fn of(request: &Command<'static>) -> Option<Self> {
        let (topic, update) = match *request {
            Command::GetSystemState { update } => (Topic::SystemState, update),
            Command::GetGripperState { update } => (Topic::GripperState, update),
            Command::GetOpeningWidth { update } => (Topic::Width, update),
            Command::GetSpeed { update } => (Topic::Speed, update),
            Command::GetForce { update } => (Topic::Force, update),
            _ => return None,
        };
        Some(Self { topic, update })
    }
}

/// Returns the initial subscriptions of a session.
pub(super) const fn of_config(config: &Config) -> Subscriptions<Update, { Topic::ALL.len() }> {
    let period_ms = if config.update_period_ms < AutoUpdate::MIN_PERIOD_MS {
        AutoUpdate::MIN_PERIOD_MS
    } else {
        config.update_period_ms
    };
    const fn initial(topic: Topic, wanted: bool, period_ms: u16) -> Update {
        Update { topic, update: if wanted { AutoUpdate::on_change(period_ms) } else { AutoUpdate::once() } }
    }
    Subscriptions::new([
        initial(Topic::SystemState, true, period_ms),
        initial(Topic::GripperState, true, period_ms),
        initial(Topic::Width, config.width, period_ms),
        initial(Topic::Speed, config.speed, period_ms),
        initial(Topic::Force, config.force, period_ms),
    ])
}
