//! The controller's side of a GCL connection.
//!
//! Sans-IO, like the binary protocol's [`session`](crate::session): the caller owns bytes and time, and must:
//!
//! 1. pass every event of the [`LineReader`](super::LineReader) to [`Session::handle`];
//! 2. call [`Session::tick`] until it returns `None`, at the latest when [`Session::poll_timeout`] expires;
//! 3. then send every request that [`Session::poll_transmit`] returns, in order, until it returns `None`.
//!
//! The session handles:
//! - **Connecting**: queries the device, subscribes to the values of [`Config`], and polls each of them to detect a
//!   silent or restarted gripper.
//! - **Motions**: are acknowledged and finished, and other requests proceed in between. If the gripper reports
//!   standstill but the result is missing, the session stops waiting for it.
//! - **Lost replies**: repeats requests that are [repeatable](CommandName::is_repeatable), but never a motion, FSACK or
//!   BYE. An unknown outcome is reported as [`Event::Unanswered`].
//! - **STOP**: overtakes all queued requests. Without a connection it is sent once, immediately, and never later.
//! - **FASTSTOP**: is sent before anything else and repeated until the gripper confirms it, even across a reconnect.
//!   The session never acknowledges it. If the gripper itself reports one, it overtakes all queued requests, if a motion
//!   is among them.
//! - **Updates**: restores all subscriptions of [`Config`] and [`Session::subscribe`] after a reconnect.
//! - **Silence**: closes the connection, forgets the gripper's state and withdraws all queued requests. The gripper
//!   loses PWT and CLT with the connection, so the caller must set them again.
//! - **BYE**: after its confirmation, nothing is sent until [`Session::disconnect`] announces a new connection. Closing
//!   a TCP connection without BYE triggers a FAST STOP (GCL, 2.1.2).
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
//! // Not connected yet, so a motion is rejected, not queued.
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
use crate::types::{Status, SystemFlags};

/// The controller's side of a GCL connection.
pub type Session = Engine<GclDialect>;

/// An event of a GCL session.
pub type Event<'a> = EventOf<CommandName, Answer<'a>, Value<'a>>;

/// The reason why a request was rejected. It is never sent.
pub type RequestError = crate::session::RequestError<ParseError>;

/// The dialect of the text protocol (GCL).
#[derive(Clone, Copy, Debug)]
pub struct GclDialect {
    /// Whether error replies include a text.
    verbose: bool,
}

/// The first setup step that subscribes. The steps from here on are repeated while connected.
const FIRST_SUBSCRIPTION: u8 = 4;

impl Session {
    /// Creates a disconnected session, which begins to connect immediately.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self::over(GclDialect { verbose: config.verbose }, config.timing(), subscriptions::of_config(&config))
    }

    /// Requests a command. Its outcome is reported as an [`Event`].
    ///
    /// STOP and FASTSTOP overtake all queued requests, which are withdrawn. AUTOSEND is a
    /// [`subscription`](Self::subscribe), and its acknowledgement causes no event.
    ///
    /// # Errors
    /// Returns [`RequestError`] if the request is rejected. It is then never sent.
    pub fn request(&mut self, request: Request) -> Result<(), RequestError> {
        request.check().map_err(RequestError::Invalid)?;
        if let Request::Autosend(autosend) = request {
            self.subscribe(autosend);
            return Ok(());
        }
        self.enqueue(transaction::Request::Own(request))
    }

    /// Subscribes to periodic updates of a value, reported as [`Event::Reported`]. The subscription overrides
    /// [`Config`] and is restored after each reconnect. [`Autosend::off`] ends it. Intervals below 10 ms, other than 0,
    /// count as 10 ms. Invalid parameters (see [`Request::check`]) change nothing.
    ///
    /// The session polls the two states even without updates.
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

    /// Processes an event of the reader.
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

    /// Returns the next request to send and counts it as sent.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Request> {
        match self.next_to_send(now, None)? {
            Outgoing::FastStop => Some(Request::Faststop),
            Outgoing::Own(request) => Some(*request),
            Outgoing::Borrowed => None,
        }
    }
}

impl Dialect for GclDialect {
    type Request = Request;
    type Invalid = ParseError;
    type Answer<'a> = Answer<'a>;
    type Value<'a> = Value<'a>;
    type Known = Known;
    type Subscriptions = Subscriptions<Autosend, { Topic::ALL.len() }>;

    const NOTHING: Known = Known::NOTHING;

    /// Device information first, then AUTOSEND and a query for each subscription: AUTOSEND on change sends nothing
    /// before the first change.
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

    /// An error matches any request of its name. A value must match the requested element.
    fn fits(request: &Request, answer: &Answer<'_>) -> bool {
        let element = match answer {
            Answer::Err { .. } => return true,
            Answer::Value(value) => element_of(value),
            _ => None,
        };
        requested_element(request) == element
    }

    fn is_asynchronous(name: CommandName) -> bool {
        name.is_finished()
    }

    /// An error does not reveal whether a motion failed or was rejected.
    fn is_late_result(_: CommandName, status: Status, given_up: bool) -> bool {
        given_up && is_result(status)
    }

    /// A gripper may lack a command of the manual, but without its states it cannot be monitored.
    fn completes_step(name: CommandName, status: Status) -> bool {
        status == Status::Success || !matches!(name, CommandName::Gripstate | CommandName::Sysflags)
    }

    fn is_farewell(name: CommandName) -> bool {
        name == CommandName::Bye
    }

    fn learn(known: &mut Known, value: &Value<'_>) -> Option<bool> {
        known.learn(value)
    }

    fn is_fast_stopped(known: &Known) -> bool {
        known.flags.is_some_and(|flags| flags.contains(SystemFlags::FAST_STOP))
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

/// Returns the vector element that a request queries.
const fn requested_element(request: &Request) -> Option<u8> {
    match *request {
        Request::Sysflags(Select::One(index))
        | Request::Gripstats(Select::One(index))
        | Request::Fdata(Select::One(index))
        | Request::Ftype(Select::One(index))
        | Request::Fflags(Select::One(index)) => Some(index),
        _ => None,
    }
}

/// Returns the vector element that a value contains.
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

/// Returns whether an error ends a motion, rather than rejecting it.
const fn is_result(status: Status) -> bool {
    matches!(status, Status::CmdAborted | Status::CmdFailed | Status::AxisBlocked | Status::Timeout)
}

#[cfg(test)]
mod tests;
