//! Unsolicited values (GCL, 3.1.7): which are sent, when, and after which change.

use super::celsius;
use crate::time::Time;
use crate::updates::{Readings, Subscribed, Subscription, Subscriptions};
use wsg_protocol::gcl::{Autosend, Filter, Selected, Topic, Value};

/// The subscriptions of one connection, by topic.
pub(super) type Autosends = Subscriptions<Autosend, { Topic::ALL.len() }>;

impl Autosends {
    /// Applies a request. The first value is sent after one interval.
    pub(super) fn subscribe(&mut self, autosend: Autosend, now: Time) {
        let period_ms = autosend.interval_ms.max(Autosend::MIN_INTERVAL_MS).into();
        let due = now.plus_millis(period_ms);
        let subscription = Subscription { of: autosend, period_ms, due, last: None };
        let kind = Topic::ALL.iter().position(|topic| *topic == autosend.topic);
        self.set(kind, (autosend.interval_ms > 0).then_some(subscription));
    }
}

impl Subscribed for Autosend {
    /// The width is not sent while the fingers are not referenced, as in the binary protocol.
    fn is_sent(self, now: &Readings) -> bool {
        self.topic != Topic::Pos || now.referenced
    }

    fn is_due(self, last: &Readings, now: &Readings) -> bool {
        match self.filter {
            Filter::None | Filter::Unchanged(false) => true,
            Filter::Unchanged(true) => value(self.topic, last) != value(self.topic, now),
            Filter::Delta(delta) => (measured(self.topic, last) - measured(self.topic, now)).abs() >= delta,
        }
    }
}

fn measured(topic: Topic, readings: &Readings) -> f32 {
    match topic {
        Topic::Pos => readings.width,
        Topic::Speed => readings.speed,
        Topic::Force => readings.force,
        Topic::Temp => celsius(readings),
        Topic::Gripstate | Topic::Sysflags => 0.0,
    }
}

pub(super) fn value(topic: Topic, readings: &Readings) -> Value<'static> {
    match topic {
        Topic::Pos => Value::Pos(readings.width),
        Topic::Speed => Value::Speed(readings.speed),
        Topic::Force => Value::Force(readings.force),
        Topic::Gripstate => Value::Gripstate(readings.state),
        Topic::Sysflags => Value::Sysflags(Selected::All(readings.flags)),
        Topic::Temp => Value::Temp(celsius(readings)),
    }
}
