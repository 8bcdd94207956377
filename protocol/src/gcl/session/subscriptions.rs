//! What is subscribed to, and how (GCL, 3.1.7).

use super::Config;
use crate::gcl::{Autosend, CommandName, Request, Signal};
use crate::session::subscriptions::{Subscription, Subscriptions};

impl Subscription for Autosend {
    type Request = Request;

    fn name(&self) -> CommandName {
        self.signal.name()
    }

    fn is_wanted(&self) -> bool {
        matches!(self.signal, Signal::Sysflags | Signal::Gripstate) || self.interval_ms > 0
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

/// Returns the subscriptions that a session begins with, by signal in the order of [`Signal::ALL`].
pub(super) const fn of_config(config: &Config) -> Subscriptions<Autosend, { Signal::ALL.len() }> {
    const fn initial(signal: Signal, wanted: bool, interval_ms: u32) -> Autosend {
        let interval_ms =
            if interval_ms < Autosend::MIN_INTERVAL_MS { Autosend::MIN_INTERVAL_MS } else { interval_ms };
        if wanted { Autosend::on_change(signal, interval_ms) } else { Autosend::off(signal) }
    }
    let interval_ms = config.interval_ms;
    Subscriptions::new([
        initial(Signal::Pos, config.width, interval_ms),
        initial(Signal::Speed, config.speed, interval_ms),
        initial(Signal::Force, config.force, interval_ms),
        initial(Signal::Gripstate, true, interval_ms),
        initial(Signal::Sysflags, true, interval_ms),
        initial(Signal::Temp, config.temperature, interval_ms),
    ])
}

/// Returns the subscription as the gripper takes it: none, or at least 10 ms apart.
pub(super) fn rounded(autosend: Autosend) -> Autosend {
    match autosend.interval_ms {
        0 => Autosend::off(autosend.signal),
        interval_ms => Autosend { interval_ms: interval_ms.max(Autosend::MIN_INTERVAL_MS), ..autosend },
    }
}
