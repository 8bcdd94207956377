//! The FAST STOP state machine: one frame, then bursts with silent pauses, until the gripper confirms.
//!
//! A gripper that mistook a damaged frame for the head of a long one ignores everything until that length is complete,
//! or until the line has been silent for its frame time-out. A burst is longer than the longest message that a gripper
//! accepts, so it completes any false length. A pause is longer than any plausible frame time-out. The manual specifies
//! neither the handling of incomplete frames nor the time-out, so the pattern alternates between both remedies.

use super::config::FastStopPattern;
use crate::time::Instant;

/// The FAST STOP in progress, or none.
#[derive(Clone, Debug, Hash)]
pub(super) struct FastStop {
    pattern: FastStopPattern,
    phase: Phase,
    /// Whether at least one frame was sent since it was opened.
    was_sent: bool,
    /// Time of the first frame.
    begun: Option<Instant>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Phase {
    /// No FAST STOP is in progress.
    Idle,
    /// The first frame is waiting to be sent.
    Due,
    /// The first frame was sent, and its reply may arrive until `until`.
    Sent { until: Instant },
    /// `left` more frames are to be sent back to back.
    Burst { left: u16 },
    /// Nothing is sent until `until`.
    Pause { until: Instant },
}

impl FastStop {
    pub(super) const fn new(pattern: FastStopPattern) -> Self {
        Self { pattern, phase: Phase::Idle, was_sent: false, begun: None }
    }

    /// Starts a FAST STOP unless one is in progress. `at_once` starts with a burst, because a preceding Stop was not
    /// answered.
    pub(super) const fn open(&mut self, at_once: bool) {
        if self.is_idle() {
            self.phase = if at_once { self.burst() } else { Phase::Due };
            self.was_sent = false;
            self.begun = None;
        }
    }

    /// Starts again, because the frames sent so far may be lost.
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

    /// Returns whether a reply may belong to this FAST STOP.
    pub(super) const fn was_sent(&self) -> bool {
        !self.is_idle() && self.was_sent
    }

    /// Returns the time of the first frame, while it is unconfirmed.
    pub(super) const fn begun(&self) -> Option<Instant> {
        if self.is_idle() { None } else { self.begun }
    }

    /// Returns whether a frame must be sent now, and counts it as sent.
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

    /// Starts the next burst if it is due at `now`.
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
