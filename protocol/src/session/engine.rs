//! One engine for every dialect: queueing, time-outs, repeats, Stop and FAST STOP, reconnecting, subscriptions.

use super::config::Timing;
use super::dialect::{Dialect, NameOf, Role};
use super::event::{EventOf, RequestError, SessionCounters};
use super::fast_stop::FastStop;
use super::message::{Message, Name};
use super::subscriptions::List;
use super::transaction::{Expired, Outgoing, Request, Transaction};
use crate::command::Kind;
use crate::queue::Queue;
use crate::time::Instant;
use crate::types::Status;

/// What happened, in the terms of a dialect.
pub(crate) type EventIn<'a, D> = EventOf<NameOf<D>, <D as Dialect>::Answer<'a>, <D as Dialect>::Value<'a>>;

/// How many requests may wait to be sent.
pub const QUEUE_LEN: usize = 4;

/// Room for an acknowledgement behind a full queue, which it withdraws.
const QUEUE_CAPACITY: usize = QUEUE_LEN + 1;

/// How often a refresh is sent within the time-out of a request: one lost answer must not let a state grow old.
const REFRESH_REPEATS: u32 = 4;

/// Where the connection stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Link {
    /// No answer; the next attempt begins at the given time, or at once.
    Down { retry_at: Option<Instant> },
    /// The requests of [`Dialect::setup`] are being answered, this one now.
    Connecting { step: u8 },
    /// All of them are.
    Up,
    /// Being given up: what is open is reported first.
    Closing { farewell: bool },
    /// The gripper confirmed a farewell: nothing is sent.
    Ended,
}

/// A command that has begun (E_CMD_PENDING) and whose result is awaited.
#[derive(Clone, Copy, Debug, Hash)]
struct Running<N> {
    name: N,
    begun: Instant,
    /// Of a motion: since when the gripper reports that it stands still.
    still_since: Option<Instant>,
}

/// Commands that can run at once: one motion, and the supplies of both fingers being switched on.
const RUNNING_LEN: usize = 3;

/// The controller's side of a connection, in any dialect.
#[derive(Clone, Debug, Hash)]
pub struct Engine<D: Dialect> {
    dialect: D,
    timing: Timing<NameOf<D>>,
    link: Link,
    /// Goes before anything else.
    fast_stop: FastStop,
    /// Goes before anything but a FAST STOP.
    stop: Transaction<D::Request>,
    /// The request whose first answer is awaited.
    request: Transaction<D::Request>,
    /// The session's own: a step of connecting, or a value asked for again.
    refresh: Transaction<D::Request>,
    /// The setting that is being read back: `request` is the query.
    reading_back: Option<D::Request>,
    /// Requests that wait for the one before to be answered.
    queue: Queue<Request<D::Request>, QUEUE_CAPACITY>,
    /// What a Stop, FAST STOP or Acknowledge has overtaken.
    overtaken: Overtaken,
    /// A request that was sent more than once, and until when another answer to it may still come: a request of the
    /// same name would take that for its own.
    doubled: Option<(NameOf<D>, Instant)>,
    /// What the next tick reports of a Stop: not answered in time, or not at all.
    stop_report: Option<StopReport>,
    /// A request that was overtaken and not answered.
    dropped: Option<NameOf<D>>,
    running: [Option<Running<NameOf<D>>>; RUNNING_LEN],
    /// A command whose result was not waited for any longer: it may still come.
    given_up: Option<NameOf<D>>,
    /// When the next value is asked for again, and which.
    refresh_at: Instant,
    refresh_step: u8,
    subscriptions: D::Subscriptions,
    known: D::Known,
    /// When the query was opened that showed the settings that are known.
    confirmed: Instant,
    /// When the query was opened that is to show that they still hold.
    upkeep_opened: Instant,
    /// When that query is due, or answered in vain; none while no setting is known.
    upkeep_at: Option<Instant>,
    counters: SessionCounters,
}

