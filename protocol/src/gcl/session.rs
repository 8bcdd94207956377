//! The controller's side of a connection that speaks GCL.
//!
//! Sans-IO, as the binary protocol's [`session`](crate::session) is: the caller owns bytes and time.
//!
//! 1. give every event of the [`LineReader`](super::LineReader) to [`Session::handle`];
//! 2. call [`Session::tick`] until it gives `None`, at the latest when [`Session::poll_timeout`] says;
//! 3. then send every request that [`Session::poll_transmit`] gives, in order, until it gives `None`.
//!
//! What it takes care of:
//! - **Connecting**: it asks what device it is, subscribes to the values of [`Config`], and asks for each again and
//!   again, so that silence and a gripper that was restarted are noticed.
//! - **Motions** are acknowledged and finished; other requests go on in between. While no result comes but the gripper
//!   reports that it stands still, the result is given up.
//! - **Lost answers**: what may be repeated is ([`CommandName::is_repeatable`]); a motion, FSACK or BYE never is. What
//!   it does not know it says: [`Event::Unanswered`].
//! - **STOP** overtakes what waits; without a connection it is sent once, at once, and never later.
//! - **FASTSTOP** goes out before anything else, is repeated until the gripper confirms it, over a reconnect as well, and
//!   is never acknowledged by the session itself.
//! - **Updates**: what is subscribed to by [`Config`] or [`Session::subscribe`] is subscribed to again after a reconnect.
//! - **Silence**: the connection is given up, all knowledge of the gripper with it, and what was waiting to be sent is
//!   withdrawn. PWT and CLT, which the gripper forgets with the connection, are the caller's to set again.
//! - **BYE**: once it is confirmed nothing is sent any more, until [`Session::disconnect`] says that there is a new
//!   connection. To close a TCP connection without it is a FAST STOP (GCL, 2.1.2).
//!
//! ```
//! use wsg_protocol::Instant;
//! use wsg_protocol::gcl::session::{Config, Event, Session};
//! use wsg_protocol::gcl::{Grip, Request};
//!
//! let mut session = Session::new(Config::DEFAULT);
//! let now = Instant::from_millis(0);
//! assert_eq!(session.tick(now), None);
//! assert_eq!(session.poll_transmit(now), Some(Request::Verbose(false)));
//! // Not connected yet, so a motion is refused, not kept.
//! assert!(session.request(Request::Grip(Grip::Preset)).is_err());
//! ```

mod config;
mod known;
mod subscriptions;

pub use crate::session::{QUEUE_LEN, SessionCounters};
pub use config::Config;
pub use known::Known;

use super::{Answer, Autosend, CommandName, LineEvent, ParseError, Request, Select, Selected, Topic, Value};
use crate::command::Kind;
use crate::session::dialect::{Dialect, Role};
use crate::session::message::{Message, Name};
use crate::session::subscriptions::Subscriptions;
use crate::session::transaction::{self, Outgoing};
use crate::session::{Engine, EventOf};
use crate::time::Instant;
use crate::types::Status;

/// The controller's side of a connection that speaks GCL.
pub type Session = Engine<Gcl>;

/// What happened.
pub type Event<'a> = EventOf<CommandName, Answer<'a>, Value<'a>>;

/// Why a request was not taken. Nothing of it will be sent.
pub type RequestError = crate::session::RequestError<ParseError>;

/// The text protocol (GCL).
#[derive(Clone, Copy, Debug)]
pub struct Gcl {
    /// Whether errors come with a text.
    verbose: bool,
}

/// Of the steps of connecting, the first that subscribes: those from here on are taken again and again.
const FIRST_SUBSCRIPTION: u8 = 4;

