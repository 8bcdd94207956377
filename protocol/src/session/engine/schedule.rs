//! Which request is due next: from the queue, a setup step, a refresh, or the upkeep of known settings.

use super::{Engine, Link, REFRESH_REPEATS, Upkeep};
use crate::session::dialect::Dialect;
use crate::session::message::Message;
use crate::session::subscriptions::List;
use crate::session::transaction::Request;
use crate::time::Instant;

impl<D: Dialect> Engine<D> {
    /// Opens the next request that is due: from the queue, a setup step or a refresh.
    pub(super) fn advance(&mut self, now: Instant) {
        if self.is_connected()
            && !self.is_urgent()
            && self.request.is_idle()
            && !self.may_take_a_doubled_answer()
            && let Some(request) = self.queue.pop_front()
        {
            self.request.open(request, self.request_timeout(&request));
        }
        if !self.refresh.is_idle() {
            return;
        }
        if self.is_connected()
            && let Some(changed) = self.subscriptions.changed()
        {
            self.open_refresh(changed);
            return;
        }
        match self.link {
            // A pending FAST STOP or Stop is the first message to the gripper.
            Link::Down { retry_at } => {
                if !self.is_urgent() && retry_at.is_none_or(|at| now.has_reached(at)) {
                    self.link = Link::Connecting { step: 0 };
                    self.open_step(0);
                }
            }
            Link::Connecting { step } => self.open_step(step),
            Link::Up { mut refresh_at, refresh_step } if now.has_reached(refresh_at) => {
                if let Some(request) = self.dialect.refresh(refresh_step, &self.subscriptions) {
                    self.open_refresh(request);
                    refresh_at = now.plus(self.refresh_interval_ms());
                }
                let next = refresh_step.saturating_add(1);
                let has_next = self.dialect.refresh(next, &self.subscriptions).is_some();
                self.link = Link::Up { refresh_at, refresh_step: if has_next { next } else { 0 } };
            }
            Link::Up { .. } | Link::Closing { .. } | Link::Ended => {}
        }
    }

    /// Returns the interval between two refreshes, in milliseconds. Within `refresh_ms` each value is requested once.
    pub(super) fn refresh_interval_ms(&self) -> u32 {
        let is_value = |step: &u8| self.dialect.refresh(*step, &self.subscriptions).is_some();
        let values = (0..=u8::MAX).take_while(is_value).fold(0u32, |count, _| count.saturating_add(1));
        self.timing.refresh_ms.checked_div(values).unwrap_or(self.timing.refresh_ms)
    }

    /// Returns whether an upkeep query was sent and its reply is outstanding. It is sent only once.
    pub(super) fn upkeep_is_sent(&self) -> bool {
        self.refresh.deadline().is_some() && self.holds_upkeep()
    }

    fn holds_upkeep(&self) -> bool {
        self.refresh.own().is_some_and(|request| D::UPKEEP == Some(request.name()))
    }

    /// Returns since when the next upkeep query is due, after half of the lifetime of the known settings.
    pub(super) fn upkeep_at(&self) -> Option<Instant> {
        self.confirmed().map(|at| at.plus(self.timing.refresh_ms / 2))
    }

    /// Returns when the query was opened that last confirmed the known settings.
    const fn confirmed(&self) -> Option<Instant> {
        match self.upkeep {
            Upkeep::Idle => None,
            Upkeep::Confirmed(confirmed) | Upkeep::Queried { confirmed, .. } => Some(confirmed),
        }
    }

    /// Queries the known settings again, and forgets them if they were not confirmed in time.
    // Rarely due.
    #[inline(never)]
    pub(super) fn keep_up(&mut self, now: Instant) {
        let Some(confirmed) = self.confirmed() else { return };
        let is_late = self.upkeep_is_sent() && self.refresh.is_overdue(now);
        if is_late {
            // Not repeated: of two replies the later one could be mistaken for a read-back.
            self.refresh.close();
        }
        if is_late || now.has_reached(confirmed.plus(self.timing.refresh_ms)) {
            D::forget_settings(&mut self.known);
        }
        match D::upkeep(&self.known) {
            Some(query) if self.refresh.is_idle() => {
                self.upkeep = Upkeep::Queried { confirmed, opened: now };
                self.open_refresh(query);
            }
            None if !self.holds_upkeep() => self.upkeep = Upkeep::Idle,
            _ => {}
        }
    }

    /// Returns whether the next queued request could be answered by the second reply to an earlier request of the same
    /// name.
    fn may_take_a_doubled_answer(&self) -> bool {
        self.doubled.is_some_and(|(name, _)| self.queue.front().map(Request::name) == Some(name))
    }

    fn open_step(&mut self, step: u8) {
        if let Some(request) = self.dialect.setup(step, &self.subscriptions) {
            self.open_refresh(request);
        }
    }

    /// Opens one of the session's own requests. While connected, it uses a short time-out so that a lost reply does not
    /// leave a state outdated.
    fn open_refresh(&mut self, request: D::Request) {
        let reply_ms = self.timing.reply_timeout(request.name());
        let timeout_ms = if self.is_connected() { (reply_ms / REFRESH_REPEATS).max(1) } else { reply_ms };
        self.refresh.open(Request::Own(request), timeout_ms);
    }
}
