//! The controller's side of a connection to a gripper (command set, 1.2.2 and 1.3).
//!
//! Sans-IO: the caller owns bytes and time. One contract for it:
//!
//! 1. give every event of the [`FrameParser`](crate::FrameParser) to [`Session::handle`];
//! 2. call [`Session::tick`] until it gives `None`, at the latest when [`Session::poll_timeout`] says;
//! 3. then send every command that [`Session::poll_transmit`] gives, in order, until it gives `None`.
//!
//! What it takes care of:
//! - **Connecting**: it asks for device and limits, subscribes to the values of [`Config`], and asks for each again
//!   and again, so that silence and a gripper that was restarted are noticed.
//! - **Asynchronous commands**: a motion is answered twice; other requests go on in between. While no result comes
//!   but the gripper reports that it stands still, the result is given up.
//! - **Lost answers**: what may be repeated is ([`CommandId::is_repeatable`]); a motion or an acknowledgement never
//!   is. What it does not know it says: [`Notice::Unanswered`].
//! - **FAST STOP**: goes out before anything else, is repeated until the gripper confirms it, over a reconnect as well,
//!   and is never acknowledged by the session itself.
//! - **Silence**: the connection is given up, all knowledge of the gripper with it, and what was waiting to be sent is
//!   withdrawn: nothing that was asked for before a reconnect leaves after it.
//!
//! ```
//! use wsg_protocol::session::{Config, Notice, Session};
//! use wsg_protocol::{Command, Instant};
//!
//! let mut session = Session::new(Config::DEFAULT);
//! let now = Instant::from_millis(0);
//! assert_eq!(session.tick(now), None);
//! assert_eq!(session.poll_transmit(now), Some(Command::GetSystemInfo));
//! // Not connected yet, so a motion is refused, not kept.
//! assert!(session.request(Command::GripPart { width: 20.0, speed: 50.0 }).is_err());
//! ```

mod known;
mod track;

pub use known::Known;

use crate::command::{Command, CommandId, Kind};
use crate::field::Refusal;
use crate::frame::Event;
use crate::reply::{Reply, Value};
use crate::time::Instant;
use crate::types::{AutoUpdate, Status};
use heapless::{Deque, Vec};
use track::{Expired, Track};

/// Time-outs and subscriptions. All times in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// How long the first answer to a request may take.
    pub reply_timeout_ms: u32,
    /// How often a request that may be repeated is sent before the connection counts as lost.
    pub attempts: u8,
    /// How long after one of the subscribed values was asked for the next one is.
    pub refresh_ms: u32,
    /// How long to wait before connecting is tried again.
    pub reconnect_ms: u32,
    /// How long a motion may take.
    pub motion_timeout_ms: u32,
    /// How long the result of a motion is waited for once the gripper reports that it stands still.
    pub result_grace_ms: u32,
    /// The least time between two updates of one value that the gripper sends, at least 10.
    pub update_period_ms: u16,
    /// Whether the opening width is subscribed to.
    pub width: bool,
    /// Whether the gripping force is subscribed to.
    pub force: bool,
}

impl Config {
    /// For a serial line at 115 200 bit/s: silence is noticed in under a second. System state and gripper state only.
    ///
    /// The longest stroke (210 mm) at the least speed (5 mm/s) takes 42 s, so a motion may take a minute.
    pub const DEFAULT: Self = Self {
        reply_timeout_ms: 200,
        attempts: 3,
        refresh_ms: 250,
        reconnect_ms: 250,
        motion_timeout_ms: 60_000,
        result_grace_ms: 1_000,
        update_period_ms: AutoUpdate::MIN_PERIOD_MS,
        width: false,
        force: false,
    };
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Notice<'a> {
    /// The gripper answers, and all that is subscribed to is known.
    Connected,
    /// The gripper is silent: nothing is known of it any more.
    Disconnected,
    /// A requested motion has begun (E_CMD_PENDING).
    Pending(CommandId),
    /// The final answer to a request.
    Answered(Reply<'a>),
    /// A request was sent, and its outcome is not known.
    Unanswered(CommandId),
    /// A request was not sent, and will not be.
    Withdrawn(CommandId),
    /// The gripper reported a value.
    Reported(Value<'a>),
}

/// Why a request was not taken. Nothing of it will be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RequestError {
    /// The caller's: there is no connection. (Only FAST STOP is taken then, and sent as soon as there is one.)
    NotConnected,
    /// The caller's: a motion is running.
    MotionRunning,
    /// The caller's: a FAST STOP is not confirmed yet.
    FastStopRunning,
    /// The caller's: a parameter is none that a gripper may take.
    Invalid(Refusal),
    /// Capacity: too many requests wait.
    QueueFull,
}

/// What the session has seen that it could not use; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Replies that were not asked for, or came too late.
    pub unasked: u16,
    /// Frames whose payload the manual forbids.
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
    /// The commands of [`SETUP`] are being answered, this one now.
    Connecting { step: u8 },
    /// All of them are.
    Up,
    /// Being given up: what is open is reported first.
    Closing,
}

