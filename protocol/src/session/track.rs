//! One request on its way: waiting to be sent, sent and awaiting its first answer, or none.

use crate::command::{Command, CommandId};
use crate::time::Instant;

/// A request on its way.
#[derive(Debug)]
pub(super) struct Track {
    state: State,
    /// How often it was sent.
    sent: u8,
    /// An answer has just closed it.
    answered: bool,
}

#[derive(Clone, Copy, Debug)]
enum State {
    Idle,
    Waiting(Command<'static>),
    Sent { command: Command<'static>, deadline: Instant },
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
        Self { state: State::Idle, sent: 0, answered: false }
    }

    /// Opens the track for this request, in place of the one before.
    pub(super) fn open(&mut self, command: Command<'static>) {
        // A FAST STOP that is asked for again is the same one: the answer to the first serves.
        if self.command().is_some_and(|open| open == command) {
            return;
        }
        *self = Self { state: State::Waiting(command), sent: 0, answered: false };
    }

    pub(super) fn close(&mut self) {
        self.state = State::Idle;
    }

    pub(super) fn close_answered(&mut self) {
        self.state = State::Idle;
        self.answered = true;
    }

    /// Whether an answer has closed it since this was last asked.
    pub(super) fn take_answered(&mut self) -> bool {
        core::mem::take(&mut self.answered)
    }

    pub(super) const fn is_idle(&self) -> bool {
        matches!(self.state, State::Idle)
    }

    pub(super) const fn command(&self) -> Option<Command<'static>> {
        match self.state {
            State::Idle => None,
            State::Waiting(command) | State::Sent { command, .. } => Some(command),
        }
    }

    /// Whether a request with this id is open, sent or not.
    pub(super) fn awaits(&self, id: CommandId) -> bool {
        self.command().is_some_and(|command| command.id() == id)
    }

    /// Whether a request with this id was sent, at least once, and is open.
    pub(super) fn awaits_answer(&self, id: CommandId) -> bool {
        self.sent > 0 && self.awaits(id)
    }

    pub(super) const fn deadline(&self) -> Option<Instant> {
        match self.state {
            State::Sent { deadline, .. } => Some(deadline),
            State::Idle | State::Waiting(_) => None,
        }
    }

    /// The request, if it waits to be sent; it counts as sent.
    pub(super) fn send(&mut self, deadline: Instant) -> Option<Command<'static>> {
        let State::Waiting(command) = self.state else { return None };
        self.state = State::Sent { command, deadline };
        self.sent = self.sent.saturating_add(1);
        Some(command)
    }

    /// Lets time pass; a request that may be repeated is, up to `attempts` times in all, a FAST STOP without end.
    pub(super) fn expire(&mut self, now: Instant, attempts: u8) -> Expired {
        let State::Sent { command, deadline } = self.state else { return Expired::No };
        if !now.has_reached(deadline) {
            return Expired::No;
        }
        let id = command.id();
        let repeat = id.is_repeatable() && self.sent < attempts;
        if repeat || id == CommandId::FastStop {
            self.state = State::Waiting(command);
        }
        if repeat { Expired::Repeated } else { Expired::GivenUp }
    }

    /// Closes it and gives the request back.
    pub(super) fn abandon(&mut self) -> Option<Command<'static>> {
        let command = self.command();
        self.close();
        command
    }

    /// Closes it and gives the request back, unless it has this id.
    pub(super) fn abandon_unless(&mut self, id: CommandId) -> Option<Command<'static>> {
        if self.awaits(id) { None } else { self.abandon() }
    }

    /// Closes it and gives the request back if it was never sent.
    pub(super) fn withdraw_unsent(&mut self) -> Option<Command<'static>> {
        if self.sent == 0 { self.abandon() } else { None }
    }
}
