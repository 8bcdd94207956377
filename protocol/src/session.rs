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
//! - **Stop**: overtakes what waits; without a connection it is sent once, at once, and never later. One that is not
//!   answered in time is reported ([`Notice::Late`]) and repeated.
//! - **FAST STOP**: goes out before anything else and is repeated until the gripper confirms it, over a reconnect as well,
//!   in bursts and pauses ([`FastStopPattern`]) that reach a gripper which mistook a damaged frame for the head of a long
//!   one. Nothing else is sent meanwhile. The session never acknowledges it.
//! - **Acknowledge**: overtakes what waits, like Stop: no motion that was requested before it is sent after it.
//! - **Settings** are read back when [`Config::verify_settings`] is set: what is not what was set is [`MISMATCH`].
//! - **Updates**: what is subscribed to by [`Config`] or [`Session::subscribe`] is subscribed to again after a reconnect.
//! - **Silence**: the connection is given up, all knowledge of the gripper with it, and what was waiting to be sent is
//!   withdrawn: nothing that was asked for before a reconnect leaves after it.
//!
//! ```
//! use wsg_protocol::session::{Config, Notice, Session};
//! use wsg_protocol::{Command, CommandId, Instant};
//!
//! let mut session = Session::new(Config::DEFAULT);
//! let now = Instant::from_millis(0);
//! assert_eq!(session.tick(now), None);
//! // First of all it asks whether the fingers move.
//! let first = session.poll_transmit(now).map(|command| command.id());
//! assert_eq!(first, Some(CommandId::GetSystemState));
//! // Not connected yet, so a motion is refused, not kept.
//! assert!(session.request(Command::GripPart { width: 20.0, speed: 50.0 }).is_err());
//! ```

mod config;
mod fast_stop;
mod known;
mod read_back;
mod signal;
mod track;

pub use config::{Config, FastStopPattern, Timeout};
pub use known::Known;
pub use signal::Signal;

use crate::command::{Command, CommandId, Kind};
use crate::field::Refusal;
use crate::frame::Event;
use crate::queue::Queue;
use crate::reply::{Reply, Value};
use crate::time::Instant;
use crate::types::{AutoUpdate, Status};
use core::hash::{Hash, Hasher};
use fast_stop::FastStop;
use signal::Subscriptions;
use track::{Expired, Request, Track};

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
    /// The final answer to a request; [`MISMATCH`] is the session's own.
    Answered(Reply<'a>),
    /// A request was sent, and its outcome is not known.
    Unanswered(CommandId),
    /// A Stop was not answered in time and is sent again: the fingers may still move.
    Late(CommandId),
    /// A request was not sent, and will not be.
    Withdrawn(CommandId),
    /// The gripper reported a value.
    Reported(Value<'a>),
}

/// By kind and command, without the values.
impl Hash for Notice<'_> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        core::mem::discriminant(self).hash(state);
        let id = match self {
            Self::Connected | Self::Disconnected => None,
            Self::Pending(id) | Self::Unanswered(id) | Self::Late(id) | Self::Withdrawn(id) => Some(*id),
            Self::Answered(reply) => Some(reply.id()),
            Self::Reported(value) => Some(value.id()),
        };
        id.hash(state);
    }
}

/// Why a request was not taken. Nothing of it will be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RequestError {
    /// The caller's: there is no connection. (Only FAST STOP is taken then, and sent until it is confirmed; and Stop,
    /// which is sent once.)
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

/// Adds nothing: sessions that differ in their counts alone behave alike.
impl Hash for Counters {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

/// The status of a setting that the gripper confirmed but did not take over: read back, it shows another value, or none
/// ([`Config::verify_settings`]).
///
/// It is E_WRITE_ERROR, which the manual lists for none of the settings that are read back, so that a register interface
/// can show it as it is.
pub const MISMATCH: Status = Status::WriteError;

/// How many requests may wait to be sent.
pub const QUEUE_LEN: usize = 4;

/// Room for an acknowledgement behind a full queue, which it withdraws.
const QUEUE_CAPACITY: usize = QUEUE_LEN + 1;

/// Where the connection stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Link {
    /// No answer; the next attempt begins at the given time, or at once.
    Down { retry_at: Option<Instant> },
    /// The commands of [`Session::setup`] are being answered, this one now.
    Connecting { step: u8 },
    /// All of them are.
    Up,
    /// Being given up: what is open is reported first.
    Closing,
}

