//! A single request: idle, waiting to be sent, or sent with its first reply outstanding.

use super::message::{Message, Name};
use crate::time::Instant;

/// An unanswered request.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(crate) enum Request<M: Message> {
    /// Stored in the session.
    Own(M),
    /// Kept by the caller, who provides it for sending.
    Borrowed(M::Name),
    /// Borrowed from a caller that no longer exists; already sent and not repeated.
    Orphan(M::Name),
}

/// A request to be sent now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Outgoing<'s, M> {
    /// The FAST STOP request.
    FastStop,
    /// A request stored in the session.
    Own(&'s M),
    /// The request kept by the caller.
    Borrowed,
}

impl<M: Message> Request<M> {
    pub(super) fn name(&self) -> M::Name {
        match self {
            Self::Own(message) => message.name(),
            Self::Borrowed(name) | Self::Orphan(name) => *name,
        }
    }

    pub(super) fn is_repeatable(&self) -> bool {
        match self {
            Self::Own(message) => message.is_repeatable(),
            Self::Borrowed(name) | Self::Orphan(name) => name.is_repeatable(),
        }
    }

    /// Returns the request to send, if available. `borrowed` is the name of the request that the caller provides.
    fn outgoing(&self, borrowed: Option<M::Name>) -> Option<Outgoing<'_, M>> {
        match self {
            Self::Own(message) => Some(Outgoing::Own(message)),
            Self::Borrowed(name) => (borrowed == Some(*name)).then_some(Outgoing::Borrowed),
            Self::Orphan(_) => None,
        }
    }
}

/// The state of a single request.
#[derive(Clone, Debug, Hash)]
pub(super) struct Transaction<M: Message> {
    /// `None` while the transaction is idle.
    request: Option<Request<M>>,
    /// Time-out for the reply, in milliseconds.
    timeout_ms: u32,
    /// Time at which the reply is overdue; `None` while the request waits to be sent.
    deadline: Option<Instant>,
    /// Number of times the request was sent.
    sent: u8,
    /// Time of the first transmission.
    begun: Instant,
    /// Whether repeating is forbidden.
    only_once: bool,
}

/// The result of checking for a time-out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expired {
    /// No time-out, or the requester no longer exists.
    No,
    /// The request will be repeated.
    Repeated,
    /// The last retry timed out, or the request is not repeatable. It stays open for [`Transaction::abandon`].
    GivenUp,
    /// A more urgent request overtook it, so it is not repeated. It stays open for [`Transaction::abandon`].
    Overtaken,
}

impl<M: Message> Transaction<M> {
    pub(super) const fn new() -> Self {
        let begun = Instant::from_millis(0);
        Self { request: None, timeout_ms: 0, deadline: None, sent: 0, begun, only_once: false }
    }

    /// Replaces the previous request with this one. `timeout_ms` applies to each transmission.
    pub(super) fn open(&mut self, request: Request<M>, timeout_ms: u32) {
        *self = Self { request: Some(request), timeout_ms, ..Self::new() };
    }

    pub(super) const fn close(&mut self) {
        *self = Self::new();
    }

    pub(super) const fn is_idle(&self) -> bool {
        self.request.is_none()
    }

    /// Returns the name of the open request.
    pub(super) fn name(&self) -> Option<M::Name> {
        self.request.as_ref().map(Request::name)
    }

    /// Returns the open request if it is stored in the session.
    pub(super) const fn own(&self) -> Option<&M> {
        match &self.request {
            Some(Request::Own(message)) => Some(message),
            _ => None,
        }
    }

    /// Returns whether a request of this name is open, sent or not.
    pub(super) fn awaits(&self, name: M::Name) -> bool {
        self.name() == Some(name)
    }

    /// Returns whether a request of this name is open and was sent at least once.
    pub(super) fn awaits_answer(&self, name: M::Name) -> bool {
        self.sent > 0 && self.awaits(name)
    }

