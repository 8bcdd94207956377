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
//!   it does not know it says: [`Notice::Unanswered`].
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
//! use wsg_protocol::gcl::session::{Config, Notice, Session};
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
mod track;

pub use config::Config;
pub use known::Known;

use super::{Answer, Autosend, CommandName, LineEvent, Mistake, Request, Signal, Value};
use crate::command::Kind;
use crate::time::Instant;
use crate::types::Status;
use heapless::Deque;
use subscriptions::Subscriptions;
use track::{Expired, Track};

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Notice<'a> {
    /// The gripper answers, and all that is subscribed to is known.
    Connected,
    /// The gripper is silent, or BYE was said: nothing is known of it any more.
    Disconnected,
    /// A requested motion has begun (`ACK`).
    Pending(CommandName),
    /// The final answer to a request.
    Answered(Answer<'a>),
    /// A request was sent, and its outcome is not known.
    Unanswered(CommandName),
    /// A request was not sent, and will not be.
    Withdrawn(CommandName),
    /// The gripper reported a value.
    Reported(Value<'a>),
}

/// Why a request was not taken. Nothing of it will be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RequestError {
    /// The caller's: there is no connection. (Only FASTSTOP is taken then, and sent until it is confirmed; and STOP,
    /// which is sent once.)
    NotConnected,
    /// The caller's: a motion is running.
    MotionRunning,
    /// The caller's: a FASTSTOP is not confirmed yet.
    FastStopRunning,
    /// The caller's: a parameter is none that a gripper may take.
    Invalid(Mistake),
    /// Capacity: too many requests wait.
    QueueFull,
}

/// What the session has seen that it could not use; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Answers that were not asked for, or came too late.
    pub unasked: u16,
    /// Lines that are no answer.
    pub refused: u16,
    /// Requests that were sent again.
    pub repeated: u16,
    /// Connections lost.
    pub disconnects: u16,
}

/// How many requests may wait to be sent.
pub const QUEUE_LEN: usize = 4;

/// Where the connection stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Link {
    /// No answer; the next attempt begins at the given time, or at once.
    Down { retry_at: Option<Instant> },
    /// The steps of connecting are being answered, this one now.
    Connecting { step: u8 },
    /// All of them are.
    Up,
    /// Being given up: what is open is reported first.
    Closing { said_bye: bool },
    /// BYE was said: nothing is sent.
    Ended,
}

/// A motion that has begun and whose result is awaited.
#[derive(Clone, Copy, Debug)]
struct Running {
    name: CommandName,
    begun: Instant,
    /// Since when the gripper reports that it stands still.
    still_since: Option<Instant>,
}

/// The controller's side of a connection.
#[derive(Debug)]
pub struct Session {
    config: Config,
    link: Link,
    /// STOP or FASTSTOP: goes before anything else.
    urgent: Track,
    /// The request whose first answer is awaited.
    request: Track,
    /// The session's own: a step of connecting, or a value asked for again.
    refresh: Track,
    /// Requests that wait for the one before to be answered.
    queue: Deque<Request, QUEUE_LEN>,
    /// Something waits that a STOP has overtaken.
    overtaken: bool,
    /// A STOP without a connection was not answered.
    stop_unanswered: bool,
    running: Option<Running>,
    /// A motion whose result was given up: it may still come.
    given_up: Option<CommandName>,
    /// When the next value is asked for again, and which.
    refresh_at: Instant,
    refresh_step: u8,
    subscriptions: Subscriptions,
    known: Known,
    counters: Counters,
}

/// Of the steps of connecting, the first that subscribes: those from here on are taken again and again.
const FIRST_SUBSCRIPTION: u8 = 4;

