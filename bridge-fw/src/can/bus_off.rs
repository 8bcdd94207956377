//! Recovery after bus-off, and its limit.

use wsg_protocol::Instant;

/// Reaction to bus-off. All times are in milliseconds.
///
/// A controller goes bus-off after repeated failures to send: a short circuit, a wrong bit rate, a broken transceiver. If it
/// rejoined immediately each time, it would disturb the other nodes permanently.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusOffPolicy {
    /// Time that the controller stays off before it tries to recover.
    pub delay_ms: u32,
    /// Longest recovery. A longer one counts as another failure. At 125 kbit/s on a full bus, it takes 150 ms.
    pub recovery_ms: u32,
    /// Number of failures without a stable time in between after which the controller stays off until
    /// [`retry`](super::CanBus::retry) or power-up. 0: unlimited.
    pub limit: u8,
    /// Time without a failure after which the number of failures is reset.
    pub stable_ms: u32,
}

impl BusOffPolicy {
    /// Recovery after 100 ms, at most ten times. Ten seconds without a failure are stable.
    pub const DEFAULT: Self = Self { delay_ms: 100, recovery_ms: 500, limit: 10, stable_ms: 10_000 };
}

/// Participation of the bridge in the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BusState {
    /// On the bus.
    #[default]
    On,
    /// Bus-off, during the delay.
    Off,
    /// Bus-off, the controller is recovering.
    Recovering,
    /// Bus-off, given up.
    GivenUp,
}

/// Action for the current turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    Nothing,
    /// The bus is lost: discard waiting frames.
    Leave,
    /// Start the recovery of the controller.
    Recover,
    /// The bus has recovered.
    Join,
}

#[derive(Clone, Debug)]
pub(super) struct BusOff {
    policy: BusOffPolicy,
    state: BusState,
    /// Time of entering this state.
    since: Instant,
    /// Failures since the last stable time.
    failures: u8,
}

impl BusOff {
    pub(super) const fn new(policy: BusOffPolicy) -> Self {
        Self { policy, state: BusState::On, since: Instant::from_millis(0), failures: 0 }
    }

    pub(super) const fn state(&self) -> BusState {
        self.state
    }

    /// Updates the state with the controller's.
    pub(super) fn update(&mut self, now: Instant, is_off: bool) -> Step {
        let waited = |ms: u32| now.since(self.since) >= ms;
        match self.state {
            BusState::On if is_off => {
                self.fail(now);
                Step::Leave
            }
            BusState::On => {
                if waited(self.policy.stable_ms) {
                    self.failures = 0;
                }
                Step::Nothing
            }
            BusState::Off if waited(self.policy.delay_ms) => {
                self.enter(BusState::Recovering, now);
                Step::Recover
            }
            BusState::Recovering if !is_off => {
                self.enter(BusState::On, now);
                Step::Join
            }
            BusState::Recovering if waited(self.policy.recovery_ms) => {
                self.fail(now);
                Step::Nothing
            }
            BusState::Off | BusState::Recovering | BusState::GivenUp => Step::Nothing,
        }
    }

    /// Restarts the recovery after it was given up.
    pub(super) fn retry(&mut self, now: Instant) {
        if self.state == BusState::GivenUp {
            self.failures = 0;
            self.enter(BusState::Off, now);
        }
    }

    fn fail(&mut self, now: Instant) {
        self.failures = self.failures.saturating_add(1);
        let is_last = self.policy.limit > 0 && self.failures >= self.policy.limit;
        self.enter(if is_last { BusState::GivenUp } else { BusState::Off }, now);
    }

    fn enter(&mut self, state: BusState, now: Instant) {
        (self.state, self.since) = (state, now);
    }
}

#[cfg(test)]
mod tests;
