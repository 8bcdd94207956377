//! What is subscribed to, and how (GCL, 3.1.7).

use super::Config;
use crate::gcl::{Autosend, Signal};

#[derive(Debug)]
pub(super) struct Subscriptions {
    /// By signal, in the order of [`Signal::ALL`].
    all: [Autosend; Signal::ALL.len()],
    /// Those that were changed while connected and that the gripper has not confirmed; one bit each.
    changed: u8,
}

const fn bit(signal: Signal) -> u8 {
    1 << signal as u8
}

impl Subscriptions {
    pub(super) const fn new(config: &Config) -> Self {
        const fn initial(signal: Signal, wanted: bool, interval_ms: u32) -> Autosend {
            let interval_ms =
                if interval_ms < Autosend::MIN_INTERVAL_MS { Autosend::MIN_INTERVAL_MS } else { interval_ms };
            if wanted { Autosend::on_change(signal, interval_ms) } else { Autosend::off(signal) }
        }
        let interval_ms = config.interval_ms;
        Self {
            all: [
                initial(Signal::Pos, config.width, interval_ms),
                initial(Signal::Speed, config.speed, interval_ms),
                initial(Signal::Force, config.force, interval_ms),
                initial(Signal::Gripstate, true, interval_ms),
                initial(Signal::Sysflags, true, interval_ms),
                initial(Signal::Temp, config.temperature, interval_ms),
            ],
            changed: 0,
        }
    }

    pub(super) fn set(&mut self, autosend: Autosend) {
        let autosend = match autosend.interval_ms {
            0 => Autosend::off(autosend.signal),
            interval_ms => Autosend { interval_ms: interval_ms.max(Autosend::MIN_INTERVAL_MS), ..autosend },
        };
        if let Some(slot) = self.all.iter_mut().find(|slot| slot.signal == autosend.signal) {
            *slot = autosend;
            self.changed |= bit(autosend.signal);
        }
    }

    fn of(&self, signal: Signal) -> Autosend {
        self.all.iter().find(|slot| slot.signal == signal).copied().unwrap_or(Autosend::off(signal))
    }

    /// Whether it is asked for again and again. The two states are, with updates or without: the session needs them.
    pub(super) fn wants(&self, signal: Signal) -> bool {
        matches!(signal, Signal::Sysflags | Signal::Gripstate) || self.of(signal).interval_ms > 0
    }

    /// The `n`th of those that are asked for again and again.
    pub(super) fn nth(&self, n: u8) -> Option<Autosend> {
        self.all.iter().copied().filter(|slot| self.wants(slot.signal)).nth(n.into())
    }

    /// One that was changed.
    pub(super) fn changed(&self) -> Option<Autosend> {
        self.all.iter().copied().find(|slot| self.changed & bit(slot.signal) != 0)
    }

    /// The gripper has answered this one.
    pub(super) fn confirm(&mut self, autosend: Autosend) {
        // Unless it was changed again in the meantime.
        if self.of(autosend.signal) == autosend {
            self.changed &= !bit(autosend.signal);
        }
    }
}
