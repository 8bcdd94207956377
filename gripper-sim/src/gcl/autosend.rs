//! Unsolicited values (GCL, 3.1.7): which are sent, when, and after which change.

use super::celsius;
use crate::time::Time;
use crate::updates::Readings;
use wsg_protocol::gcl::{Autosend, Filter, Selected, Topic, Value};

#[derive(Clone, Copy, Debug)]
struct TopicSubscription {
    autosend: Autosend,
    /// Earliest time of the next value.
    due: Time,
    /// The values sent last.
    last: Option<Readings>,
}

/// The subscriptions of one connection, by topic.
#[derive(Clone, Debug, Default)]
pub(super) struct Autosends([Option<TopicSubscription>; Topic::ALL.len()]);

impl Autosends {
    /// Applies a request. The first value is sent after one interval.
    pub(super) fn request(&mut self, autosend: Autosend, now: Time) {
        let interval_ms = autosend.interval_ms.max(Autosend::MIN_INTERVAL_MS);
        let subscription = (autosend.interval_ms > 0).then_some(TopicSubscription {
            autosend: Autosend { interval_ms, ..autosend },
            due: now.plus_millis(interval_ms.into()),
            last: None,
        });
        for (slot, topic) in self.0.iter_mut().zip(Topic::ALL) {
            if topic == autosend.topic {
                *slot = subscription;
            }
        }
    }

    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(super) fn are_none(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    /// Returns the next time at which a value may be due without an event.
    pub(super) fn next_due(&self, now: Time) -> Option<Time> {
        self.0.iter().flatten().map(|subscription| subscription.due).filter(|due| *due > now).min()
    }

    /// Passes due values to `send`, which returns whether there was room. A change without room is retried.
    pub(super) fn publish(
        &mut self,
        now: Time,
        readings: &Readings,
        mut send: impl FnMut(Value<'static>) -> bool,
    ) {
        for subscription in self.0.iter_mut().flatten() {
            let topic = subscription.autosend.topic;
            if subscription.due > now || subscription.waits_for_change(readings) {
                continue;
            }
            // The width is not sent while the fingers are not referenced, as in the binary protocol.
            let is_sent = topic != Topic::Pos || readings.referenced;
            if !is_sent || send(value(topic, readings)) {
                subscription.last = Some(*readings);
            }
            subscription.due = now.plus_millis(subscription.autosend.interval_ms.into());
        }
    }
}

impl TopicSubscription {
    fn waits_for_change(&self, now: &Readings) -> bool {
        let Some(last) = &self.last else { return false };
        let topic = self.autosend.topic;
        match self.autosend.filter {
            Filter::None | Filter::Unchanged(false) => false,
            Filter::Unchanged(true) => value(topic, last) == value(topic, now),
            Filter::Delta(delta) => (measured(topic, last) - measured(topic, now)).abs() < delta,
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

fn value(topic: Topic, readings: &Readings) -> Value<'static> {
    match topic {
        Topic::Pos => Value::Pos(readings.width),
        Topic::Speed => Value::Speed(readings.speed),
        Topic::Force => Value::Force(readings.force),
        Topic::Gripstate => Value::Gripstate(readings.state),
        Topic::Sysflags => Value::Sysflags(Selected::All(readings.flags)),
        Topic::Temp => Value::Temp(celsius(readings)),
    }
}