/// The requests that will be withdrawn because something more urgent overtook them.
#[derive(Clone, Copy, Debug, Default, Hash)]
struct Overtaken {
    /// The one whose first answer is awaited, if it is not sent yet.
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

impl<D: Dialect> Engine<D> {
    /// A session that is not connected, and begins to connect at once.
    pub(crate) const fn over(dialect: D, timing: Timing<NameOf<D>>, subscriptions: D::Subscriptions) -> Self {
        Self {
            dialect,
            timing,
            link: Link::Down { retry_at: None },
            fast_stop: FastStop::new(timing.fast_stop),
            stop: Transaction::new(),
            request: Transaction::new(),
            refresh: Transaction::new(),
            reading_back: None,
            queue: Queue::new(),
            overtaken: Overtaken { request: false, queued: 0 },
            doubled: None,
            stop_report: None,
            dropped: None,
            running: [const { None }; RUNNING_LEN],
            given_up: None,
            refresh_at: Instant::from_millis(0),
            refresh_step: 0,
            subscriptions,
            known: D::NOTHING,
            confirmed: Instant::from_millis(0),
            upkeep_opened: Instant::from_millis(0),
            upkeep_at: None,
            counters: SessionCounters { unsolicited: 0, refused: 0, repeated: 0, disconnects: 0 },
        }
    }

    /// Whether the gripper answers.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        matches!(self.link, Link::Up)
    }

    /// What is known of the gripper; nothing without a connection.
    #[must_use]
    pub const fn known(&self) -> &D::Known {
        &self.known
    }

    /// The motion that is running: sent and not yet finished, as far as is known.
    #[must_use]
    pub fn motion(&self) -> Option<NameOf<D>> {
        let sent = self.request.name();
        self.running
            .iter()
            .flatten()
            .map(|running| running.name)
            .chain(sent)
            .find(|name| name.kind() == Kind::Motion)
    }

    /// What could not be used so far.
    #[must_use]
    pub const fn counters(&self) -> SessionCounters {
        self.counters
    }

