//! Subscriptions to values (GCL, 3.1.7).

use super::Config;
use crate::gcl::{Autosend, CommandName, Request, Topic};
use crate::session::subscriptions::{Subscription, Subscriptions};

impl Subscription for Autosend {
    type Request = Request;

    fn name(&self) -> CommandName {
        self.topic.name()
    }

    fn is_wanted(&self) -> bool {
        matches!(self.topic, Topic::Sysflags | Topic::Gripstate) || self.interval_ms > 0
    }

    fn request(&self) -> Request {
        Request::Autosend(*self)
    }

    fn of(request: &Request) -> Option<Self> {
        match request {
            Request::Autosend(autosend) => Some(*autosend),
            _ => None,
        }
    }
}

/// Returns the initial subscriptions of a session, in the order of [`Topic::ALL`].
pub(super) const fn of_config(config: &Config) -> Subscriptions<Autosend, { Topic::ALL.len() }> {
    const fn initial(topic: Topic, wanted: bool, interval_ms: u32) -> Autosend {
        let interval_ms =
            if interval_ms < Autosend::MIN_INTERVAL_MS { Autosend::MIN_INTERVAL_MS } else { interval_ms };
        if wanted { Autosend::on_change(topic, interval_ms) } else { Autosend::off(topic) }
    }
    let interval_ms = config.interval_ms;
    Subscriptions::new([
        initial(Topic::Pos, config.width, interval_ms),
        initial(Topic::Speed, config.speed, interval_ms),
        initial(Topic::Force, config.force, interval_ms),
        initial(Topic::Gripstate, true, interval_ms),
        initial(Topic::Sysflags, true, interval_ms),
        initial(Topic::Temp, config.temperature, interval_ms),
    ])
}

/// Returns the subscription as the gripper accepts it: disabled, or at least 10 ms apart.
pub(super) fn rounded(autosend: Autosend) -> Autosend {
    match autosend.interval_ms {
        0 => Autosend::off(autosend.topic),
        interval_ms => Autosend { interval_ms: interval_ms.max(Autosend::MIN_INTERVAL_MS), ..autosend },
    }
}
