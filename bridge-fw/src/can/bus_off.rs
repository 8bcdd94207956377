//! When to come back after bus-off, and when to give up.

use wsg_protocol::Instant;

/// What is done about bus-off. All times in milliseconds.
///
/// A controller goes bus-off after its own sending has failed too often: a short circuit, a wrong bit rate, a broken
/// transceiver. One that came back at once, again and again, would disturb the others for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusOffPolicy {
    /// How long the controller stays off before it tries to come back.
    pub delay_ms: u32,
    /// How long coming back may take before that counts as another failure. At 125 kbit/s on a full bus it takes 150 ms.
    pub recovery_ms: u32,
    /// After how many failures without a stable time in between it stays off until it is told to
    /// [`retry`](super::CanBus::retry), or until power-up. 0: never.
    pub limit: u8,
    /// How long the bus must have gone well for the failures to be forgotten.
    pub stable_ms: u32,
}

impl BusOffPolicy {
    /// Back after 100 ms, ten times; ten seconds without a failure count as stable.
    pub const DEFAULT: Self = Self { delay_ms: 100, recovery_ms: 500, limit: 10, stable_ms: 10_000 };
}

/// How the bridge stands to the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BusState {
    /// It takes part.
    #[default]
    On,
    /// Bus-off; the delay runs.
    Off,
    /// Bus-off; the controller is on its way back.
    Recovering,
    /// Bus-off, and given up.
    GivenUp,
}

/// What is to be done now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    Nothing,
    /// The bus is lost: forget what waits.
    Leave,
    /// Tell the controller to come back.
    Recover,
    /// The bus is there again.
    Join,
}

#[derive(Clone, Debug)]
pub(super) struct BusOff {
    policy: BusOffPolicy,
    state: BusState,
    /// Since when it is in this state.
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

    /// One look at the controller.
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

    /// Begins anew after it was given up.
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
