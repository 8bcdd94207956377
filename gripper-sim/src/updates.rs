//! Automatic updates (command set, 3.4.1 to 3.4.6): what is sent by itself, when, at which change, and until when.

use crate::config::Config;
use crate::port::PortKind;
use crate::time::Time;
use wsg_protocol::{AutoUpdate, CommandId, GripperState, SystemFlags, Temperature, UpdateFlags, Value};

/// The change in mm that a width update needs (command set, 3.4.4).
const WIDTH_CHANGE: f32 = 0.01;
/// The change in mm/s that a speed update needs (command set, 3.4.5).
const SPEED_CHANGE: f32 = 0.05;
/// The change in N that a force update needs (command set, 3.4.6).
const FORCE_CHANGE: f32 = 0.05;

/// Every value that updates carry, at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Readings {
    pub(crate) flags: SystemFlags,
    pub(crate) state: GripperState,
    /// mm; 0 when not referenced.
    pub(crate) width: f32,
    /// mm/s.
    pub(crate) speed: f32,
    /// N.
    pub(crate) force: f32,
    pub(crate) referenced: bool,
    pub(crate) temperature: Temperature,
}

/// A value that can be subscribed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quantity {
    SystemState,
    GripperState,
    Width,
    Speed,
    Force,
}

impl Quantity {
    const ALL: [Self; 5] = [Self::SystemState, Self::GripperState, Self::Width, Self::Speed, Self::Force];

    /// Its value as the reply to its command.
    pub(crate) const fn value(self, readings: &Readings) -> Value<'static> {
        match self {
            Self::SystemState => Value::GetSystemState(readings.flags),
            Self::GripperState => Value::GetGripperState(readings.state),
            Self::Width => Value::GetOpeningWidth(readings.width),
            Self::Speed => Value::GetSpeed(readings.speed),
            Self::Force => Value::GetForce(readings.force),
        }
    }

    /// The quantity that this command asks for.
    fn of(id: CommandId) -> Option<Self> {
        Some(match id {
            CommandId::GetSystemState => Self::SystemState,
            CommandId::GetGripperState => Self::GripperState,
            CommandId::GetOpeningWidth => Self::Width,
            CommandId::GetSpeed => Self::Speed,
            CommandId::GetForce => Self::Force,
            _ => return None,
        })
    }

    /// Whether it changed as much as the manual asks for.
    fn differs(self, before: &Readings, now: &Readings) -> bool {
        match self {
            Self::SystemState => before.flags != now.flags,
            Self::GripperState => before.state != now.state,
            Self::Width => (before.width - now.width).abs() >= WIDTH_CHANGE,
            Self::Speed => (before.speed - now.speed).abs() >= SPEED_CHANGE,
            Self::Force => (before.force - now.force).abs() >= FORCE_CHANGE,
        }
    }

    /// Whether updates of it are sent: the width has none as long as the fingers are not referenced.
    fn is_sent(self, now: &Readings) -> bool {
        self != Self::Width || now.referenced
    }
}

#[derive(Clone, Copy, Debug)]
struct Subscription {
    on_change: bool,
    period_ms: u16,
    /// When the next update is due; on change: before which there is none.
    due: Time,
    /// What was sent last.
    last: Readings,
}

/// What one connection has subscribed to.
#[derive(Clone, Debug, Default)]
pub(crate) struct Subscriptions([Option<Subscription>; Quantity::ALL.len()]);

impl Subscriptions {
    /// Takes the request that has just been answered with `readings`; requests of other commands change nothing.
    pub(crate) fn request(&mut self, id: CommandId, update: AutoUpdate, now: Time, readings: Readings) {
        let Some(quantity) = Quantity::of(id) else { return };
        let period_ms = update.period_ms.max(AutoUpdate::MIN_PERIOD_MS);
        let subscription = update.flags.contains(UpdateFlags::AUTOMATIC).then_some(Subscription {
            on_change: update.flags.contains(UpdateFlags::ON_CHANGE),
            period_ms,
            due: now.plus_millis(period_ms.into()),
            last: readings,
        });
        for (slot, of) in self.0.iter_mut().zip(Quantity::ALL) {
            if of == quantity {
                *slot = subscription;
            }
        }
    }

    /// Ends all of them.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(crate) fn are_none(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    /// When there may be something to send again, other than because something happens.
    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        self.0.iter().flatten().map(|subscription| subscription.due).filter(|due| *due > now).min()
    }

    /// Gives what is due to `send`, which says whether it found room; an update on change that did not is tried again.
    pub(crate) fn publish(
        &mut self,
        now: Time,
        readings: &Readings,
        mut send: impl FnMut(Value<'static>) -> bool,
    ) {
        for (slot, quantity) in self.0.iter_mut().zip(Quantity::ALL) {
            let Some(subscription) = slot else { continue };
            if subscription.due > now || subscription.waits_for_change(quantity, readings) {
                continue;
            }
            let sent = !quantity.is_sent(readings) || send(quantity.value(readings));
            if sent {
                subscription.last = *readings;
            }
            subscription.due = now.plus_millis(subscription.period_ms.into());
        }
    }
}

/// Until when a client is sent updates that sends nothing itself, where nothing tells of its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Silence {
    /// 0: for ever.
    limit_s: u16,
    heard: Time,
}

impl Silence {
    pub(crate) const fn new(kind: PortKind, config: &Config) -> Self {
        let limit_s = if kind.is_connection() { 0 } else { config.updates_idle_s };
        Self { limit_s, heard: Time::ZERO }
    }

    /// The client has sent something.
    pub(crate) const fn end(&mut self, now: Time) {
        self.heard = now;
    }

    /// When its subscriptions end.
    pub(crate) fn due(&self) -> Option<Time> {
        (self.limit_s > 0).then(|| self.heard.plus_millis(u64::from(self.limit_s) * 1_000))
    }

    pub(crate) fn is_too_long(&self, now: Time) -> bool {
        self.due().is_some_and(|due| due <= now)
    }
}

impl Subscription {
    fn waits_for_change(&self, quantity: Quantity, readings: &Readings) -> bool {
        self.on_change && !(quantity.is_sent(readings) && quantity.differs(&self.last, readings))
    }
}