    /// Whether a request waits to be sent, or for its first answer (or its read-back). Stop and FAST STOP aside.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.request.is_idle() || !self.queue.is_empty()
    }

    /// Takes a request that was checked. Its outcome comes as an [`EventOf`].
    pub(crate) fn enqueue(&mut self, request: Request<D::Request>) -> Result<(), RequestError<D::Invalid>> {
        let name = request.name();
        if !D::leaves_settings(name) {
            D::forget_settings(&mut self.known);
        }
        if name == D::Request::FAST_STOP.name() {
            // Owed until the gripper confirms it, connected or not.
            let stop_failed = self.stop.was_late();
            self.stop.close();
            self.fast_stop.open(stop_failed);
            self.overtake();
            return Ok(());
        }
        let fast_stop_runs = self.fast_stop_pending();
        if name == D::Request::STOP.name() && !fast_stop_runs && self.link != Link::Ended {
            // The gripper may hear although it is not heard. But it is now or never: a Stop that arrives over another
            // connection would drop the part that is held then.
            if !self.stop.awaits(name) {
                self.stop.open(request, self.timing.reply_timeout(name));
            }
            self.overtake();
            return Ok(());
        }
        if !self.is_connected() {
            return Err(RequestError::NotConnected);
        }
        match name.kind() {
            Kind::Stop => Err(RequestError::FastStopRunning),
            Kind::Acknowledge | Kind::Motion if fast_stop_runs => Err(RequestError::FastStopRunning),
            Kind::Acknowledge => {
                self.overtake();
                self.queue.push_back(request).map_err(|_| RequestError::QueueFull)
            }
            Kind::Motion if self.motion_is_open() => Err(RequestError::MotionRunning),
            _ if self.running.iter().flatten().any(|running| running.name == name) => {
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

    /// Cancels every request that was not sent yet, for a caller that is gone (a future that was dropped): no event
    /// tells of them. A borrowed request that was sent is not repeated. Stop and FAST STOP remain.
    pub fn withdraw(&mut self) {
        self.queue.clear();
        self.overtaken = Overtaken::default();
        if self.reading_back.is_none() && self.request.withdraw_unsent().is_none() {
            self.request.orphan();
        }
    }

    /// Cancels the last polled request if the gripper cannot have it: not one byte of it was sent, or what was sent is no
    /// message. Returns whether it could. No event tells of it. A query, Stop and FAST STOP cannot be cancelled: they may be sent late.
    pub fn take_back(&mut self, name: NameOf<D>) -> bool {
        name.kind() != Kind::Query && self.request.take_back(name)
    }

    /// Returns whether a motion or acknowledgement that was polled must not be carried out any more: a Stop or FAST STOP is not
    /// answered, or an Acknowledge was requested after it. A line that still holds a part of it withdraws it, for
    /// [`take_back`](Self::take_back).
    ///
    /// An answer does not count: it may be a late one to an earlier command.
    #[must_use]
    pub fn has_overtaken(&self) -> bool {
        let is_overtaken = |name: NameOf<D>| matches!(name.kind(), Kind::Motion | Kind::Acknowledge);
        self.is_urgent() || self.request.overtaken().is_some_and(is_overtaken)
    }

    /// Returns what is subscribed to, for a change, which the gripper is told when nothing else is due.
    pub(crate) const fn subscriptions_mut(&mut self) -> &mut D::Subscriptions {
        &mut self.subscriptions
    }

    /// Returns what is subscribed to.
    pub(crate) const fn subscriptions(&self) -> &D::Subscriptions {
        &self.subscriptions
    }

    /// Gives up the connection, for a caller who knows that it is gone, or who has opened a new one: the next
    /// [`tick`](Self::tick)s tell what became of what was open, and then it is connected anew. A FAST STOP that is
    /// not confirmed goes out again at once: what was sent may not have arrived.
    pub fn disconnect(&mut self) {
        self.fast_stop.send_again();
        match self.link {
            Link::Up | Link::Closing { .. } => self.link = Link::Closing { farewell: false },
            Link::Down { .. } | Link::Connecting { .. } | Link::Ended => {
                self.known = D::NOTHING;
                self.refresh.close();
                self.link = Link::Down { retry_at: None };
            }
        }
    }

    /// Counts a message that cannot be understood.
    pub(crate) const fn count_refused(&mut self) {
        count(&mut self.counters.refused);
    }

    /// Takes an answer, or an update.
    #[inline]
    pub(crate) fn take<'a>(&mut self, now: Instant, answer: &D::Answer<'a>) -> Option<EventIn<'a, D>> {
        match self.route(now, answer) {
            Routed::Unsolicited => {
                count(&mut self.counters.unsolicited);
                None
            }
            Routed::Taken => None,
            Routed::Connected => Some(EventOf::Connected),
            Routed::Pending(name) => Some(EventOf::Pending(name)),
            Routed::Answered => Some(EventOf::Answered(*answer)),
            Routed::ReadBack(setting) => {
                let outcome = D::read_back_answer(&setting, answer, &mut self.known);
                // What waits may change it; and one of two answers may be from before the setting.
                if self.is_urgent() || !self.queue.is_empty() || self.doubled.is_some() {
                    D::forget_settings(&mut self.known);
                }
                self.confirm(self.confirmed);
                Some(EventOf::Answered(outcome))
            }
            Routed::Reported => D::value(answer).map(|value| EventOf::Reported(*value)),
        }
    }

    /// Processes what is due at `now`, one event at a time. Call it again until it returns `None`.
    pub fn tick(&mut self, now: Instant) -> Option<EventIn<'static, D>> {
        if let Link::Closing { farewell } = self.link {
            return Some(self.close_one(now, farewell));
        }
        self.expire_transactions(now);
        if let Link::Closing { farewell } = self.link {
            return Some(self.close_one(now, farewell));
        }
        if let Some(report) = self.stop_report.take() {
            return Some(match report {
                StopReport::Late => EventOf::Late(D::Request::STOP.name()),
                StopReport::Unanswered => EventOf::Unanswered(D::Request::STOP.name()),
            });
        }
        if let Some(name) = self.dropped.take() {
            return Some(EventOf::Unanswered(name));
        }
        if let Some(overtaken) = self.withdraw_overtaken() {
            return Some(EventOf::Withdrawn(overtaken));
        }
        if let Some(name) = self.expire_running(now) {
            return Some(EventOf::Unanswered(name));
        }
        self.advance(now);
        None
    }

    /// The next request to send, which counts as sent now. `borrowed`: the caller has one of this name at hand.
    pub(crate) fn next_to_send(
        &mut self,
        now: Instant,
        borrowed: Option<NameOf<D>>,
    ) -> Option<Outgoing<'_, D::Request>> {
        if matches!(self.link, Link::Closing { .. } | Link::Ended) {
            return None; // What is open belongs to a connection that is over, and the caller is still to be told.
        }
        if !self.fast_stop.is_idle() {
            // Nothing else: its pauses must be silent, or a gripper that waits for the rest of a frame waits on.
            return self.fast_stop.send(now).then_some(Outgoing::FastStop);
        }
        [&mut self.stop, &mut self.request, &mut self.refresh]
            .into_iter()
            .find_map(|transaction| transaction.send(now, borrowed))
    }

    /// When [`tick`](Self::tick) must be called at the latest, if nothing else happens.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let (attempts, refresh_attempts) = self.attempts();
        let transactions = [
            self.fast_stop.deadline(),
            self.fast_stop_deadline().filter(|_| self.is_connected()),
            self.stop.expires_at(attempts),
            self.request.expires_at(attempts),
            self.refresh.expires_at(refresh_attempts),
            self.doubled.filter(|_| !self.queue.is_empty() && self.request.is_idle()).map(|(_, until)| until),
        ];
        let link = match self.link {
            // A FAST STOP that is owed comes first; its own time-out runs then.
            Link::Down { retry_at } if !self.is_urgent() => retry_at,
            Link::Up if self.refresh.is_idle() => {
                Some(self.upkeep_at.map_or(self.refresh_at, |at| at.earlier_of(self.refresh_at)))
            }
            _ => None,
        };
        let running = self.running.iter().flatten().map(|running| self.result_deadline(running));
        transactions.into_iter().chain([link]).flatten().chain(running).reduce(Instant::earlier_of)
    }

    /// Whether a FAST STOP was asked for and is not confirmed yet.
    #[must_use]
    pub const fn fast_stop_pending(&self) -> bool {
        !self.fast_stop.is_idle()
    }

    /// Whether a Stop or FAST STOP is on its way.
    pub(crate) const fn is_urgent(&self) -> bool {
        !self.fast_stop.is_idle() || !self.stop.is_idle()
    }

    /// Whether a motion runs or waits, also one that was stopped but has not answered yet: another one is refused
    /// ([`RequestError::MotionRunning`]).
    #[must_use]
    pub fn motion_is_open(&self) -> bool {
        self.motion().is_some() || self.queue.iter().any(|request| request.name().kind() == Kind::Motion)
    }

    /// To whom an answer belongs.
    fn route(&mut self, now: Instant, answer: &D::Answer<'_>) -> Routed<D::Request> {
        let Some(name) = D::name(answer) else { return Routed::Unsolicited };
        let value = D::value(answer);
        if let Some(value) = value {
            self.learn(now, value);
        }
        let has_value = value.is_some();
        match D::role(answer) {
            Role::Update if self.wants(name, has_value) => {
                // It begins to come while the next step of connecting is being answered.
                if self.is_connected() { Routed::Reported } else { Routed::Taken }
            }
            Role::Update => Routed::Unsolicited,
            Role::Result if self.end_running(name) => Routed::Answered,
            // Without E_CMD_PENDING before it, it is that of an earlier motion, late.
            Role::Result => Routed::Unsolicited,
            Role::Answer => self.route_answer(now, name, answer).unwrap_or(Routed::Unsolicited),
            Role::Any => match self.route_answer(now, name, answer) {
                Some(routed) => routed,
                None if self.is_connected() && self.wants(name, has_value) => Routed::Reported,
                None => Routed::Unsolicited,
            },
        }
    }

    /// Whether a value of this name, if there is one, is subscribed to.
    fn wants(&self, name: NameOf<D>, has_value: bool) -> bool {
        has_value && self.subscriptions.wants(name)
    }

    /// An answer to what is open; `None` if it is none.
    fn route_answer(
        &mut self,
        now: Instant,
        name: NameOf<D>,
        answer: &D::Answer<'_>,
    ) -> Option<Routed<D::Request>> {
        let status = D::status(answer);
        let answers_fast_stop = name == D::Request::FAST_STOP.name() && self.fast_stop.was_sent();
        // A FAST STOP is only done when the gripper says so.
        if answers_fast_stop && status != Status::Success {
            return Some(Routed::Unsolicited);
        }
        if answers_fast_stop || (self.stop.awaits_answer(name) && status.is_final()) {
            if answers_fast_stop {
                self.fast_stop.close();
            } else {
                self.stop.close();
            }
            if matches!(self.link, Link::Down { .. }) {
                self.link = Link::Down { retry_at: None };
            }
            return Some(Routed::Answered);
        }
        if D::UPKEEP == Some(name) && self.upkeep_is_sent() {
            // Ahead of a setting's read-back: the first answer may be from before the setting.
            self.refresh.close();
            self.confirm(self.upkeep_opened);
            if status != Status::Success {
                D::forget_settings(&mut self.known);
            }
            return Some(Routed::Taken);
        }
        if self.request.awaits_answer(name) && self.request.own().is_none_or(|own| D::fits(own, answer)) {
            return Some(self.route_first_answer(now, name, status));
        }
        if status.is_final() && self.end_running(name) {
            return Some(Routed::Answered);
        }
        let is_step = self.refresh.awaits_answer(name)
            && self.refresh.own().is_some_and(|own| D::fits(own, answer))
            && D::completes_step(name, status);
        is_step.then(|| self.route_refresh(now))
    }

    /// The first answer to a request.
    fn route_first_answer(&mut self, now: Instant, name: NameOf<D>, status: Status) -> Routed<D::Request> {
        if D::is_late_result(name, status, self.given_up == Some(name)) {
            self.given_up = None;
            return Routed::Unsolicited;
        }
        if status != Status::CmdPending {
            return self.finish_request(now, name, status);
        }
        if !D::is_asynchronous(name) {
            return Routed::Unsolicited;
        }
        self.request.close();
        self.given_up = None;
        // There is room: only one motion is let in, and each finger's supply once.
        if let Some(place) = self.running.iter_mut().find(|place| place.is_none()) {
            *place = Some(Running { name, begun: now, still_since: None });
        }
        Routed::Pending(name)
    }

    /// The request is answered; a setting may have to be read back first.
    fn finish_request(&mut self, now: Instant, name: NameOf<D>, status: Status) -> Routed<D::Request> {
        let request = self.request.own().copied();
        self.doubled = self.request.doubled().or(self.doubled);
        self.request.close();
        if let Some(setting) = self.reading_back.take() {
            return Routed::ReadBack(setting);
        }
        if status == Status::Success
            && let Some(setting) = request
            && let Some(query) = self.dialect.read_back(&setting)
        {
            self.reading_back = Some(setting);
            self.confirmed = now;
            self.request.open(Request::Own(query), self.timing.reply_timeout(query.name()));
            return Routed::Taken;
        }
        if status == Status::Success && D::is_farewell(name) {
            self.link = Link::Closing { farewell: true };
        }
        Routed::Answered
    }

    /// An answer to one of the session's own requests.
    fn route_refresh(&mut self, now: Instant) -> Routed<D::Request> {
        if let Some(request) = self.refresh.own() {
            self.subscriptions.confirm(request);
        }
        self.refresh.close();
        match self.link {
            Link::Connecting { step } => {
                let next = step.saturating_add(1);
                if self.dialect.setup(next, &self.subscriptions).is_some() {
                    self.link = Link::Connecting { step: next };
                    Routed::Taken
                } else {
                    self.link = Link::Up;
                    self.refresh_step = 0;
                    self.refresh_at = now.plus(self.refresh_interval_ms());
                    Routed::Connected
                }
            }
            // For a subscriber, if there is a value.
            _ => Routed::Reported,
        }
    }

    /// Takes over a reported value, and what it says of a running motion.
    fn learn(&mut self, now: Instant, value: &D::Value<'_>) {
        let Some(moves) = D::learn(&mut self.known, value) else { return };
        for motion in self.running.iter_mut().flatten().filter(|running| running.name.kind() == Kind::Motion)
        {
            motion.still_since = if moves { None } else { motion.still_since.or(Some(now)) };
        }
    }

    #[inline(never)]
    fn take_expired(&mut self, now: Instant, expired: [Expired; 3]) {
        for expired in expired {
            match expired {
                Expired::No => {}
                // Only a caller's request can be overtaken.
                Expired::Overtaken => self.dropped = self.request.abandon(),
                Expired::Repeated => count(&mut self.counters.repeated),
                Expired::GivenUp => match self.link {
                    Link::Up => self.link = Link::Closing { farewell: false },
                    // Another transaction may have been given up at the same moment.
                    Link::Closing { .. } | Link::Ended => {}
                    Link::Down { .. } | Link::Connecting { .. } => {
                        self.link = Link::Down { retry_at: Some(now.plus(self.timing.reconnect_ms)) };
                        self.known = D::NOTHING;
                    }
                },
            }
        }
    }

    /// Repeats or gives up what was not answered in time.
    fn expire_transactions(&mut self, now: Instant) {
        if self.doubled.is_some_and(|(_, until)| now.has_reached(until)) {
            self.doubled = None;
        }
        if !self.fast_stop.is_idle() {
            self.fast_stop.expire(now);
            if self.link == Link::Up && self.fast_stop_deadline().is_some_and(|at| now.has_reached(at)) {
                self.link = Link::Closing { farewell: false };
            }
        }
        if self.upkeep_at.is_some_and(|at| now.has_reached(at)) {
            self.keep_up(now);
        }
        let (attempts, refresh_attempts) = self.attempts();
        if !self.is_connected() && self.stop.is_overdue(now) {
            self.stop.close();
            self.stop_report = Some(StopReport::Unanswered);
        }
        let stop = self.stop.expire(now, attempts);
        if stop == Expired::Repeated {
            self.stop_report = Some(StopReport::Late);
        }
        let expired = [stop, self.request.expire(now, attempts), self.refresh.expire(now, refresh_attempts)];
        if !matches!(expired, [Expired::No, Expired::No, Expired::No]) {
            self.take_expired(now, expired);
        }
        if !self.fast_stop.is_idle() {
            self.request.hold(now);
            self.refresh.hold(now);
        }
        if matches!(self.link, Link::Down { .. }) {
            self.refresh.close();
        }
    }

    /// How often a request is sent before the connection counts as lost, and how often a refresh is.
    const fn attempts(&self) -> (u8, u8) {
        if self.is_connected() {
            (self.timing.attempts, self.timing.attempts.saturating_mul(REFRESH_REPEATS as u8))
        } else {
            (1, 1)
        }
    }

    /// When the connection counts as lost because a FAST STOP is not confirmed.
    fn fast_stop_deadline(&self) -> Option<Instant> {
        let patience_ms = self.timing.reply_timeout_ms.saturating_mul(self.timing.attempts.into());
        self.fast_stop.begun().map(|begun| begun.plus(patience_ms))
    }

    /// Gives up the connection, one open thing after the other.
    fn close_one(&mut self, now: Instant, farewell: bool) -> EventIn<'static, D> {
        self.known = D::NOTHING;
        self.refresh.close();
        if let Some(name) = self.dropped.take() {
            return EventOf::Unanswered(name);
        }
        if let Some(running) = self.running.iter_mut().find_map(Option::take) {
            self.given_up = Some(running.name);
            return EventOf::Unanswered(running.name);
        }
        let setting = self.reading_back.take().map(|setting| setting.name());
        if let Some(name) = self.request.abandon() {
            return EventOf::Unanswered(setting.unwrap_or(name));
        }
        if let Some(name) = self.stop.abandon() {
            return EventOf::Unanswered(name);
        }
        if let Some(request) = self.queue.pop_front() {
            return EventOf::Withdrawn(request.name());
        }
        self.stop_report = None;
        self.doubled = None;
        self.overtaken = Overtaken::default();
        if farewell {
            self.link = Link::Ended;
        } else {
            count(&mut self.counters.disconnects);
            self.link = Link::Down { retry_at: Some(now.plus(self.timing.reconnect_ms)) };
        }
        EventOf::Disconnected
    }

    /// Withdraws what a Stop, FAST STOP or Acknowledge has overtaken, one request after the other.
    fn withdraw_overtaken(&mut self) -> Option<NameOf<D>> {
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
        self.queue.pop_front().map(|request| request.name())
    }

    /// Gives up a running command whose result does not come.
    fn expire_running(&mut self, now: Instant) -> Option<NameOf<D>> {
        let mut running = self.running.iter().flatten();
        let late = running.find(|running| now.has_reached(self.result_deadline(running)))?.name;
        self.end_running(late);
        self.given_up = Some(late);
        Some(late)
    }

    /// Takes out this command, if it runs; whether it does.
    fn end_running(&mut self, name: NameOf<D>) -> bool {
        let place = self.running.iter_mut().find(|place| place.is_some_and(|running| running.name == name));
        place.is_some_and(|place| place.take().is_some())
    }

    /// Until when the result of a running command is waited for.
    fn result_deadline(&self, running: &Running<NameOf<D>>) -> Instant {
        let longest = running.begun.plus(self.timing.result_timeout(running.name));
        let grace = running.still_since.map(|since| since.plus(self.timing.result_grace_ms));
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
            self.request.open(request, self.timing.reply_timeout(request.name()));
        }
        if !self.refresh.is_idle() {
            return;
        }
        if self.link == Link::Up
            && let Some(changed) = self.subscriptions.changed()
        {
            self.open_refresh(changed);
            return;
        }
        match self.link {
            // A FAST STOP that is owed is the first thing that a gripper hears.
            Link::Down { retry_at } => {
                if !self.is_urgent() && retry_at.is_none_or(|at| now.has_reached(at)) {
                    self.link = Link::Connecting { step: 0 };
                    self.open_step(0);
                }
            }
            Link::Connecting { step } => self.open_step(step),
            Link::Up if now.has_reached(self.refresh_at) => {
                let step = self.refresh_step;
                if let Some(request) = self.dialect.refresh(step, &self.subscriptions) {
                    self.open_refresh(request);
                    self.refresh_at = now.plus(self.refresh_interval_ms());
                }
                let next = step.saturating_add(1);
                let goes_on = self.dialect.refresh(next, &self.subscriptions).is_some();
                self.refresh_step = if goes_on { next } else { 0 };
            }
            Link::Up | Link::Closing { .. } | Link::Ended => {}
        }
    }

    /// The time between two refreshes: within `refresh_ms` each value is requested once.
    fn refresh_interval_ms(&self) -> u32 {
        let is_value = |step: &u8| self.dialect.refresh(*step, &self.subscriptions).is_some();
        let values = (0..=u8::MAX).take_while(is_value).fold(0u32, |count, _| count.saturating_add(1));
        self.timing.refresh_ms.checked_div(values).unwrap_or(self.timing.refresh_ms)
    }

    /// Whether the refresh is an upkeep, and awaits its answer: it is sent once.
    fn upkeep_is_sent(&self) -> bool {
        self.refresh.deadline().is_some() && self.refresh.own().is_some_and(D::is_upkeep)
    }

    /// The settings that are known were shown by a query of that time. They are asked for again when half of the time is over for
    /// which they count.
    fn confirm(&mut self, opened: Instant) {
        self.confirmed = opened;
        self.upkeep_at = Some(opened.plus(self.timing.refresh_ms / 2));
    }

    /// Asks for the settings that are known, and forgets them when they were not confirmed in time.
    // Seldom due.
    #[inline(never)]
    fn keep_up(&mut self, now: Instant) {
        let is_late = self.upkeep_is_sent() && self.refresh.is_overdue(now);
        if is_late {
            // Not sent again: of two answers the later one could pass for that to a read-back.
            self.refresh.close();
        }
        if is_late || now.has_reached(self.confirmed.plus(self.timing.refresh_ms)) {
            D::forget_settings(&mut self.known);
        }
        match D::upkeep(&self.known) {
            Some(query) if self.refresh.is_idle() => {
                self.upkeep_opened = now;
                self.open_refresh(query);
            }
            None if !self.refresh.own().is_some_and(D::is_upkeep) => self.upkeep_at = None,
            _ => {}
        }
    }

    /// Whether the next request in the queue could be answered by the second answer to an earlier one of the same name.
    fn may_take_a_doubled_answer(&self) -> bool {
        self.doubled.is_some_and(|(name, _)| self.queue.front().map(Request::name) == Some(name))
    }

    fn open_step(&mut self, step: u8) {
        if let Some(request) = self.dialect.setup(step, &self.subscriptions) {
            self.open_refresh(request);
        }
    }

    /// Opens one of the session's own requests. While the link is up, a lost answer must not let a state grow old.
    fn open_refresh(&mut self, request: D::Request) {
        let reply_ms = self.timing.reply_timeout(request.name());
        let timeout_ms = if self.is_connected() { (reply_ms / REFRESH_REPEATS).max(1) } else { reply_ms };
        self.refresh.open(Request::Own(request), timeout_ms);
    }
}

/// To whom an answer belongs, and what it says there.
enum Routed<M: Message> {
    /// To nobody: it was not asked for, or came too late.
    Unsolicited,
    /// To the session itself.
    Taken,
    /// To the session; all steps of connecting are done.
    Connected,
    /// To a request that has begun.
    Pending(M::Name),
    /// To a request, as its final answer.
    Answered,
    /// To this setting, which was read back.
    ReadBack(M),
    /// To a subscriber, if there is a value.
    Reported,
}

const fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}