    pub(super) const fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Returns the request if it waits to be sent and is available. Counts it as sent.
    pub(super) fn send(&mut self, now: Instant, borrowed: Option<M::Name>) -> Option<Outgoing<'_, M>> {
        if self.deadline.is_some() {
            return None;
        }
        let request = self.request.as_ref()?;
        let outgoing = request.outgoing(borrowed)?;
        self.deadline = Some(now.plus(self.timeout_ms));
        if self.sent == 0 {
            self.begun = now;
        }
        self.sent = self.sent.saturating_add(1);
        Some(outgoing)
    }

    /// Forbids repetitions. A request that is still unsent is not affected.
    pub(super) const fn forbid_repeat(&mut self) {
        self.only_once = true;
    }

    /// Returns the name of the request if it was sent and must not be repeated.
    pub(super) fn overtaken(&self) -> Option<M::Name> {
        if self.only_once && self.sent > 0 { self.name() } else { None }
    }

    /// Returns whether a repetition is due now.
    pub(super) const fn is_due_again(&self) -> bool {
        self.request.is_some() && self.sent > 0 && self.deadline.is_none()
    }

    /// Returns whether the reply was overdue at least once.
    pub(super) const fn was_late(&self) -> bool {
        self.is_due_again() || (self.request.is_some() && self.sent > 1)
    }

    /// Returns the name of a request that was sent more than once, and the time until which a reply to the last
    /// transmission may arrive.
    pub(super) fn doubled(&self) -> Option<(M::Name, Instant)> {
        if self.sent > 1 { self.name().zip(self.deadline) } else { None }
    }

    /// Returns whether the reply is overdue.
    pub(super) fn is_overdue(&self, now: Instant) -> bool {
        self.deadline.is_some_and(|deadline| now.has_reached(deadline))
    }

    /// Returns when [`expire`](Self::expire) must be called: at the deadline, or when a due repetition has been waiting
    /// too long.
    pub(super) fn expires_at(&self, attempts: u8) -> Option<Instant> {
        let last = || self.begun.plus(self.timeout_ms.saturating_mul(attempts.into()));
        self.deadline.or_else(|| self.is_due_again().then(last))
    }

    /// Processes a time-out that is due at `now`. A repeatable request is sent up to `attempts` times in total. A
    /// blocked line does not extend the total time.
    pub(super) fn expire(&mut self, now: Instant, attempts: u8) -> Expired {
        let is_due = self.sent > 0 && self.expires_at(attempts).is_some_and(|at| now.has_reached(at));
        if is_due { self.take_time_out(now, attempts) } else { Expired::No }
    }

    // Separate from `expire`, which runs in each iteration of a main loop.
    #[inline(never)]
    fn take_time_out(&mut self, now: Instant, attempts: u8) -> Expired {
        let Some(request) = &self.request else { return Expired::No };
        let is_over = now.since(self.begun) >= self.timeout_ms.saturating_mul(attempts.into());
        let is_repeatable = request.is_repeatable();
        if is_repeatable && matches!(request, Request::Orphan(_)) {
            self.close();
            return Expired::No;
        }
        if is_repeatable && self.only_once {
            return Expired::Overtaken;
        }
        if is_repeatable && !is_over {
            self.deadline = None;
            Expired::Repeated
        } else {
            Expired::GivenUp
        }
    }

    /// Closes the transaction and returns the name of its request.
    pub(super) fn abandon(&mut self) -> Option<M::Name> {
        let name = self.name();
        self.close();
        name
    }

    /// Closes the transaction and returns the name of its request, if that was never sent.
    pub(super) fn withdraw_unsent(&mut self) -> Option<M::Name> {
        if self.sent == 0 { self.abandon() } else { None }
    }

    /// Closes the transaction and returns true if a request of this name was sent exactly once.
    pub(super) fn take_back(&mut self, name: M::Name) -> bool {
        let is_this = self.sent == 1 && self.awaits(name);
        if is_this {
            self.close();
        }
        is_this
    }

    /// Called when the requester no longer exists: a borrowed request is not sent (again).
    pub(super) const fn orphan(&mut self) {
        if let Some(Request::Borrowed(name)) = self.request {
            if self.deadline.is_some() {
                self.request = Some(Request::Orphan(name));
            } else {
                // The reply is overdue, and the request can no longer be repeated.
                self.close();
            }
        }
    }
}
