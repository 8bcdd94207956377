//! One request on its way: waiting to be sent, sent and awaiting its first answer, or none.

use crate::gcl::{Answer, CommandName, Request, Select, Selected, Value};
use crate::time::Instant;

/// A request on its way.
#[derive(Debug)]
pub(super) struct Track {
    state: State,
    /// How often it was sent.
    sent: u8,
}

#[derive(Clone, Copy, Debug)]
enum State {
    Idle,
    Waiting(Request),
    Sent { request: Request, deadline: Instant },
}

/// What a time-out came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expired {
    /// There was none.
    No,
    /// The request will be sent again.
    Repeated,
    /// It was sent often enough, or may not be sent again. It stays open for [`Track::abandon`].
    GivenUp,
}

impl Track {
    pub(super) const fn new() -> Self {
        Self { state: State::Idle, sent: 0 }
    }

    /// Opens the track for this request, in place of the one before.
    pub(super) fn open(&mut self, request: Request) {
        // A FASTSTOP that is asked for again is the same one: the answer to the first serves.
        if self.request() != Some(request) {
            *self = Self { state: State::Waiting(request), sent: 0 };
        }
    }

    pub(super) const fn close(&mut self) {
        self.state = State::Idle;
    }

    pub(super) const fn is_idle(&self) -> bool {
        matches!(self.state, State::Idle)
    }

    /// The open request.
    pub(super) const fn request(&self) -> Option<Request> {
        match self.state {
            State::Idle => None,
            State::Waiting(request) | State::Sent { request, .. } => Some(request),
        }
    }

    /// The name of the open request.
    pub(super) fn name(&self) -> Option<CommandName> {
        self.request().map(|request| request.name())
    }

    /// Whether a request of this name is open, sent or not.
    pub(super) fn awaits(&self, name: CommandName) -> bool {
        self.name() == Some(name)
    }

    /// Whether a request of this name was sent, at least once, and is open.
    pub(super) fn awaits_answer(&self, name: CommandName) -> bool {
        self.sent > 0 && self.awaits(name)
    }

    /// Whether this answers the open request: the same name, and the element that was asked for.
    pub(super) fn is_answered_by(&self, answer: &Answer<'_>) -> bool {
        let Some(request) = self.request() else { return false };
        let Some(name) = answer.name().command() else { return false };
        let element = match answer {
            Answer::Value(value) => element_of(value),
            _ => None,
        };
        self.awaits_answer(name) && element_asked_for(&request) == element
    }

    pub(super) const fn deadline(&self) -> Option<Instant> {
        match self.state {
            State::Sent { deadline, .. } => Some(deadline),
            State::Idle | State::Waiting(_) => None,
        }
    }

    /// Whether its answer should have come by now.
    pub(super) fn is_overdue(&self, now: Instant) -> bool {
        self.deadline().is_some_and(|deadline| now.has_reached(deadline))
    }

    /// The request, if it waits to be sent; it counts as sent.
    pub(super) fn send(&mut self, now: Instant, timeout_ms: u32) -> Option<Request> {
        let State::Waiting(request) = self.state else { return None };
        self.state = State::Sent { request, deadline: now.plus(timeout_ms) };
        self.sent = self.sent.saturating_add(1);
        Some(request)
    }

    /// Lets time pass; a request that may be repeated is, up to `attempts` times in all, a FASTSTOP without end.
    pub(super) fn expire(&mut self, now: Instant, attempts: u8) -> Expired {
        let State::Sent { request, .. } = self.state else { return Expired::No };
        if !self.is_overdue(now) {
            return Expired::No;
        }
        let repeat = request.name().is_repeatable() && self.sent < attempts;
        if repeat || request == Request::Faststop {
            self.state = State::Waiting(request);
        }
        if repeat { Expired::Repeated } else { Expired::GivenUp }
    }

    /// Closes it and says what it was open for.
    pub(super) fn abandon(&mut self) -> Option<CommandName> {
        let name = self.name();
        self.close();
        name
    }

    /// Closes it and says what it was open for, unless that has this name.
    pub(super) fn abandon_unless(&mut self, name: CommandName) -> Option<CommandName> {
        if self.awaits(name) { None } else { self.abandon() }
    }

    /// Closes it and says what it was open for, if that was never sent.
    pub(super) fn withdraw_unsent(&mut self) -> Option<CommandName> {
        if self.sent == 0 { self.abandon() } else { None }
    }

    /// Closes it if it was sent once and has this name; whether it was.
    pub(super) fn take_back(&mut self, name: CommandName) -> bool {
        let is_this = self.sent == 1 && self.awaits(name);
        if is_this {
            self.close();
        }
        is_this
    }
}

/// The element of a vector that a request asks for.
const fn element_asked_for(request: &Request) -> Option<u8> {
    match *request {
        Request::Sysflags(Select::One(index))
        | Request::Gripstats(Select::One(index))
        | Request::Fdata(Select::One(index))
        | Request::Ftype(Select::One(index))
        | Request::Fflags(Select::One(index)) => Some(index),
        _ => None,
    }
}

/// The element of a vector that a value is.
const fn element_of(value: &Value<'_>) -> Option<u8> {
    match *value {
        Value::Sysflags(Selected::One(index, _))
        | Value::Gripstats(Selected::One(index, _))
        | Value::Fdata(Selected::One(index, _))
        | Value::Ftype(Selected::One(index, _))
        | Value::Fflags(Selected::One(index, _)) => Some(index),
        _ => None,
    }
}
