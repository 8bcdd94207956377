//! Automatic updates (command set, 3.4.1 to 3.4.6): which are sent, when, after which change, and how long.

use crate::config::Config;
use crate::port::PortKind;
use crate::time::{Time, earlier};
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
}

/// The updates of one quantity, as a client requests them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Update {
    quantity: Quantity,
    on_change: bool,
}

impl Update {
    /// Returns the value as the reply to its command.
    pub(crate) const fn value(self, readings: &Readings) -> Value<'static> {
        self.quantity.value(readings)
    }
}

impl Subscribed for Update {
    /// Width updates are suppressed while the fingers are not referenced.
    fn is_sent(self, now: &Readings) -> bool {
        self.quantity != Quantity::Width || now.referenced
    }

    fn is_due(self, last: &Readings, now: &Readings) -> bool {
        !self.on_change || (self.is_sent(now) && self.quantity.differs(last, now))
    }
}

/// The subscriptions of a client of the binary protocol.
pub(crate) type Updates = Subscriptions<Update, { Quantity::ALL.len() }>;

impl Updates {
    /// Applies the request that has just been answered with `readings`. Requests of other commands change nothing.
    pub(crate) fn request(&mut self, id: CommandId, update: AutoUpdate, now: Time, readings: Readings) {
        let Some(quantity) = Quantity::of(id) else { return };
        let period_ms = update.period_ms.max(AutoUpdate::MIN_PERIOD_MS).into();
        let of = Update { quantity, on_change: update.flags.contains(UpdateFlags::ON_CHANGE) };
        let subscription = update.flags.contains(UpdateFlags::AUTOMATIC).then_some(Subscription {
            of,
            period_ms,
            due: now.plus_millis(period_ms),
            last: Some(readings),
        });
        self.set(Quantity::ALL.iter().position(|known| *known == quantity), subscription);
    }
}

/// A value that a client has subscribed to, and its condition.
pub(crate) trait Subscribed: Copy {
    /// Returns whether the value is sent at present. Otherwise it counts as sent.
    fn is_sent(self, now: &Readings) -> bool;

    /// Returns whether the condition holds, by the values sent last.
    fn is_due(self, last: &Readings, now: &Readings) -> bool;
}

/// The subscription to one value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subscription<T> {
    pub(crate) of: T,
    pub(crate) period_ms: u64,
    /// When the next update is due; for updates on change, the earliest time.
    pub(crate) due: Time,
    /// The values sent last, if the first update waits for a change from them.
    pub(crate) last: Option<Readings>,
}

/// The subscriptions of one connection, by kind of value.
#[derive(Clone, Debug)]
pub(crate) struct Subscriptions<T, const KINDS: usize> {
    by_kind: [Option<Subscription<T>>; KINDS],
    silence: Silence,
}

impl<T: Subscribed, const KINDS: usize> Subscriptions<T, KINDS> {
    pub(crate) const fn new(kind: PortKind, config: &Config) -> Self {
        Self { by_kind: [const { None }; KINDS], silence: Silence::new(kind, config) }
    }

    /// Takes over the settings, and keeps the subscriptions.
    pub(crate) const fn reconfigure(&mut self, kind: PortKind, config: &Config) {
        self.silence.limit_s = Silence::new(kind, config).limit_s;
    }

    /// Replaces the subscription to this kind of value.
    pub(crate) fn set(&mut self, kind: Option<usize>, subscription: Option<Subscription<T>>) {
        if let Some(slot) = kind.and_then(|kind| self.by_kind.get_mut(kind)) {
            *slot = subscription;
        }
    }

    /// Restarts the idle time-out when the client sends.
    pub(crate) const fn end_silence(&mut self, now: Time) {
        self.silence.last_rx = now;
    }

    /// Ends the subscriptions of a client that has been silent for too long.
    pub(crate) fn expire(&mut self, now: Time) {
        if self.silence.due().is_some_and(|due| due <= now) {
            self.clear();
        }
    }

    pub(crate) fn clear(&mut self) {
        self.by_kind = [const { None }; KINDS];
    }

    /// Returns the next time at which an update may be due, or the subscriptions end, without an event.
    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        let subscriptions = self.by_kind.iter().flatten();
        let end = subscriptions.clone().next().and_then(|_| self.silence.due());
        earlier(subscriptions.map(|subscription| subscription.due).filter(|due| *due > now).min(), end)
    }

    /// Passes due updates to `send`, which returns whether there was room. An update on change without room is retried.
    pub(crate) fn publish(&mut self, now: Time, readings: &Readings, mut send: impl FnMut(T) -> bool) {
        for Subscription { of, period_ms, due, last } in self.by_kind.iter_mut().flatten() {
            if *due > now || last.is_some_and(|last| !of.is_due(&last, readings)) {
                continue;
            }
            if !of.is_sent(readings) || send(*of) {
                *last = Some(*readings);
            }
            *due = now.plus_millis(*period_ms);
        }
    }
}

/// Idle time-out for the subscriptions of a silent client, on lines that do not report its end.
#[derive(Clone, Copy, Debug)]
struct Silence {
    /// Time-out in seconds; 0 disables it.
    limit_s: u16,
    last_rx: Time,
}

impl Silence {
    const fn new(kind: PortKind, config: &Config) -> Self {
        let limit_s = if kind.is_connection() { 0 } else { config.updates_idle_s };
        Self { limit_s, last_rx: Time::ZERO }
    }

    /// Returns when the subscriptions end.
    fn due(&self) -> Option<Time> {
        (self.limit_s > 0).then(|| self.last_rx.plus_millis(u64::from(self.limit_s) * 1_000))
    }
}
