//! A FAST STOP on its way: sent once, then in bursts with silent pauses between them, until the gripper confirms it.
//!
//! A gripper that took a damaged frame for the head of a long one hears nothing until it has all of that length, or until
//! the line was silent for its frame time-out. A burst is longer than the longest message that a gripper takes, so it ends
//! any false length; a pause is longer than any plausible frame time-out. The manual states neither what a gripper does
//! with half a frame nor its time-out, so both are done in turn.

use super::config::FastStopPattern;
use crate::time::Instant;

/// A FAST STOP, or none.
#[derive(Clone, Debug, Hash)]
pub(super) struct FastStop {
    pattern: FastStopPattern,
    phase: Phase,
    /// At least one frame left since it was opened.
    was_sent: bool,
    /// Since when it is not confirmed, counted from the first frame.
    begun: Option<Instant>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Phase {
    /// There is none.
    Idle,
    /// The first frame is to be sent.
    Due,
    /// It was sent, and its answer may come until then.
    Sent { until: Instant },
    /// So many frames are to be sent, one right behind the other.
    Burst { left: u16 },
    /// Nothing is sent until then.
    Pause { until: Instant },
}

impl FastStop {
    pub(super) const fn new(pattern: FastStopPattern) -> Self {
        Self { pattern, phase: Phase::Idle, was_sent: false, begun: None }
    }

    /// Begins, unless one is on its way already. `at_once`: with a burst, because a Stop before it was not answered.
    pub(super) const fn open(&mut self, at_once: bool) {
        if self.is_idle() {
            self.phase = if at_once { self.burst() } else { Phase::Due };
            self.was_sent = false;
            self.begun = None;
        }
    }

    /// Begins again: what was sent may not have arrived.
    pub(super) const fn send_again(&mut self) {
        if !self.is_idle() {
            self.phase = Phase::Due;
        }
    }

    pub(super) const fn close(&mut self) {
        self.phase = Phase::Idle;
    }

    pub(super) const fn is_idle(&self) -> bool {
        matches!(self.phase, Phase::Idle)
    }

    /// Whether an answer may be one to this FAST STOP.
    pub(super) const fn was_sent(&self) -> bool {
        !self.is_idle() && self.was_sent
    }

    /// Since when the first frame is unanswered.
    pub(super) const fn begun(&self) -> Option<Instant> {
        if self.is_idle() { None } else { self.begun }
    }

    /// Whether a frame is to be sent now; it counts as sent.
    pub(super) fn send(&mut self, now: Instant) -> bool {
        self.phase = match self.phase {
            Phase::Due => Phase::Sent { until: now.plus(self.pattern.answer_ms) },
            Phase::Burst { left: left @ 2.. } => Phase::Burst { left: left.saturating_sub(1) },
            Phase::Burst { .. } => Phase::Pause { until: now.plus(self.pattern.pause_ms) },
            Phase::Idle | Phase::Sent { .. } | Phase::Pause { .. } => return false,
        };
        self.was_sent = true;
        self.begun = self.begun.or(Some(now));
        true
    }

    /// Begins the next burst if it is due at `now`.
    pub(super) fn expire(&mut self, now: Instant) {
        if self.deadline().is_some_and(|until| now.has_reached(until)) {
            self.phase = self.burst();
        }
    }

    pub(super) const fn deadline(&self) -> Option<Instant> {
        match self.phase {
            Phase::Sent { until } | Phase::Pause { until } => Some(until),
            Phase::Idle | Phase::Due | Phase::Burst { .. } => None,
        }
    }

    const fn burst(&self) -> Phase {
        Phase::Burst { left: self.pattern.burst_frames }
    }
}