/// A command that has begun (E_CMD_PENDING) and whose result is awaited.
#[derive(Clone, Copy, Debug)]
struct Running {
    id: CommandId,
    begun: Instant,
    /// Of a motion: since when the gripper reports that it stands still.
    still_since: Option<Instant>,
}

/// Commands that can run at once: one motion, and the supplies of both fingers being switched on.
const RUNNING_LEN: usize = 3;

/// The controller's side of a connection.
#[derive(Debug)]
pub struct Session {
    config: Config,
    link: Link,
    /// Stop or FAST STOP: goes before anything else.
    urgent: Track,
    /// The request whose first answer is awaited.
    request: Track,
    /// The session's own: a step of connecting, or a value asked for again.
    refresh: Track,
    /// Requests that wait for the one before to be answered.
    queue: Deque<Command<'static>, QUEUE_LEN>,
    /// Something waits that a Stop has overtaken.
    overtaken: bool,
    running: Vec<Running, RUNNING_LEN>,
    /// When the next value is asked for again, and which.
    refresh_at: Instant,
    refresh_step: u8,
    known: Known,
    counters: Counters,
}

/// Of the steps of connecting, the first that subscribes: those from here on are asked for again and again.
const FIRST_SUBSCRIPTION: u8 = 2;

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
            running: Vec::new(),
            refresh_at: Instant::from_millis(0),
            refresh_step: FIRST_SUBSCRIPTION,
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
    pub fn motion(&self) -> Option<CommandId> {
        let sent = self.request.command().map(|command| command.id());
        self.running.iter().map(|running| running.id).chain(sent).find(|id| id.kind() == Kind::Motion)
    }

    /// What could not be used so far.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Asks for a command to be sent. Its outcome comes as a [`Notice`].
    ///
    /// Stop and FAST STOP overtake what waits: it is withdrawn.
    ///
    /// # Errors
    /// [`RequestError`]; then the command is not sent, now or later.
    pub fn request(&mut self, command: Command<'static>) -> Result<(), RequestError> {
        command.check().map_err(RequestError::Invalid)?;
        let id = command.id();
        if id == CommandId::FastStop {
            // Owed until the gripper confirms it, connected or not.
            self.urgent.open(command);
            self.overtaken = true;
            return Ok(());
        }
        if !self.is_connected() {
            return Err(RequestError::NotConnected);
        }
        let fast_stop_runs = self.owes_fast_stop();
        match id.kind() {
            Kind::Stop if fast_stop_runs => Err(RequestError::FastStopRunning),
            Kind::Stop => {
                self.urgent.open(command);
                self.overtaken = true;
                Ok(())
            }
            Kind::Acknowledge | Kind::Motion if fast_stop_runs => Err(RequestError::FastStopRunning),
            Kind::Motion if self.motion_is_open() => Err(RequestError::MotionRunning),
            _ if self.running.iter().any(|running| running.id == id) => Err(RequestError::MotionRunning),
            _ => self.queue.push_back(command).map_err(|_| RequestError::QueueFull),
        }
    }

    /// Takes what the parser found.
    pub fn handle<'a>(&mut self, now: Instant, event: &Event<'a>) -> Option<Notice<'a>> {
        let Event::Frame(frame) = event else {
            return None; // The parser counts it; the request that it may have answered is repeated, or reported.
        };
        let Ok(reply) = Reply::decode(frame) else {
            count(&mut self.counters.refused);
            return None;
        };
        let notice = self.route(now, &reply);
        let answers_refresh = self.refresh.take_answered();
        if notice.is_none() && !answers_refresh {
            count(&mut self.counters.unasked);
        }
        notice
    }

    /// Lets time pass. Call again until it gives `None`.
    pub fn tick(&mut self, now: Instant) -> Option<Notice<'static>> {
        if self.link == Link::Closing {
            return Some(self.close_one(now));
        }
        self.expire_tracks(now);
        if self.link == Link::Closing {
            return Some(self.close_one(now));
        }
        if let Some(overtaken) = self.withdraw_overtaken() {
            return Some(Notice::Withdrawn(overtaken));
        }
        if let Some(id) = self.expire_running(now) {
            return Some(Notice::Unanswered(id));
        }
        self.advance(now);
        None
    }

    /// The next command to send. It counts as sent now.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Command<'static>> {
        let deadline = now.plus(self.config.reply_timeout_ms);
        if self.link == Link::Closing {
            return None; // The caller has not taken all notices yet: what is open belongs to a lost connection.
        }
        for track in [&mut self.urgent, &mut self.request, &mut self.refresh] {
            if let Some(command) = track.send(deadline) {
                return Some(command);
            }
        }
        None
    }

    /// When [`tick`](Self::tick) must be called at the latest, if nothing else happens.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let tracks = [self.urgent.deadline(), self.request.deadline(), self.refresh.deadline()];
        let link = match self.link {
            Link::Down { retry_at } => retry_at,
            Link::Up if self.refresh.is_idle() => Some(self.refresh_at),
            _ => None,
        };
        let running = self.running.iter().map(|running| self.result_deadline(running));
        tracks.into_iter().chain([link]).flatten().chain(running).reduce(Instant::earlier_of)
    }

    /// Whether a FAST STOP was asked for and is not confirmed yet.
    #[must_use]
    pub fn owes_fast_stop(&self) -> bool {
        self.urgent.awaits(CommandId::FastStop)
    }

    /// The commands of connecting, in order: what device, what limits, then the subscriptions.
    fn setup(&self, step: u8) -> Option<Command<'static>> {
        let update = AutoUpdate::on_change(self.config.update_period_ms);
        let steps = [
            Some(Command::GetSystemInfo),
            Some(Command::GetSystemLimits),
            Some(Command::GetSystemState { update }),
            Some(Command::GetGripperState { update }),
            self.config.width.then_some(Command::GetOpeningWidth { update }),
            self.config.force.then_some(Command::GetForce { update }),
        ];
        steps.into_iter().flatten().nth(step as usize)
    }

    /// Whether a motion runs or waits.
    fn motion_is_open(&self) -> bool {
        self.motion().is_some() || self.queue.iter().any(|command| command.id().kind() == Kind::Motion)
    }

    /// To whom a reply belongs.
    fn route<'a>(&mut self, now: Instant, reply: &Reply<'a>) -> Option<Notice<'a>> {
        let (id, status) = (reply.id(), reply.status());
        if let Some(value) = reply.value() {
            self.learn(now, &value);
        }
        if self.urgent.awaits_answer(id) && status.is_final() {
            // A FAST STOP is only done when the gripper says so.
            if id == CommandId::FastStop && status != Status::Success {
                return None;
            }
            self.urgent.close();
            if matches!(self.link, Link::Down { .. }) {
                self.link = Link::Down { retry_at: None };
            }
            return Some(Notice::Answered(*reply));
        }
        if self.request.awaits_answer(id) {
            return self.route_first_answer(now, reply);
        }
        if status.is_final()
            && let Some(at) = self.running.iter().position(|running| running.id == id)
        {
            self.running.swap_remove(at);
            return Some(Notice::Answered(*reply));
        }
        if self.refresh.awaits_answer(id) && status == Status::Success {
            return self.route_refresh(now, reply);
        }
        let value = reply.value()?;
        let subscribed = self.is_connected() && id.kind() == Kind::Query && Known::holds(id);
        subscribed.then_some(Notice::Reported(value))
    }

    /// The first answer to a request.
    fn route_first_answer<'a>(&mut self, now: Instant, reply: &Reply<'a>) -> Option<Notice<'a>> {
        let (id, status) = (reply.id(), reply.status());
        let asynchronous = id.kind() == Kind::Motion || !id.completion_statuses().is_empty();
        match status {
            Status::CmdPending if asynchronous => {
                self.request.close();
                // There is room: only one motion is let in, and each finger's supply once.
                let _ = self.running.push(Running { id, begun: now, still_since: None });
                Some(Notice::Pending(id))
            }
            Status::CmdPending => None,
            // A result without E_CMD_PENDING before it is that of an earlier motion, late.
            result
                if asynchronous
                    && id.completion_statuses().contains(&result)
                    && !id.immediate_statuses().contains(&result) =>
            {
                None
            }
            _ => {
                self.request.close();
                Some(Notice::Answered(*reply))
            }
        }
    }

    /// An answer to one of the session's own requests.
    fn route_refresh<'a>(&mut self, now: Instant, reply: &Reply<'a>) -> Option<Notice<'a>> {
        self.refresh.close_answered();
        self.refresh_at = now.plus(self.config.refresh_ms);
        match self.link {
            Link::Connecting { step } => {
                let next = step.saturating_add(1);
                if self.setup(next).is_some() {
                    self.link = Link::Connecting { step: next };
                    None
                } else {
                    self.link = Link::Up;
                    self.refresh_step = FIRST_SUBSCRIPTION;
                    Some(Notice::Connected)
                }
            }
            _ => reply.value().map(Notice::Reported),
        }
    }

    /// Takes over a reported value, and what it says of a running motion.
    fn learn(&mut self, now: Instant, value: &Value<'_>) {
        self.known.learn(value);
        if !matches!(value, Value::GetSystemState(_) | Value::GetGripperState(_)) {
            return;
        }
        let moves = self.known.is_moving();
        for motion in self.running.iter_mut().filter(|running| running.id.kind() == Kind::Motion) {
            motion.still_since = if moves { None } else { motion.still_since.or(Some(now)) };
        }
    }

    /// What is done about answers that did not come.
    fn expire_tracks(&mut self, now: Instant) {
        let attempts = if self.is_connected() { self.config.attempts } else { 1 };
        for track in [&mut self.urgent, &mut self.request, &mut self.refresh] {
            match track.expire(now, attempts) {
                Expired::No => {}
                Expired::Repeated => count(&mut self.counters.repeated),
                Expired::GivenUp if self.link == Link::Up => self.link = Link::Closing,
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
    fn close_one(&mut self, now: Instant) -> Notice<'static> {
        self.known = Known::NOTHING;
        self.refresh.close();
        if let Some(running) = self.running.pop() {
            return Notice::Unanswered(running.id);
        }
        if let Some(command) = self.request.abandon() {
            return Notice::Unanswered(command.id());
        }
        if let Some(command) = self.urgent.abandon_unless(CommandId::FastStop) {
            return Notice::Unanswered(command.id());
        }
        if let Some(command) = self.queue.pop_front() {
            return Notice::Withdrawn(command.id());
        }
        count(&mut self.counters.disconnects);
        self.link = Link::Down { retry_at: Some(now.plus(self.config.reconnect_ms)) };
        Notice::Disconnected
    }

    /// Takes back what waits behind a Stop or FAST STOP.
    fn withdraw_overtaken(&mut self) -> Option<CommandId> {
        if !self.overtaken {
            return None;
        }
        let command = self.request.withdraw_unsent().or_else(|| self.queue.pop_front());
        self.overtaken = command.is_some();
        command.map(|command| command.id())
    }

    /// Gives up a running command whose result does not come.
    fn expire_running(&mut self, now: Instant) -> Option<CommandId> {
        let at = self.running.iter().position(|running| now.has_reached(self.result_deadline(running)))?;
        Some(self.running.swap_remove(at).id)
    }

    /// Until when the result of a running command is waited for.
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
            && let Some(command) = self.queue.pop_front()
        {
            self.request.open(command);
        }
        if !self.refresh.is_idle() {
            return;
        }
        match self.link {
            // A FAST STOP that is owed is the first thing that a gripper hears.
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
            Link::Up | Link::Closing => {}
        }
    }

    fn open_refresh(&mut self, step: u8) {
        if let Some(command) = self.setup(step) {
            self.refresh.open(command);
        }
    }
}

fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