/// A command that has begun (E_CMD_PENDING) and whose result is awaited.
#[derive(Clone, Copy, Debug, Hash)]
struct Running {
    id: CommandId,
    begun: Instant,
    /// Of a motion: since when the gripper reports that it stands still.
    still_since: Option<Instant>,
}

/// Commands that can run at once: one motion, and the supplies of both fingers being switched on.
const RUNNING_LEN: usize = 3;

/// The controller's side of a connection.
#[derive(Clone, Debug, Hash)]
pub struct Session {
    config: Config,
    link: Link,
    /// Goes before anything else.
    fast_stop: FastStop,
    /// Goes before anything but a FAST STOP.
    stop: Track,
    /// The request whose first answer is awaited.
    request: Track,
    /// The session's own: a step of connecting, or a value asked for again.
    refresh: Track,
    /// The setting that is being read back: `request` is the query.
    reading_back: Option<Command<'static>>,
    /// Requests that wait for the one before to be answered.
    queue: Queue<Request, QUEUE_CAPACITY>,
    /// What a Stop, FAST STOP or Acknowledge has overtaken.
    overtaken: Overtaken,
    /// A request that was sent more than once, and until when another answer to it may still come: a request with the same
    /// id would take that for its own.
    doubled: Option<(CommandId, Instant)>,
    /// What the next tick reports of a Stop: not answered in time, or not at all.
    stop_report: Option<StopReport>,
    /// A request that was overtaken and not answered.
    dropped: Option<CommandId>,
    running: [Option<Running>; RUNNING_LEN],
    /// When the next value is asked for again, and which.
    refresh_at: Instant,
    refresh_step: u8,
    subscriptions: Subscriptions,
    known: Known,
    counters: Counters,
}

/// The requests that will be withdrawn because something more urgent overtook them.
#[derive(Clone, Copy, Debug, Default, Hash)]
struct Overtaken {
    /// The one in [`Session::request`], if it is not sent yet.
    request: bool,
    /// So many at the front of the queue.
    queued: usize,
}

/// What there is to tell about a Stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum StopReport {
    /// Not answered in time, and sent again.
    Late,
    /// Not answered, and not sent again.
    Unanswered,
}

/// Steps of connecting that ask for the two states, before anything else: a gripper that moves must be noticed at once.
const STATE_STEPS: u8 = 2;

impl Session {
    /// A session that is not connected, and begins to connect at once.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self {
            config,
            link: Link::Down { retry_at: None },
            fast_stop: FastStop::new(config.fast_stop),
            stop: Track::new(),
            request: Track::new(),
            refresh: Track::new(),
            reading_back: None,
            queue: Queue::new(),
            overtaken: Overtaken { request: false, queued: 0 },
            doubled: None,
            stop_report: None,
            dropped: None,
            running: [None; RUNNING_LEN],
            refresh_at: Instant::from_millis(0),
            refresh_step: 0,
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
    pub fn motion(&self) -> Option<CommandId> {
        let sent = self.request.id();
        self.running
            .iter()
            .flatten()
            .map(|running| running.id)
            .chain(sent)
            .find(|id| id.kind() == Kind::Motion)
    }

