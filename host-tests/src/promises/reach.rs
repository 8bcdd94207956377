//! Whether a FAST STOP has reached the gripper, and what may delay it.

use wsg_protocol::Instant;

/// Time until FAST STOP reaches the gripper, in milliseconds: after the last fault, and with at most one fault.
const HEALTHY_MS: u32 = 1_000;
const ONE_FAULT_MS: u32 = 250;

/// Faults of the line, and the FAST STOPs that the gripper has executed.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Reach {
    /// Whether the gripper receives and answers.
    pub(crate) is_alive: bool,
    /// Whether forged messages have been sent in its name.
    pub(crate) is_forged: bool,
    /// Times of the last two faults.
    faults: [Option<Instant>; 2],
    /// Time of the last FAST STOP that it received, and of leaving one without the bridge's acknowledgement.
    fast_stop: Option<Instant>,
    left: Option<Instant>,
}

impl Reach {
    pub(crate) const fn new(is_alive: bool) -> Self {
        Self { is_alive, is_forged: false, faults: [None; 2], fast_stop: None, left: None }
    }

    /// Records a fault of the line.
    pub(crate) fn fault(&mut self, now: Instant) {
        if self.faults[0] != Some(now) {
            self.faults = [Some(now), self.faults[0]];
        }
    }

    /// Records the end of an outage, in which a whole burst of FAST STOPs may have been lost. That is not a single fault.
    pub(crate) const fn recover(&mut self, now: Instant) {
        self.faults = [Some(now); 2];
    }

    pub(crate) const fn receive_fast_stop(&mut self, now: Instant) {
        self.fast_stop = Some(now);
    }

    pub(crate) const fn leave_fast_stop(&mut self, now: Instant) {
        self.left = Some(now);
    }

    /// Records that the gripper has entered FAST STOP by itself. The gripper has not left it yet.
    pub(crate) const fn enter_fast_stop(&mut self) {
        self.left = None;
    }

    /// Returns whether the gripper has received a FAST STOP since the request, or may still be waiting for it. A silent
    /// gripper cannot receive. While FAST STOP `is_held`, a gripper that has left it must receive another, unless its states were
    /// unknown until `unlinked`.
    pub(super) fn has_stopped(
        &self,
        now: Instant,
        requested: Instant,
        unlinked: Instant,
        is_held: bool,
    ) -> bool {
        let is_later = |left: &Instant| left.since(requested) > 0;
        let (since, healthy_ms) = match (self.left.filter(is_later).filter(|_| is_held), self.faults) {
            // The bridge depends on a report, which may be late or lost.
            (Some(left), faults) => {
                let known = later_of(unlinked, left);
                (left, faults[0].map_or(known, |fault| later_of(fault, known)).plus(HEALTHY_MS))
            }
            (None, [Some(last), Some(second)]) if !requested.has_reached(second.plus(HEALTHY_MS)) => {
                (requested, later_of(last, requested).plus(HEALTHY_MS))
            }
            (None, _) => (requested, requested.plus(ONE_FAULT_MS)),
        };
        let has_received = self.fast_stop.is_some_and(|received| received.has_reached(since));
        has_received || !self.is_alive || self.is_forged || healthy_ms.has_reached(now)
    }
}

fn later_of(one: Instant, other: Instant) -> Instant {
    if one.has_reached(other) { one } else { other }
}