impl Session {
    /// A session that is not connected, and begins to connect at once.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self::over(Gcl { verbose: config.verbose }, config.timing(), subscriptions::of_config(&config))
    }

    /// Asks for a request to be sent. Its outcome comes as an [`Event`].
    ///
    /// STOP and FASTSTOP overtake what waits: it is withdrawn. AUTOSEND is a [`subscription`](Self::subscribe); no
    /// event tells of its acknowledgement.
    ///
    /// # Errors
    /// [`RequestError`]; then the request is not sent, now or later.
    pub fn request(&mut self, request: Request) -> Result<(), RequestError> {
        request.check().map_err(RequestError::Invalid)?;
        if let Request::Autosend(autosend) = request {
            self.subscribe(autosend);
            return Ok(());
        }
        self.enqueue(transaction::Request::Own(request))
    }

    /// Has the gripper send a value by itself from now on, again after each reconnect, as [`Event::Reported`].
    /// [`Autosend::off`] ends that. Intervals below 10 ms, other than 0, count as 10 ms. In place of what [`Config`]
    /// says; what [`Autosend::check`](Request::check) would refuse changes nothing.
    ///
    /// The two states are asked for again and again even without updates: the session needs them.
    ///
    /// ```
    /// use wsg_protocol::gcl::session::{Config, Session};
    /// use wsg_protocol::gcl::{Autosend, Topic};
    ///
    /// let mut session = Session::new(Config::DEFAULT);
    /// session.subscribe(Autosend::every(Topic::Force, 20));
    /// ```
    pub fn subscribe(&mut self, autosend: Autosend) {
        if Request::Autosend(autosend).check().is_ok() {
            self.subscriptions_mut().set(subscriptions::rounded(autosend));
        }
    }

    /// Takes what the reader found.
    pub fn handle<'a>(&mut self, now: Instant, event: &LineEvent<'a>) -> Option<Event<'a>> {
        let answer = match event {
            LineEvent::Line(line) => Answer::parse(line).ok(),
            LineEvent::TooLong(_) => None,
        };
        let Some(answer) = answer else {
            self.count_refused();
            return None;
        };
        self.take(now, &answer)
    }

    /// The next request to send. It counts as sent now.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Request> {
        match self.next_to_send(now, None)? {
            Outgoing::FastStop => Some(Request::Faststop),
            Outgoing::Own(request) => Some(*request),
            Outgoing::Borrowed => None,
        }
    }
}

impl Dialect for Gcl {
    type Request = Request;
    type Invalid = ParseError;
    type Answer<'a> = Answer<'a>;
    type Value<'a> = Value<'a>;
    type Known = Known;
    type Subscriptions = Subscriptions<Autosend, { Topic::ALL.len() }>;

    const NOTHING: Known = Known::NOTHING;

    /// Who is it, then for each subscription AUTOSEND and the value itself, because AUTOSEND on change says nothing before
    /// the first change.
    fn setup(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Request> {
        match step {
            0 => Some(Request::Verbose(self.verbose)),
            1 => Some(Request::Devtype),
            2 => Some(Request::Version),
            3 => Some(Request::Sn),
            _ => self.refresh(step.saturating_sub(FIRST_SUBSCRIPTION), subscribed),
        }
    }

    fn refresh(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Request> {
        let autosend = subscribed.nth(step / 2)?;
        Some(if step.is_multiple_of(2) { Request::Autosend(autosend) } else { autosend.topic.query() })
    }

    fn name(answer: &Answer<'_>) -> Option<CommandName> {
        answer.name().command()
    }

    fn status(answer: &Answer<'_>) -> Status {
        answer.status()
    }

    fn value<'r, 'a>(answer: &'r Self::Answer<'a>) -> Option<&'r Self::Value<'a>> {
        match answer {
            Answer::Value(value) | Answer::Update(value) => Some(value),
            Answer::Ack(_) | Answer::Fin(_) | Answer::Err { .. } => None,
        }
    }

    fn role(answer: &Answer<'_>) -> Role {
        match answer {
            Answer::Update(_) => Role::Update,
            Answer::Fin(_) => Role::Result,
            Answer::Ack(_) | Answer::Err { .. } | Answer::Value(_) => Role::Answer,
        }
    }

    /// An error is about any request of its name, a value about the element that was asked for.
    fn fits(request: &Request, answer: &Answer<'_>) -> bool {
        let element = match answer {
            Answer::Err { .. } => return true,
            Answer::Value(value) => element_of(value),
            _ => None,
        };
        element_asked_for(request) == element
    }

    fn is_asynchronous(name: CommandName) -> bool {
        name.is_finished()
    }

    /// An error does not tell how a motion ends from how it is refused.
    fn is_late_result(_: CommandName, status: Status, given_up: bool) -> bool {
        given_up && is_result(status)
    }

    /// A gripper without a command of the manual is one, but without its states it cannot be watched.
    fn completes_step(name: CommandName, status: Status) -> bool {
        status == Status::Success || !matches!(name, CommandName::Gripstate | CommandName::Sysflags)
    }

    fn is_farewell(name: CommandName) -> bool {
        name == CommandName::Bye
    }

    fn learn(known: &mut Known, value: &Value<'_>) -> Option<bool> {
        known.learn(value)
    }
}

impl Message for Request {
    type Name = CommandName;

    const STOP: Self = Self::Stop;
    const FAST_STOP: Self = Self::Faststop;

    fn name(&self) -> CommandName {
        Self::name(self)
    }

    fn is_repeatable(&self) -> bool {
        Self::name(self).is_repeatable()
    }
}

impl Name for CommandName {
    fn kind(self) -> Kind {
        Self::kind(self)
    }

    fn is_repeatable(self) -> bool {
        Self::is_repeatable(self)
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

/// Whether an error is how a motion ends, rather than how it is refused.
const fn is_result(status: Status) -> bool {
    matches!(status, Status::CmdAborted | Status::CmdFailed | Status::AxisBlocked | Status::Timeout)
}

#[cfg(test)]
mod tests;