    /// What could not be used so far.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Whether a request waits to be sent, or for its first answer (or its read-back). Stop and FAST STOP aside.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.request.is_idle() || !self.queue.is_empty()
    }

    /// Asks for a command to be sent. Its outcome comes as a [`Notice`].
    ///
    /// Stop, FAST STOP and Acknowledge overtake what waits: it is withdrawn. To ask once for a value that is subscribed to does not
    /// end the subscription.
    ///
    /// # Errors
    /// [`RequestError`]; then the command is not sent, now or later.
    pub fn request(&mut self, mut command: Command<'static>) -> Result<(), RequestError> {
        command.check().map_err(RequestError::Invalid)?;
        self.subscriptions.keep(&mut command);
        self.enqueue(Request::Own(command))
    }

    /// As [`request`](Self::request), for a command that the caller keeps, because it borrows its payload: only the id
    /// is kept here, and the command is sent when [`poll_transmit_lent`](Self::poll_transmit_lent) has it at hand.
    ///
    /// A caller that cannot lend it any more calls [`withdraw`](Self::withdraw). A setting that is lent is not read
    /// back.
    ///
    /// ```
    /// use wsg_protocol::session::{Config, RequestError, Session};
    /// use wsg_protocol::{Command, DeviceTag};
    ///
    /// let mut session = Session::new(Config::DEFAULT);
    /// let text = String::from("left hand");
    /// let command = Command::SetDeviceTag { tag: DeviceTag::new(&text).unwrap() };
    /// assert_eq!(session.request_lent(&command), Err(RequestError::NotConnected));
    /// ```
    ///
    /// # Errors
    /// [`RequestError`]; then the command is not sent, now or later.
    pub fn request_lent(&mut self, command: &Command<'_>) -> Result<(), RequestError> {
        command.check().map_err(RequestError::Invalid)?;
        self.enqueue(match command.id() {
            CommandId::FastStop => Request::Own(Command::FastStop),
            CommandId::Stop => Request::Own(Command::Stop),
            id => Request::Lent(id),
        })
    }

    fn enqueue(&mut self, request: Request) -> Result<(), RequestError> {
        let id = request.id();
        if id == CommandId::FastStop {
            // Owed until the gripper confirms it, connected or not.
            let stop_failed = self.stop.was_late();
            self.stop.close();
            self.fast_stop.open(stop_failed);
            self.overtake();
            return Ok(());
        }
        let fast_stop_runs = self.owes_fast_stop();
        if id == CommandId::Stop && !fast_stop_runs {
            // The gripper may hear although it is not heard. But it is now or never: a Stop that arrives after a
            // reconnect would drop the part that is held then.
            if !self.stop.awaits(id) {
                self.stop.open(request);
            }
            self.overtake();
            return Ok(());
        }
        if !self.is_connected() {
            return Err(RequestError::NotConnected);
        }
        match id.kind() {
            Kind::Stop => Err(RequestError::FastStopRunning),
            Kind::Acknowledge | Kind::Motion if fast_stop_runs => Err(RequestError::FastStopRunning),
            Kind::Acknowledge => {
                self.overtake();
                self.queue.push_back(request).map_err(|_| RequestError::QueueFull)
            }
            Kind::Motion if self.motion_is_open() => Err(RequestError::MotionRunning),
            _ if self.running.iter().flatten().any(|running| running.id == id) => {
                Err(RequestError::MotionRunning)
            }
            _ if self.queue.len() >= QUEUE_LEN => Err(RequestError::QueueFull),
            _ => self.queue.push_back(request).map_err(|_| RequestError::QueueFull),
        }
    }

    /// Marks everything that was requested so far and is not sent: the next ticks withdraw it. What is sent is not sent
    /// again.
    fn overtake(&mut self) {
        self.overtaken = Overtaken { request: true, queued: self.queue.len() };
        // What was set is read back all the same.
        if self.reading_back.is_none() {
            self.request.forbid_repeat();
            if self.request.is_due_again() {
                self.dropped = self.request.abandon();
            }
        }
    }

    /// Takes back every request that was not sent yet, for a caller who is gone (a future that was dropped): no notice
    /// tells of them. What was lent and sent is not sent again. Stop and FAST STOP stay.
    pub fn withdraw(&mut self) {
        self.queue.clear();
        self.overtaken = Overtaken::default();
        if self.reading_back.is_none() && self.request.withdraw_unsent().is_none() {
            self.request.orphan();
        }
    }

    /// Takes back what [`poll_transmit`](Self::poll_transmit) gave last and the caller did not send, not one byte of it,
    /// and will not; whether that was a request that it can still do without. No notice tells of it. A query, Stop and
    /// FAST STOP are not taken back: they may leave late.
    pub fn take_back(&mut self, id: CommandId) -> bool {
        id.kind() != Kind::Query && self.request.take_back(id)
    }

    /// Has the gripper send a value by itself from now on, again after each reconnect, as [`Notice::Reported`].
    /// [`AutoUpdate::once`] ends that. Periods below 10 ms count as 10 ms. In place of what [`Config`] says.
    ///
    /// The two states are asked for again and again even without updates: the session needs them.
    ///
    /// ```
    /// use wsg_protocol::session::{Config, Session, Signal};
    /// use wsg_protocol::AutoUpdate;
    ///
    /// let mut session = Session::new(Config::DEFAULT);
    /// session.subscribe(Signal::Force, AutoUpdate::every(20));
    /// ```
    pub fn subscribe(&mut self, signal: Signal, update: AutoUpdate) {
        self.subscriptions.set(signal, update);
    }

    /// Gives up the connection, for a caller who knows that it is gone: the next [`tick`](Self::tick)s tell what became
    /// of what was open, and a new connection is tried after that. A FAST STOP that is not confirmed goes out again at once:
    /// what was sent may not have arrived.
    pub fn disconnect(&mut self) {
        self.fast_stop.send_again();
        if self.link == Link::Up {
            self.link = Link::Closing;
        } else if self.link != Link::Closing {
            self.known = Known::NOTHING;
            self.refresh.close();
            self.link = Link::Down { retry_at: None };
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
        match self.route(now, &reply) {
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
        if self.link == Link::Closing {
            return Some(self.close_one(now));
        }
        self.expire_tracks(now);
        if self.link == Link::Closing {
            return Some(self.close_one(now));
        }
        if let Some(report) = self.stop_report.take() {
            return Some(match report {
                StopReport::Late => Notice::Late(CommandId::Stop),
                StopReport::Unanswered => Notice::Unanswered(CommandId::Stop),
            });
        }
        if let Some(id) = self.dropped.take() {
            return Some(Notice::Unanswered(id));
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
        self.poll_transmit_lent(now, None)
    }

    /// As [`poll_transmit`](Self::poll_transmit), with the command of [`request_lent`](Self::request_lent) at hand. It
    /// may be given more than once, until it is answered.
    pub fn poll_transmit_lent<'p>(&mut self, now: Instant, lent: Option<Command<'p>>) -> Option<Command<'p>> {
        if self.link == Link::Closing {
            return None; // The caller has not taken all notices yet: what is open belongs to a lost connection.
        }
        if !self.fast_stop.is_idle() {
            // Nothing else: its pauses must be silent, or a gripper that waits for the rest of a frame waits on.
            return self.fast_stop.send(now).then_some(Command::FastStop);
        }
        for track in [&mut self.stop, &mut self.request, &mut self.refresh] {
            if let Some(command) = track.send(now, &self.config, lent) {
                return Some(command);
            }
        }
        None
    }

    /// When [`tick`](Self::tick) must be called at the latest, if nothing else happens.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let tracks = [
            self.fast_stop.deadline(),
            self.fast_stop_deadline().filter(|_| self.is_connected()),
            self.stop.deadline(),
            self.request.deadline(),
            self.refresh.deadline(),
            self.doubled.filter(|_| !self.queue.is_empty() && self.request.is_idle()).map(|(_, until)| until),
        ];
        let link = match self.link {
            // A FAST STOP that is owed comes first; its own time-out runs then.
            Link::Down { retry_at } if !self.is_urgent() => retry_at,
            Link::Up if self.refresh.is_idle() => Some(self.refresh_at),
            _ => None,
        };
        let running = self.running.iter().flatten().map(|running| self.result_deadline(running));
        tracks.into_iter().chain([link]).flatten().chain(running).reduce(Instant::earlier_of)
    }

    /// Whether a FAST STOP was asked for and is not confirmed yet.
    #[must_use]
    pub const fn owes_fast_stop(&self) -> bool {
        !self.fast_stop.is_idle()
    }

    /// Whether a Stop or FAST STOP is on its way.
    const fn is_urgent(&self) -> bool {
        !self.fast_stop.is_idle() || !self.stop.is_idle()
    }

    /// The commands of connecting, in order: the two states, what device, what limits, then the other subscriptions.
    fn setup(&self, step: u8) -> Option<Command<'static>> {
        const INFO: u8 = STATE_STEPS;
        const LIMITS: u8 = INFO + 1;
        /// Steps that are no subscriptions.
        const OF_THE_DEVICE: u8 = 2;
        match step {
            0..STATE_STEPS => self.subscriptions.nth(step),
            INFO => Some(Command::GetSystemInfo),
            LIMITS => Some(Command::GetSystemLimits),
            _ => self.subscriptions.nth(step.saturating_sub(OF_THE_DEVICE)),
        }
    }

    /// Whether a motion runs or waits, also one that was stopped but has not answered yet: another one is refused
    /// ([`RequestError::MotionRunning`]).
    #[must_use]
    pub fn motion_is_open(&self) -> bool {
        self.motion().is_some() || self.queue.iter().any(|request| request.id().kind() == Kind::Motion)
    }

    /// To whom a reply belongs.
    fn route<'a>(&mut self, now: Instant, reply: &Reply<'a>) -> Routed<'a> {
        let (id, status) = (reply.id(), reply.status());
        if let Some(value) = reply.value() {
            self.learn(now, &value);
        }
        let answers_fast_stop = id == CommandId::FastStop && self.fast_stop.was_sent();
        // A FAST STOP is only done when the gripper says so.
        if answers_fast_stop && status != Status::Success {
            return Routed::Unasked;
        }
        if answers_fast_stop || (self.stop.awaits_answer(id) && status.is_final()) {
            if answers_fast_stop {
                self.fast_stop.close();
            } else {
                self.stop.close();
            }
            if matches!(self.link, Link::Down { .. }) {
                self.link = Link::Down { retry_at: None };
            }
            return Routed::Noticed(Notice::Answered(*reply));
        }
        if self.request.awaits_answer(id) {
            return self.route_first_answer(now, reply);
        }
        if status.is_final() && self.end_running(id) {
            return Routed::Noticed(Notice::Answered(*reply));
        }
        if self.refresh.awaits_answer(id) && status == Status::Success {
            return self.route_refresh(now, reply);
        }
        let subscribed =
            self.is_connected() && Signal::of(id).is_some_and(|signal| self.subscriptions.wants(signal));
        match reply.value() {
            Some(value) if subscribed => Routed::Noticed(Notice::Reported(value)),
            _ => Routed::Unasked,
        }
    }

    /// The first answer to a request.
    fn route_first_answer<'a>(&mut self, now: Instant, reply: &Reply<'a>) -> Routed<'a> {
        let (id, status) = (reply.id(), reply.status());
        let asynchronous = id.kind() == Kind::Motion || !id.completion_statuses().is_empty();
        match status {
            Status::CmdPending if asynchronous => {
                self.request.close();
                // There is room: only one motion is let in, and each finger's supply once.
                if let Some(place) = self.running.iter_mut().find(|place| place.is_none()) {
                    *place = Some(Running { id, begun: now, still_since: None });
                }
                Routed::Noticed(Notice::Pending(id))
            }
            Status::CmdPending => Routed::Unasked,
            // A result without E_CMD_PENDING before it is that of an earlier motion, late.
            result
                if asynchronous
                    && id.completion_statuses().contains(&result)
                    && !id.immediate_statuses().contains(&result) =>
            {
                Routed::Unasked
            }
            _ => self.finish_request(reply),
        }
    }

    /// The request is answered; a setting may have to be read back first.
    fn finish_request<'a>(&mut self, reply: &Reply<'a>) -> Routed<'a> {
        let command = self.request.own();
        self.doubled = self.request.doubled().or(self.doubled);
        self.request.close();
        if let Some(setting) = self.reading_back.take() {
            let agrees = reply.value().is_some_and(|value| read_back::agrees(&setting, &value, &self.known));
            let status = if agrees { Status::Success } else { MISMATCH };
            return Routed::Noticed(Notice::Answered(Reply::status_only(setting.id(), status)));
        }
        if self.config.verify_settings
            && reply.status() == Status::Success
            && let Some(setting) = command
            && let Some(query) = read_back::query(&setting)
        {
            self.reading_back = Some(setting);
            self.request.open(Request::Own(query));
            return Routed::Taken;
        }
        Routed::Noticed(Notice::Answered(*reply))
    }

    /// An answer to one of the session's own requests.
    fn route_refresh<'a>(&mut self, now: Instant, reply: &Reply<'a>) -> Routed<'a> {
        if let Some(command) = self.refresh.own() {
            self.subscriptions.confirm(command);
        }
        self.refresh.close();
        self.refresh_at = now.plus(self.config.refresh_ms);
        match self.link {
            Link::Connecting { step } => {
                let next = step.saturating_add(1);
                if self.setup(next).is_some() {
                    self.link = Link::Connecting { step: next };
                    Routed::Taken
                } else {
                    self.link = Link::Up;
                    self.refresh_step = 0;
                    Routed::Noticed(Notice::Connected)
                }
            }
            _ => reply.value().map_or(Routed::Taken, |value| Routed::Noticed(Notice::Reported(value))),
        }
    }

    /// Takes over a reported value, and what it says of a running motion.
    fn learn(&mut self, now: Instant, value: &Value<'_>) {
        self.known.learn(value);
        if !matches!(value, Value::GetSystemState(_) | Value::GetGripperState(_)) {
            return;
        }
        let moves = self.known.is_moving();
        for motion in self.running.iter_mut().flatten().filter(|running| running.id.kind() == Kind::Motion) {
            motion.still_since = if moves { None } else { motion.still_since.or(Some(now)) };
        }
    }

    /// What is done about answers that did not come.
    fn expire_tracks(&mut self, now: Instant) {
        if self.doubled.is_some_and(|(_, until)| now.has_reached(until)) {
            self.doubled = None;
        }
        if !self.fast_stop.is_idle() {
            self.fast_stop.expire(now);
            if self.link == Link::Up && self.fast_stop_deadline().is_some_and(|at| now.has_reached(at)) {
                self.link = Link::Closing;
            }
        }
        let attempts = if self.is_connected() { self.config.attempts } else { 1 };
        if !self.is_connected() && self.stop.is_overdue(now) {
            self.stop.close();
            self.stop_report = Some(StopReport::Unanswered);
        }
        let stop = self.stop.expire(now, attempts);
        if stop == Expired::Repeated {
            self.stop_report = Some(StopReport::Late);
        }
        for expired in [stop, self.request.expire(now, attempts), self.refresh.expire(now, attempts)] {
            match expired {
                Expired::No => {}
                // Only a caller's request can be overtaken.
                Expired::Overtaken => self.dropped = self.request.abandon(),
                Expired::Repeated => count(&mut self.counters.repeated),
                Expired::GivenUp => match self.link {
                    // Another track may have been given up at the same moment.
                    Link::Up | Link::Closing => self.link = Link::Closing,
                    Link::Down { .. } | Link::Connecting { .. } => {
                        self.link = Link::Down { retry_at: Some(now.plus(self.config.reconnect_ms)) };
                        self.known = Known::NOTHING;
                    }
                },
            }
        }
        if !self.fast_stop.is_idle() {
            self.request.hold(now, &self.config);
            self.refresh.hold(now, &self.config);
        }
        if matches!(self.link, Link::Down { .. }) {
            self.refresh.close();
        }
    }

    /// When the connection counts as lost because a FAST STOP is not confirmed.
    fn fast_stop_deadline(&self) -> Option<Instant> {
        let patience_ms = self.config.reply_timeout_ms.saturating_mul(self.config.attempts.into());
        self.fast_stop.begun().map(|begun| begun.plus(patience_ms))
    }

    /// Gives up the connection, one open thing after the other.
    fn close_one(&mut self, now: Instant) -> Notice<'static> {
        self.known = Known::NOTHING;
        self.refresh.close();
        if let Some(id) = self.dropped.take() {
            return Notice::Unanswered(id);
        }
        if let Some(running) = self.running.iter_mut().find_map(Option::take) {
            return Notice::Unanswered(running.id);
        }
        let setting = self.reading_back.take().map(|setting| setting.id());
        if let Some(id) = self.request.abandon() {
            return Notice::Unanswered(setting.unwrap_or(id));
        }
        if let Some(id) = self.stop.abandon() {
            return Notice::Unanswered(id);
        }
        if let Some(request) = self.queue.pop_front() {
            return Notice::Withdrawn(request.id());
        }
        self.stop_report = None;
        self.doubled = None;
        self.overtaken = Overtaken::default();
        count(&mut self.counters.disconnects);
        self.link = Link::Down { retry_at: Some(now.plus(self.config.reconnect_ms)) };
        Notice::Disconnected
    }

    /// Withdraws what a Stop, FAST STOP or Acknowledge has overtaken, one request after the other.
    fn withdraw_overtaken(&mut self) -> Option<CommandId> {
        if !self.overtaken.request && self.overtaken.queued == 0 {
            return None;
        }
        if core::mem::take(&mut self.overtaken.request)
            // What was set is read back all the same.
            && self.reading_back.is_none()
            && let Some(unsent) = self.request.withdraw_unsent()
        {
            return Some(unsent);
        }
        self.overtaken.queued = self.overtaken.queued.checked_sub(1)?;
        self.queue.pop_front().map(|request| request.id())
    }

    /// Gives up a running command whose result does not come.
    fn expire_running(&mut self, now: Instant) -> Option<CommandId> {
        let mut running = self.running.iter().flatten();
        let late = running.find(|running| now.has_reached(self.result_deadline(running)))?.id;
        self.end_running(late);
        Some(late)
    }

    /// Takes out this command, if it runs; whether it does.
    fn end_running(&mut self, id: CommandId) -> bool {
        let place = self.running.iter_mut().find(|place| place.is_some_and(|running| running.id == id));
        place.is_some_and(|place| place.take().is_some())
    }

    /// Until when the result of a running command is waited for.
    fn result_deadline(&self, running: &Running) -> Instant {
        let longest = running.begun.plus(self.config.result_timeout(running.id));
        let grace = running.still_since.map(|since| since.plus(self.config.result_grace_ms));
        grace.map_or(longest, |grace| grace.earlier_of(longest))
    }

    /// Opens what is due: the next request, the next step of connecting, the next value to ask for again.
    fn advance(&mut self, now: Instant) {
        if self.is_connected()
            && !self.is_urgent()
            && self.request.is_idle()
            && !self.may_take_a_doubled_answer()
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
            self.refresh.open(Request::Own(changed));
            return;
        }
        match self.link {
            // A FAST STOP that is owed is the first thing that a gripper hears.
            Link::Down { retry_at } => {
                if !self.is_urgent() && retry_at.is_none_or(|at| now.has_reached(at)) {
                    self.link = Link::Connecting { step: 0 };
                    self.open_refresh(0);
                }
            }
            Link::Connecting { step } => self.open_refresh(step),
            Link::Up if now.has_reached(self.refresh_at) => {
                let step = self.refresh_step;
                if let Some(command) = self.subscriptions.nth(step) {
                    self.refresh.open(Request::Own(command));
                }
                let next = step.saturating_add(1);
                self.refresh_step = if self.subscriptions.nth(next).is_some() { next } else { 0 };
            }
            Link::Up | Link::Closing => {}
        }
    }

    /// Whether the next request in the queue could be answered by the second answer to an earlier one of the same id.
    fn may_take_a_doubled_answer(&self) -> bool {
        self.doubled.is_some_and(|(id, _)| self.queue.front().map(Request::id) == Some(id))
    }

    fn open_refresh(&mut self, step: u8) {
        if let Some(command) = self.setup(step) {
            self.refresh.open(Request::Own(command));
        }
    }
}

/// To whom a reply belongs.
enum Routed<'a> {
    /// To nobody.
    Unasked,
    /// To the session itself.
    Taken,
    /// To the caller.
    Noticed(Notice<'a>),
}

fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}

#[cfg(test)]
#[path = "session_tests.rs"]
pub(crate) mod tests;