impl Session {
    /// A session that is not connected, and begins to connect at once.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self {
            config,
            link: Link::Down { retry_at: None },
            urgent: Track::new(),
            request: Track::new(),
            refresh: Track::new(),
            queue: Deque::new(),
            overtaken: false,
            stop_unanswered: false,
            running: None,
            given_up: None,
            refresh_at: Instant::from_millis(0),
            refresh_step: FIRST_SUBSCRIPTION,
            subscriptions: Subscriptions::new(&config),
            known: Known::NOTHING,
            counters: Counters { unasked: 0, refused: 0, repeated: 0, disconnects: 0 },
        }
    }

    /// Whether the gripper answers.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        matches!(self.link, Link::Up)
    }

    /// What is known of the gripper; nothing without a connection.
    #[must_use]
    pub const fn known(&self) -> &Known {
        &self.known
    }

    /// The motion that is running: sent and not yet finished, as far as is known.
    #[must_use]
    pub fn motion(&self) -> Option<CommandName> {
        let sent = self.request.name().filter(|name| name.kind() == Kind::Motion);
        self.running.map(|running| running.name).or(sent)
    }

    /// What could not be used so far.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Whether a request waits to be sent, or for its first answer. STOP and FASTSTOP aside.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.request.is_idle() || !self.queue.is_empty()
    }

    /// Whether a FASTSTOP was asked for and is not confirmed yet.
    #[must_use]
    pub fn owes_fast_stop(&self) -> bool {
        self.urgent.awaits(CommandName::Faststop)
    }

    /// Asks for a request to be sent. Its outcome comes as a [`Notice`].
    ///
    /// STOP and FASTSTOP overtake what waits: it is withdrawn. AUTOSEND is a [`subscription`](Self::subscribe); no
    /// notice tells of its acknowledgement.
    ///
    /// # Errors
    /// [`RequestError`]; then the request is not sent, now or later.
    pub fn request(&mut self, request: Request) -> Result<(), RequestError> {
        request.check().map_err(RequestError::Invalid)?;
        let fast_stop_runs = self.owes_fast_stop();
        match request {
            // Owed until the gripper confirms it, connected or not. A STOP may reach a gripper that is not heard, but it
            // is now or never: one that arrives after a reconnect would drop the part that is held then.
            Request::Faststop | Request::Stop if !fast_stop_runs || request == Request::Faststop => {
                self.urgent.open(request);
                self.overtaken = true;
                return Ok(());
            }
            Request::Autosend(autosend) => {
                self.subscribe(autosend);
                return Ok(());
            }
            _ => {}
        }
        if !self.is_connected() {
            return Err(RequestError::NotConnected);
        }
        match request.kind() {
            Kind::Stop => Err(RequestError::FastStopRunning),
            Kind::Acknowledge | Kind::Motion if fast_stop_runs => Err(RequestError::FastStopRunning),
            Kind::Motion if self.motion_is_open() => Err(RequestError::MotionRunning),
            _ => self.queue.push_back(request).map_err(|_| RequestError::QueueFull),
        }
    }

    /// Takes back every request that was not sent yet, for a caller who is gone (a future that was dropped): no notice
    /// tells of them. STOP and FASTSTOP stay.
    pub fn withdraw(&mut self) {
        self.queue.clear();
        self.request.withdraw_unsent();
    }

    /// Takes back what [`poll_transmit`](Self::poll_transmit) gave last and the caller did not send, not one byte of it,
    /// and will not; whether that was a request that it can still do without. No notice tells of it. A question, STOP and
    /// FASTSTOP are not taken back: they may leave late.
    pub fn take_back(&mut self, name: CommandName) -> bool {
        name.kind() != Kind::Query && self.request.take_back(name)
    }

    /// Has the gripper send a value by itself from now on, again after each reconnect, as [`Notice::Reported`].
    /// [`Autosend::off`] ends that. Intervals below 10 ms, other than 0, count as 10 ms. In place of what [`Config`]
    /// says; what [`Autosend::check`](Request::check) would refuse changes nothing.
    ///
    /// The two states are asked for again and again even without updates: the session needs them.
    ///
    /// ```
    /// use wsg_protocol::gcl::session::{Config, Session};
    /// use wsg_protocol::gcl::{Autosend, Signal};
    ///
    /// let mut session = Session::new(Config::DEFAULT);
    /// session.subscribe(Autosend::every(Signal::Force, 20));
    /// ```
    pub fn subscribe(&mut self, autosend: Autosend) {
        if Request::Autosend(autosend).check().is_ok() {
            self.subscriptions.set(autosend);
        }
    }

    /// Gives up the connection, for a caller who knows that it is gone, or who has opened a new one: the next
    /// [`tick`](Self::tick)s tell what became of what was open, and then it is connected anew.
    pub fn disconnect(&mut self) {
        match self.link {
            Link::Up => self.link = Link::Closing { said_bye: false },
            Link::Closing { .. } => self.link = Link::Closing { said_bye: false },
            Link::Down { .. } | Link::Connecting { .. } | Link::Ended => {
                self.known = Known::NOTHING;
                self.refresh.close();
                self.link = Link::Down { retry_at: None };
            }
        }
    }

    /// Takes what the reader found.
    pub fn handle<'a>(&mut self, now: Instant, event: &LineEvent<'a>) -> Option<Notice<'a>> {
        let answer = match event {
            LineEvent::Line(line) => Answer::parse(line).ok(),
            LineEvent::TooLong(_) => None,
        };
        let Some(answer) = answer else {
            count(&mut self.counters.refused);
            return None;
        };
        match self.route(now, &answer) {
            Routed::Unasked => {
                count(&mut self.counters.unasked);
                None
            }
            Routed::Taken => None,
            Routed::Noticed(notice) => Some(notice),
        }
    }

    /// Lets time pass. Call again until it gives `None`.
    pub fn tick(&mut self, now: Instant) -> Option<Notice<'static>> {
        if let Link::Closing { said_bye } = self.link {
            return Some(self.close_one(now, said_bye));
        }
        self.expire_tracks(now);
        if let Link::Closing { said_bye } = self.link {
            return Some(self.close_one(now, said_bye));
        }
        if core::mem::take(&mut self.stop_unanswered) {
            return Some(Notice::Unanswered(CommandName::Stop));
        }
        if let Some(overtaken) = self.withdraw_overtaken() {
            return Some(Notice::Withdrawn(overtaken));
        }
        if let Some(name) = self.expire_running(now) {
            return Some(Notice::Unanswered(name));
        }
        self.advance(now);
        None
    }

    /// The next request to send. It counts as sent now.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Request> {
        if matches!(self.link, Link::Closing { .. } | Link::Ended) {
            return None; // What is open belongs to a connection that is over.
        }
        let timeout = self.config.reply_timeout_ms;
        [&mut self.urgent, &mut self.request, &mut self.refresh]
            .into_iter()
            .find_map(|track| track.send(now, timeout))
    }

    /// When [`tick`](Self::tick) must be called at the latest, if nothing else happens.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let tracks = [self.urgent.deadline(), self.request.deadline(), self.refresh.deadline()];
        let link = match self.link {
            // A FASTSTOP that is owed comes first; its own time-out runs then.
            Link::Down { retry_at } if self.urgent.is_idle() => retry_at,
            Link::Up if self.refresh.is_idle() => Some(self.refresh_at),
            _ => None,
        };
        let running = self.running.map(|running| self.result_deadline(&running));
        tracks.into_iter().chain([link, running]).flatten().reduce(Instant::earlier_of)
    }

    /// The steps of connecting, in order: who is it, then for each subscription AUTOSEND and the value itself, because
    /// AUTOSEND on change says nothing before the first change.
    fn setup(&self, step: u8) -> Option<Request> {
        Some(match step {
            0 => Request::Verbose(self.config.verbose),
            1 => Request::Devtype,
            2 => Request::Version,
            3 => Request::Sn,
            _ => {
                let nth = step.saturating_sub(FIRST_SUBSCRIPTION);
                let autosend = self.subscriptions.nth(nth / 2)?;
                if nth.is_multiple_of(2) { Request::Autosend(autosend) } else { autosend.signal.query() }
            }
        })
    }

    /// Whether a motion runs or waits.
    fn motion_is_open(&self) -> bool {
        self.motion().is_some() || self.queue.iter().any(|request| request.kind() == Kind::Motion)
    }

    /// To whom an answer belongs.
    fn route<'a>(&mut self, now: Instant, answer: &Answer<'a>) -> Routed<'a> {
        let Some(name) = answer.name().command() else { return Routed::Unasked };
        match answer {
            Answer::Update(value) => {
                self.learn(now, value);
                let wanted = Signal::of(name).is_some_and(|signal| self.subscriptions.wants(signal));
                match (wanted, self.is_connected()) {
                    (true, true) => Routed::Noticed(Notice::Reported(*value)),
                    // It begins to come while the next step of connecting is being answered.
                    (true, false) => Routed::Taken,
                    (false, _) => Routed::Unasked,
                }
            }
            Answer::Fin(_) => self.finish(answer),
            Answer::Err { status, .. } => self.route_error(now, name, *status, answer),
            Answer::Ack(_) if self.urgent.awaits_answer(name) => {
                self.urgent.close();
                if matches!(self.link, Link::Down { .. }) {
                    self.link = Link::Down { retry_at: None };
                }
                Routed::Noticed(Notice::Answered(*answer))
            }
            Answer::Ack(_) | Answer::Value(_) => {
                if let Answer::Value(value) = answer {
                    self.learn(now, value);
                }
                if self.request.is_answered_by(answer) {
                    self.route_first_answer(now, name, answer)
                } else if self.refresh.is_answered_by(answer) {
                    self.route_refresh(now, answer)
                } else {
                    Routed::Unasked
                }
            }
        }
    }

    /// The result of the motion that is running.
    fn finish<'a>(&mut self, answer: &Answer<'a>) -> Routed<'a> {
        if self.running.is_some_and(|running| answer.name().command() == Some(running.name)) {
            self.running = None;
            Routed::Noticed(Notice::Answered(*answer))
        } else {
            // A result without an acknowledgement before it is that of an earlier motion, late.
            Routed::Unasked
        }
    }

    fn route_error<'a>(
        &mut self,
        now: Instant,
        name: CommandName,
        status: Status,
        answer: &Answer<'a>,
    ) -> Routed<'a> {
        if self.urgent.awaits_answer(name) {
            // A FASTSTOP is only done when the gripper says so.
            if name == CommandName::Faststop {
                return Routed::Unasked;
            }
            self.urgent.close();
            return Routed::Noticed(Notice::Answered(*answer));
        }
        if self.running.is_some_and(|running| running.name == name) {
            return self.finish(answer);
        }
        if self.request.awaits_answer(name) {
            if self.given_up == Some(name) && is_result(status) {
                self.given_up = None;
                return Routed::Unasked;
            }
            self.request.close();
            return Routed::Noticed(Notice::Answered(*answer));
        }
        // A gripper without a command of the manual is one, but without its states it cannot be watched.
        let is_state = matches!(name, CommandName::Gripstate | CommandName::Sysflags);
        if self.refresh.awaits_answer(name) && !is_state {
            return self.route_refresh(now, answer);
        }
        Routed::Unasked
    }

    /// The first answer to a request.
    fn route_first_answer<'a>(&mut self, now: Instant, name: CommandName, answer: &Answer<'a>) -> Routed<'a> {
        self.request.close();
        if name.is_finished() {
            self.given_up = None;
            self.running = Some(Running { name, begun: now, still_since: None });
            return Routed::Noticed(Notice::Pending(name));
        }
        if name == CommandName::Bye {
            self.link = Link::Closing { said_bye: true };
        }
        Routed::Noticed(Notice::Answered(*answer))
    }

    /// An answer to one of the session's own requests.
    fn route_refresh<'a>(&mut self, now: Instant, answer: &Answer<'a>) -> Routed<'a> {
        if let Some(Request::Autosend(autosend)) = self.refresh.request() {
            self.subscriptions.confirm(autosend);
        }
        self.refresh.close();
        self.refresh_at = now.plus(self.config.refresh_ms);
        match (self.link, answer) {
            (Link::Connecting { step }, _) => {
                let next = step.saturating_add(1);
                if self.setup(next).is_some() {
                    self.link = Link::Connecting { step: next };
                    Routed::Taken
                } else {
                    self.link = Link::Up;
                    self.refresh_step = FIRST_SUBSCRIPTION;
                    Routed::Noticed(Notice::Connected)
                }
            }
            (_, Answer::Value(value)) => Routed::Noticed(Notice::Reported(*value)),
            _ => Routed::Taken,
        }
    }

    /// Takes over a reported value, and what it says of a running motion.
    fn learn(&mut self, now: Instant, value: &Value<'_>) {
        if !self.known.learn(value) {
            return;
        }
        let moves = self.known.is_moving();
        if let Some(motion) = &mut self.running {
            motion.still_since = if moves { None } else { motion.still_since.or(Some(now)) };
        }
    }

    /// What is done about answers that did not come.
    fn expire_tracks(&mut self, now: Instant) {
        let attempts = if self.is_connected() { self.config.attempts } else { 1 };
        if !self.is_connected() && self.urgent.awaits(CommandName::Stop) && self.urgent.is_overdue(now) {
            self.urgent.close();
            self.stop_unanswered = true;
        }
        for track in [&mut self.urgent, &mut self.request, &mut self.refresh] {
            match track.expire(now, attempts) {
                Expired::No => {}
                Expired::Repeated => count(&mut self.counters.repeated),
                Expired::GivenUp if self.link == Link::Up => self.link = Link::Closing { said_bye: false },
                Expired::GivenUp if matches!(self.link, Link::Closing { .. } | Link::Ended) => {}
                Expired::GivenUp => {
                    self.link = Link::Down { retry_at: Some(now.plus(self.config.reconnect_ms)) };
                    self.known = Known::NOTHING;
                }
            }
        }
        if matches!(self.link, Link::Down { .. }) {
            self.refresh.close();
        }
    }

    /// Gives up the connection, one open thing after the other.
    fn close_one(&mut self, now: Instant, said_bye: bool) -> Notice<'static> {
        self.known = Known::NOTHING;
        self.refresh.close();
        if let Some(running) = self.running.take() {
            self.given_up = Some(running.name);
            return Notice::Unanswered(running.name);
        }
        if let Some(name) = self.request.abandon() {
            return Notice::Unanswered(name);
        }
        if let Some(name) = self.urgent.abandon_unless(CommandName::Faststop) {
            return Notice::Unanswered(name);
        }
        if let Some(request) = self.queue.pop_front() {
            return Notice::Withdrawn(request.name());
        }
        if said_bye {
            self.link = Link::Ended;
        } else {
            count(&mut self.counters.disconnects);
            self.link = Link::Down { retry_at: Some(now.plus(self.config.reconnect_ms)) };
        }
        Notice::Disconnected
    }

    /// Takes back what waits behind a STOP or FASTSTOP.
    fn withdraw_overtaken(&mut self) -> Option<CommandName> {
        if !self.overtaken {
            return None;
        }
        let unsent = self.request.withdraw_unsent();
        let name = unsent.or_else(|| self.queue.pop_front().map(|request| request.name()));
        self.overtaken = name.is_some();
        name
    }

    /// Gives up a motion whose result does not come.
    fn expire_running(&mut self, now: Instant) -> Option<CommandName> {
        let running = self.running.filter(|running| now.has_reached(self.result_deadline(running)))?;
        self.running = None;
        self.given_up = Some(running.name);
        Some(running.name)
    }

    /// Until when the result of a motion is waited for.
    fn result_deadline(&self, running: &Running) -> Instant {
        let longest = running.begun.plus(self.config.motion_timeout_ms);
        let grace = running.still_since.map(|since| since.plus(self.config.result_grace_ms));
        grace.map_or(longest, |grace| grace.earlier_of(longest))
    }

    /// Opens what is due: the next request, the next step of connecting, the next value to ask for again.
    fn advance(&mut self, now: Instant) {
        if self.is_connected()
            && self.urgent.is_idle()
            && self.request.is_idle()
            && let Some(request) = self.queue.pop_front()
        {
            self.request.open(request);
        }
        if !self.refresh.is_idle() {
            return;
        }
        if self.link == Link::Up
            && let Some(changed) = self.subscriptions.changed()
        {
            self.refresh.open(Request::Autosend(changed));
            return;
        }
        match self.link {
            // A FASTSTOP that is owed is the first thing that a gripper hears.
            Link::Down { retry_at } => {
                if self.urgent.is_idle() && retry_at.is_none_or(|at| now.has_reached(at)) {
                    self.link = Link::Connecting { step: 0 };
                    self.open_refresh(0);
                }
            }
            Link::Connecting { step } => self.open_refresh(step),
            Link::Up if now.has_reached(self.refresh_at) => {
                let step = self.refresh_step;
                self.open_refresh(step);
                let next = step.saturating_add(1);
                self.refresh_step = if self.setup(next).is_some() { next } else { FIRST_SUBSCRIPTION };
            }
            Link::Up | Link::Closing { .. } | Link::Ended => {}
        }
    }

    fn open_refresh(&mut self, step: u8) {
        if let Some(request) = self.setup(step) {
            self.refresh.open(request);
        }
    }
}

/// To whom an answer belongs.
enum Routed<'a> {
    /// To nobody.
    Unasked,
    /// To the session itself.
    Taken,
    /// To the caller.
    Noticed(Notice<'a>),
}

/// Whether an error is how a motion ends, rather than how it is refused.
const fn is_result(status: Status) -> bool {
    matches!(status, Status::CmdAborted | Status::CmdFailed | Status::AxisBlocked | Status::Timeout)
}

fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
