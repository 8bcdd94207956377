//! One request on its way: waiting to be sent, sent and awaiting its first answer, or none.

use super::Config;
use crate::command::{Command, CommandId};
use crate::time::Instant;

/// A request, as long as it is not answered.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(super) enum Request {
    /// The session has it.
    Own(Command<'static>),
    /// The caller has it, and lends it when it is to be sent.
    Lent(CommandId),
    /// The caller had it, and is gone: it was sent, and will not be again.
    Orphan(CommandId),
}

impl Request {
    pub(super) const fn id(&self) -> CommandId {
        match self {
            Self::Own(command) => command.id(),
            Self::Lent(id) | Self::Orphan(id) => *id,
        }
    }

    const fn is_repeatable(&self) -> bool {
        match self {
            Self::Own(command) => command.is_repeatable(),
            Self::Lent(id) | Self::Orphan(id) => id.is_repeatable(),
        }
    }

    /// The command to send, if it is at hand.
    fn command<'p>(&self, lent: Option<Command<'p>>) -> Option<Command<'p>> {
        match *self {
            Self::Own(command) => Some(command),
            Self::Lent(id) => lent.filter(|command| command.id() == id),
            Self::Orphan(_) => None,
        }
    }
}

/// A request on its way.
#[derive(Clone, Debug, Hash)]
pub(super) struct Track {
    /// None while the track is idle.
    request: Option<Request>,
    /// When its answer should have come; none while it waits to be sent.
    deadline: Option<Instant>,
    /// How often it was sent.
    sent: u8,
    /// It is not sent again.
    only_once: bool,
}

/// What a time-out came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expired {
    /// There was none, or nobody is left who asked.
    No,
    /// The request will be sent again.
    Repeated,
    /// It was sent often enough, or may not be sent again. It stays open for [`Track::abandon`].
    GivenUp,
    /// Something more urgent was requested since, so it is not sent again. It stays open for [`Track::abandon`].
    Overtaken,
}

impl Track {
    pub(super) const fn new() -> Self {
        Self { request: None, deadline: None, sent: 0, only_once: false }
    }

    /// Opens the track for this request, in place of the one before.
    pub(super) fn open(&mut self, request: Request) {
        *self = Self { request: Some(request), ..Self::new() };
    }

    pub(super) const fn close(&mut self) {
        *self = Self::new();
    }

    pub(super) const fn is_idle(&self) -> bool {
        self.request.is_none()
    }

    /// The id of the open request.
    pub(super) fn id(&self) -> Option<CommandId> {
        self.request.as_ref().map(Request::id)
    }

    /// The open request, if the session has it.
    pub(super) const fn own(&self) -> Option<Command<'static>> {
        match self.request {
            Some(Request::Own(command)) => Some(command),
            _ => None,
        }
    }

    /// Whether a request with this id is open, sent or not.
    pub(super) fn awaits(&self, id: CommandId) -> bool {
        self.id() == Some(id)
    }

    /// Whether a request with this id was sent, at least once, and is open.
    pub(super) fn awaits_answer(&self, id: CommandId) -> bool {
        self.sent > 0 && self.awaits(id)
    }

    pub(super) const fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// The command, if it waits to be sent and is at hand; it counts as sent.
    pub(super) fn send<'p>(
        &mut self,
        now: Instant,
        config: &Config,
        lent: Option<Command<'p>>,
    ) -> Option<Command<'p>> {
        if self.deadline.is_some() {
            return None;
        }
        let request = self.request.as_ref()?;
        let command = request.command(lent)?;
        self.deadline = Some(now.plus(config.reply_timeout(request.id())));
        self.sent = self.sent.saturating_add(1);
        Some(command)
    }

    /// Counts a repetition that is due as sent, and does not send it: something else has the line to itself.
    pub(super) fn hold(&mut self, now: Instant, config: &Config) {
        if self.deadline.is_none()
            && self.sent > 0
            && let Some(request) = &self.request
        {
            self.deadline = Some(now.plus(config.reply_timeout(request.id())));
            self.sent = self.sent.saturating_add(1);
        }
    }

    /// From now on the request is not sent again. One that is not sent yet stays as it is.
    pub(super) const fn forbid_repeat(&mut self) {
        self.only_once = true;
    }

    /// Whether it is to be sent once more, now.
    pub(super) const fn is_due_again(&self) -> bool {
        self.request.is_some() && self.sent > 0 && self.deadline.is_none()
    }

    /// Whether its answer did not come in time at least once.
    pub(super) const fn was_late(&self) -> bool {
        self.is_due_again() || (self.request.is_some() && self.sent > 1)
    }

    /// Its id if it was sent more than once, and until when an answer to the last time may come.
    pub(super) fn doubled(&self) -> Option<(CommandId, Instant)> {
        if self.sent > 1 { self.id().zip(self.deadline) } else { None }
    }

    /// Whether its answer should have come by now.
    pub(super) fn is_overdue(&self, now: Instant) -> bool {
        self.deadline.is_some_and(|deadline| now.has_reached(deadline))
    }

    /// Lets time pass; a request that may be repeated is, up to `attempts` times in all.
    pub(super) fn expire(&mut self, now: Instant, attempts: u8) -> Expired {
        let Some(request) = self.request.as_ref().filter(|_| self.is_overdue(now)) else {
            return Expired::No;
        };
        let is_repeatable = request.is_repeatable();
        if is_repeatable && matches!(request, Request::Orphan(_)) {
            self.close();
            return Expired::No;
        }
        if is_repeatable && self.only_once {
            return Expired::Overtaken;
        }
        if is_repeatable && self.sent < attempts {
            self.deadline = None;
            Expired::Repeated
        } else {
            Expired::GivenUp
        }
    }

    /// Closes it and says what it was open for.
    pub(super) fn abandon(&mut self) -> Option<CommandId> {
        let id = self.id();
        self.close();
        id
    }

    /// Closes it and says what it was open for, if that was never sent.
    pub(super) fn withdraw_unsent(&mut self) -> Option<CommandId> {
        if self.sent == 0 { self.abandon() } else { None }
    }

    /// Closes it if it was sent once and is this; whether it was.
    pub(super) fn take_back(&mut self, id: CommandId) -> bool {
        let is_this = self.sent == 1 && self.awaits(id);
        if is_this {
            self.close();
        }
        is_this
    }

    /// Whoever asked is gone: what was lent is not sent (again).
    pub(super) const fn orphan(&mut self) {
        if let Some(Request::Lent(id)) = self.request {
            if self.deadline.is_some() {
                self.request = Some(Request::Orphan(id));
            } else {
                // Its answer did not come in time, and it cannot be repeated any more.
                self.close();
            }
        }
    }
}
