//! One request on its way: waiting to be sent, sent and awaiting its first answer, or none.

use super::message::{Message, Name};
use crate::time::Instant;

/// A request, as long as it is not answered.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(crate) enum Request<M: Message> {
    /// The session has it.
    Own(M),
    /// The caller keeps it, and passes it when it is to be sent.
    Borrowed(M::Name),
    /// The caller had it, and is gone: it was sent, and will not be again.
    Orphan(M::Name),
}

/// A request that is to be sent now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Outgoing<'s, M> {
    /// FAST STOP.
    FastStop,
    /// This one.
    Own(&'s M),
    /// The one that the caller keeps.
    Borrowed,
}

impl<M: Message> Request<M> {
    pub(super) fn name(&self) -> M::Name {
        match self {
            Self::Own(message) => message.name(),
            Self::Borrowed(name) | Self::Orphan(name) => *name,
        }
    }

    fn is_repeatable(&self) -> bool {
        match self {
            Self::Own(message) => message.is_repeatable(),
            Self::Borrowed(name) | Self::Orphan(name) => name.is_repeatable(),
        }
    }

    /// The request to send, if it is at hand. `borrowed`: the caller has one of this name.
    fn outgoing(&self, borrowed: Option<M::Name>) -> Option<Outgoing<'_, M>> {
        match self {
            Self::Own(message) => Some(Outgoing::Own(message)),
            Self::Borrowed(name) => (borrowed == Some(*name)).then_some(Outgoing::Borrowed),
            Self::Orphan(_) => None,
        }
    }
}

/// A request on its way.
#[derive(Clone, Debug, Hash)]
pub(super) struct Transaction<M: Message> {
    /// None while the transaction is idle.
    request: Option<Request<M>>,
    /// How long its answer may take, in milliseconds.
    timeout_ms: u32,
    /// When its answer should have come; none while it waits to be sent.
    deadline: Option<Instant>,
    /// How often it was sent.
    sent: u8,
    /// When it was sent first.
    begun: Instant,
    /// It is not sent again.
    only_once: bool,
}

/// What a time-out came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expired {
    /// No time-out, or the requester is gone.
    No,
    /// The request will be sent again.
    Repeated,
    /// It was sent often enough, or may not be sent again. It stays open for [`Transaction::abandon`].
    GivenUp,
    /// Something more urgent was requested since, so it is not sent again. It stays open for [`Transaction::abandon`].
    Overtaken,
}

impl<M: Message> Transaction<M> {
    pub(super) const fn new() -> Self {
        let begun = Instant::from_millis(0);
        Self { request: None, timeout_ms: 0, deadline: None, sent: 0, begun, only_once: false }
    }

    /// Opens it for this request, in place of the previous one. Its answer may take `timeout_ms` each time it is sent.
    pub(super) fn open(&mut self, request: Request<M>, timeout_ms: u32) {
        *self = Self { request: Some(request), timeout_ms, ..Self::new() };
    }

    pub(super) const fn close(&mut self) {
        *self = Self::new();
    }

    pub(super) const fn is_idle(&self) -> bool {
        self.request.is_none()
    }

    /// The name of the open request.
    pub(super) fn name(&self) -> Option<M::Name> {
        self.request.as_ref().map(Request::name)
    }

    /// The open request, if the session has it.
    pub(super) const fn own(&self) -> Option<&M> {
        match &self.request {
            Some(Request::Own(message)) => Some(message),
            _ => None,
        }
    }

    /// Whether a request of this name is open, sent or not.
    pub(super) fn awaits(&self, name: M::Name) -> bool {
        self.name() == Some(name)
    }

    /// Whether a request of this name was sent, at least once, and is open.
    pub(super) fn awaits_answer(&self, name: M::Name) -> bool {
        self.sent > 0 && self.awaits(name)
    }

    pub(super) const fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Returns the request if it waits to be sent and is at hand; it counts as sent.
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

    /// Counts a repetition that is due as sent, and does not send it: something else has the line to itself.
    pub(super) fn hold(&mut self, now: Instant) {
        if self.deadline.is_none() && self.sent > 0 && self.request.is_some() {
            self.deadline = Some(now.plus(self.timeout_ms));
            self.sent = self.sent.saturating_add(1);
        }
    }

    /// From now on the request is not sent again. One that is not sent yet stays as it is.
    pub(super) const fn forbid_repeat(&mut self) {
        self.only_once = true;
    }

    /// Its name if it was sent, and may not be sent again.
    pub(super) fn overtaken(&self) -> Option<M::Name> {
        if self.only_once && self.sent > 0 { self.name() } else { None }
    }

    /// Whether it is to be sent once more, now.
    pub(super) const fn is_due_again(&self) -> bool {
        self.request.is_some() && self.sent > 0 && self.deadline.is_none()
    }

    /// Whether its answer did not come in time at least once.
    pub(super) const fn was_late(&self) -> bool {
        self.is_due_again() || (self.request.is_some() && self.sent > 1)
    }

    /// Its name if it was sent more than once, and until when an answer to the last time may come.
    pub(super) fn doubled(&self) -> Option<(M::Name, Instant)> {
        if self.sent > 1 { self.name().zip(self.deadline) } else { None }
    }

    /// Whether its answer should have come by now.
    pub(super) fn is_overdue(&self, now: Instant) -> bool {
        self.deadline.is_some_and(|deadline| now.has_reached(deadline))
    }

    /// Returns when [`expire`](Self::expire) has something to do: at the deadline, or when a repetition that waits to be sent
    /// has waited too long.
    pub(super) fn expires_at(&self, attempts: u8) -> Option<Instant> {
        let last = || self.begun.plus(self.timeout_ms.saturating_mul(attempts.into()));
        self.deadline.or_else(|| self.is_due_again().then(last))
    }

    /// Processes a time-out that is due at `now`. A request that may be repeated is, up to `attempts` times in all. A line that
    /// does not take the repetitions does not extend the time that they have together.
    pub(super) fn expire(&mut self, now: Instant, attempts: u8) -> Expired {
        let is_due = self.sent > 0 && self.expires_at(attempts).is_some_and(|at| now.has_reached(at));
        if is_due { self.take_time_out(now, attempts) } else { Expired::No }
    }

    // Apart from the question whether it is due, which is asked in each turn of a main loop.
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
        if is_repeatable && self.sent < attempts && !is_over {
            self.deadline = None;
            Expired::Repeated
        } else {
            Expired::GivenUp
        }
    }

    /// Closes it and says what it was open for.
    pub(super) fn abandon(&mut self) -> Option<M::Name> {
        let name = self.name();
        self.close();
        name
    }

    /// Closes it and says what it was open for, if that was never sent.
    pub(super) fn withdraw_unsent(&mut self) -> Option<M::Name> {
        if self.sent == 0 { self.abandon() } else { None }
    }

    /// Closes it if it was sent once and is this; whether it was.
    pub(super) fn take_back(&mut self, name: M::Name) -> bool {
        let is_this = self.sent == 1 && self.awaits(name);
        if is_this {
            self.close();
        }
        is_this
    }

    /// Whoever asked is gone: what was borrowed is not sent (again).
    pub(super) const fn orphan(&mut self) {
        if let Some(Request::Borrowed(name)) = self.request {
            if self.deadline.is_some() {
                self.request = Some(Request::Orphan(name));
            } else {
                // Its answer did not come in time, and it cannot be repeated any more.
                self.close();
            }
        }
    }
}
