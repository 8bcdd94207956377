//! Automatic updates (command set, 3.4.1 to 3.4.6): which are sent, when, after which change, and how long.

use crate::config::Config;
use crate::port::PortKind;
use crate::time::Time;
use wsg_protocol::{AutoUpdate, CommandId, GripperState, SystemFlags, Temperature, UpdateFlags, Value};

/// Smallest change in mm that triggers a width update (command set, 3.4.4).
const WIDTH_CHANGE: f32 = 0.01;
/// Smallest change in mm/s that triggers a speed update (command set, 3.4.5).
const SPEED_CHANGE: f32 = 0.05;
/// Smallest change in N that triggers a force update (command set, 3.4.6).
const FORCE_CHANGE: f32 = 0.05;

/// All values that updates carry, at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Readings {
    pub(crate) flags: SystemFlags,
    pub(crate) state: GripperState,
    /// Opening width in mm; 0 when not referenced.
    pub(crate) width: f32,
    /// Speed of the opening width in mm/s.
    pub(crate) speed: f32,
    /// Force in N, summed over both fingers.
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

    /// Returns the value as the reply to its command.
    pub(crate) const fn value(self, readings: &Readings) -> Value<'static> {
        match self {
            Self::SystemState => Value::GetSystemState(readings.flags),
            Self::GripperState => Value::GetGripperState(readings.state),
            Self::Width => Value::GetOpeningWidth(readings.width),
            Self::Speed => Value::GetSpeed(readings.speed),
            Self::Force => Value::GetForce(readings.force),
        }
    }

    /// Returns the quantity that this command queries.
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

    /// Returns whether the change reaches the threshold of the manual.
    fn differs(self, before: &Readings, now: &Readings) -> bool {
        match self {
            Self::SystemState => before.flags != now.flags,
            Self::GripperState => before.state != now.state,
            Self::Width => (before.width - now.width).abs() >= WIDTH_CHANGE,
            Self::Speed => (before.speed - now.speed).abs() >= SPEED_CHANGE,
            Self::Force => (before.force - now.force).abs() >= FORCE_CHANGE,
        }
    }

    /// Returns whether updates of this quantity are sent. Width updates are suppressed while the fingers are not referenced.
    fn is_sent(self, now: &Readings) -> bool {
        self != Self::Width || now.referenced
    }
}

#[derive(Clone, Copy, Debug)]
struct Subscription {
    on_change: bool,
    period_ms: u16,
    /// When the next update is due; for updates on change, the earliest time.
    due: Time,
    /// The values sent last.
    last: Readings,
}

/// The subscriptions of one connection.
#[derive(Clone, Debug, Default)]
pub(crate) struct Subscriptions([Option<Subscription>; Quantity::ALL.len()]);

impl Subscriptions {
    /// Applies the request that has just been answered with `readings`. Requests of other commands change nothing.
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

    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(crate) fn are_none(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    /// Returns the next time at which an update may be due without an event.
    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        self.0.iter().flatten().map(|subscription| subscription.due).filter(|due| *due > now).min()
    }

    /// Passes due updates to `send`, which returns whether there was room. An update on change without room is retried.
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

/// Idle time-out for the subscriptions of a silent client, on lines that do not report its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Silence {
    /// Time-out in seconds; 0 disables it.
    limit_s: u16,
    last_rx: Time,
}

impl Silence {
    pub(crate) const fn new(kind: PortKind, config: &Config) -> Self {
        let limit_s = if kind.is_connection() { 0 } else { config.updates_idle_s };
        Self { limit_s, last_rx: Time::ZERO }
    }

    pub(crate) const fn reconfigure(&mut self, kind: PortKind, config: &Config) {
        self.limit_s = Self::new(kind, config).limit_s;
    }

    /// Restarts the time-out when the client sends.
    pub(crate) const fn end(&mut self, now: Time) {
        self.last_rx = now;
    }

    /// Returns when the subscriptions end.
    pub(crate) fn due(&self) -> Option<Time> {
        (self.limit_s > 0).then(|| self.last_rx.plus_millis(u64::from(self.limit_s) * 1_000))
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
