//! The engine common to all dialects: queueing, time-outs, retries, Stop and FAST STOP, reconnecting, subscriptions.

mod routing;
mod schedule;

use self::routing::Routed;
use super::config::Timing;
use super::dialect::{Dialect, NameOf};
use super::event::{EventOf, RequestError, SessionCounters};
use super::fast_stop::FastStop;
use super::message::{Message, Name};
use super::transaction::{Expired, Outgoing, Request, Transaction};
use crate::command::Kind;
use crate::queue::Queue;
use crate::time::Instant;

/// An event in the types of a dialect.
pub(crate) type EventIn<'a, D> = EventOf<NameOf<D>, <D as Dialect>::Answer<'a>, <D as Dialect>::Value<'a>>;

/// Maximum number of queued requests.
pub const QUEUE_LEN: usize = 4;

/// Includes a slot for an acknowledgement, which withdraws a full queue.
const QUEUE_CAPACITY: usize = QUEUE_LEN + 1;

/// Number of times a refresh is sent within the time-out of a request, so that one lost reply does not leave a state
/// outdated.
const REFRESH_REPEATS: u32 = 4;

/// State of the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Link {
    /// No reply; the next attempt begins at `retry_at`, or immediately.
    Down { retry_at: Option<Instant> },
    /// Step `step` of [`Dialect::setup`] is in progress.
    Connecting { step: u8 },
    /// All setup steps are complete. The next refresh is this step, at this time.
    Up { refresh_at: Instant, refresh_step: u8 },
    /// The connection is closing; open requests are reported first.
    Closing { farewell: bool },
    /// The gripper confirmed a farewell: nothing more is sent.
    Ended,
}

/// A command that has begun (E_CMD_PENDING) and whose result is outstanding.
#[derive(Clone, Copy, Debug, Hash)]
struct Running<N> {
    name: N,
    begun: Instant,
    /// For a motion: the time since which the gripper has reported standstill.
    still_since: Option<Instant>,
}

/// Confirmation of the known settings by queries.
#[derive(Clone, Copy, Debug, Hash)]
enum Upkeep {
    /// No setting is known.
    Idle,
    /// The query that confirmed the settings was opened at this time. The next one is due after half of their lifetime.
    Confirmed(Instant),
    /// The next query was opened, too.
    Queried { confirmed: Instant, opened: Instant },
}

/// Maximum number of concurrent commands: one motion, and switching on the supply of each finger.
const RUNNING_LEN: usize = 3;

/// The controller's side of a connection, for any dialect.
#[derive(Clone, Debug, Hash)]
pub struct Engine<D: Dialect> {
    dialect: D,
    timing: Timing<NameOf<D>>,
    link: Link,
    /// Has priority over everything else.
    fast_stop: FastStop,
    /// Has priority over everything but a FAST STOP.
    stop: Transaction<D::Request>,
    /// The request whose first reply is outstanding.
    request: Transaction<D::Request>,
    /// The session's own request: a setup step or the poll of a value.
    refresh: Transaction<D::Request>,
    /// The setting being read back, while `request` is the query, and when that was opened.
    reading_back: Option<(D::Request, Instant)>,
    /// Requests that wait for the current one to be answered.
    queue: Queue<Request<D::Request>, QUEUE_CAPACITY>,
    /// Requests overtaken by a Stop, FAST STOP or Acknowledge.
    overtaken: Overtaken,
    /// A request that was sent more than once, and the time until which another reply may arrive. A request of the same
    /// name could mistake that reply for its own.
    doubled: Option<(NameOf<D>, Instant)>,
    /// The pending report about a Stop.
    stop_report: Option<StopReport>,
    /// An overtaken request whose outcome is unknown.
    dropped: Option<NameOf<D>>,
    running: [Option<Running<NameOf<D>>>; RUNNING_LEN],
    /// A command whose result timed out and may still arrive.
    given_up: Option<NameOf<D>>,
    subscriptions: D::Subscriptions,
    known: D::Known,
    upkeep: Upkeep,
    counters: SessionCounters,
    /// Whether a request that must not be repeated may be answered as late as one that is.
    #[cfg(feature = "std")]
    tolerates_late_answers: bool,
}

/// Requests to be withdrawn because something more urgent overtook them.
#[derive(Clone, Copy, Debug, Default, Hash)]
struct Overtaken {
    /// Whether the current request is withdrawn if it is still unsent.
    request: bool,
    /// Number of requests to withdraw from the front of the queue.
    queued: usize,
}

/// A pending report about a Stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum StopReport {
    /// The reply is late, and the Stop is sent again.
    Late,
    /// There was no reply, and the Stop is not sent again.
    Unanswered,
}

impl<D: Dialect> Engine<D> {
    /// Creates a disconnected session, which begins to connect immediately.
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
            subscriptions,
            known: D::NOTHING,
            upkeep: Upkeep::Idle,
            counters: SessionCounters { unsolicited: 0, refused: 0, repeated: 0, disconnects: 0 },
            #[cfg(feature = "std")]
            tolerates_late_answers: false,
        }
    }

    /// Returns whether the gripper is connected: it replies and all setup steps are complete.
    #[must_use]
    pub const fn is_connected(&self) -> bool {
        matches!(self.link, Link::Up { .. })
    }

    /// Returns the known state of the gripper, which is empty without a connection.
    #[must_use]
    pub const fn known(&self) -> &D::Known {
        &self.known
    }

    /// Returns the motion in progress: it was requested, and its result is outstanding.
    #[must_use]
    pub fn motion(&self) -> Option<NameOf<D>> {
        let running = self.running.iter().flatten().map(|running| running.name);
        running.chain(self.request.name()).find(|name| name.kind() == Kind::Motion)
    }

    /// Returns the counters of unusable input, retries and disconnects.
    #[must_use]
    pub const fn counters(&self) -> SessionCounters {
        self.counters
    }

    /// Chooses when the missing answer to a request that must not be repeated, such as a motion, closes the connection:
    /// after the time-out of one request, or after the time for all attempts of a repeatable one.
    #[cfg(feature = "std")]
    pub(crate) const fn tolerate_late_answers(&mut self, does_tolerate: bool) {
        self.tolerates_late_answers = does_tolerate;
    }

    /// Returns the time-out for each transmission of a request, in milliseconds.
    fn request_timeout(&self, request: &Request<D::Request>) -> u32 {
        let timeout_ms = self.timing.reply_timeout(request.name());
        #[cfg(feature = "std")]
        if self.tolerates_late_answers && !request.is_repeatable() {
            return timeout_ms.saturating_mul(self.timing.attempts.into());
        }
        timeout_ms
    }

    /// Returns whether a request is queued, or its first reply or read-back is outstanding. Ignores Stop and FAST STOP.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.request.is_idle() || !self.queue.is_empty()
    }

    /// Queues a checked request. Its outcome is reported as an [`EventOf`].
    pub(crate) fn enqueue(&mut self, request: Request<D::Request>) -> Result<(), RequestError<D::Invalid>> {
        let name = request.name();
        D::forget_changed(&mut self.known, name);
        if name == D::Request::FAST_STOP.name() {
            // Stays pending until the gripper confirms it, connected or not.
            let stop_failed = self.stop.was_late();
            self.stop.close();
            self.fast_stop.open(stop_failed);
            self.overtake();
            return Ok(());
        }
        let fast_stop_runs = self.fast_stop_pending();
        if name == D::Request::STOP.name() && !fast_stop_runs && self.link != Link::Ended {
            // The gripper may receive although its replies are lost. But the Stop must be sent now or never: over a
            // later connection it would drop the part held then.
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

    /// Marks every unsent request for withdrawal by the next ticks. Sent requests are not repeated.
    fn overtake(&mut self) {
        self.overtaken = Overtaken { request: true, queued: self.queue.len() };
        // A setting in progress is read back nevertheless.
        if self.reading_back.is_none() {
            self.request.forbid_repeat();
            if self.request.is_due_again() {
                self.dropped = self.request.abandon();
            }
        }
    }

    /// Cancels every unsent request without an event, for a caller that no longer exists (a dropped future). A borrowed
    /// request that was already sent is not repeated. Stop and FAST STOP are kept.
    pub fn withdraw(&mut self) {
        self.queue.clear();
        self.overtaken = Overtaken::default();
        if self.reading_back.is_none() && self.request.withdraw_unsent().is_none() {
            self.request.orphan();
        }
    }

    /// Cancels the last polled request without an event if the gripper cannot have received it: none of its bytes was
    /// sent, or the bytes sent do not form a message. Returns whether it was cancelled. A query, Stop or FAST STOP
    /// cannot be cancelled, because it may be sent late.
    pub fn take_back(&mut self, name: NameOf<D>) -> bool {
        name.kind() != Kind::Query && self.request.take_back(name)
    }

    /// Returns whether a polled motion or acknowledgement must no longer be executed: a Stop or FAST STOP is
    /// unanswered, or an Acknowledge was requested later. A transport that still holds part of it must discard that
    /// part and call [`take_back`](Self::take_back).
    ///
    /// A reply does not change the result, because it may be a late reply to an earlier command.
    #[must_use]
    pub fn has_overtaken(&self) -> bool {
        let is_overtaken = |name: NameOf<D>| matches!(name.kind(), Kind::Motion | Kind::Acknowledge);
        self.is_urgent() || self.request.overtaken().is_some_and(is_overtaken)
    }

    /// Returns the subscriptions for modification. Changes are sent to the gripper when nothing else is due.
    pub(crate) const fn subscriptions_mut(&mut self) -> &mut D::Subscriptions {
        &mut self.subscriptions
    }

    /// Returns the current subscriptions.
    pub(crate) const fn subscriptions(&self) -> &D::Subscriptions {
        &self.subscriptions
    }

    /// Closes the connection, for a caller that has lost or reopened it. The next [`tick`](Self::tick)s report the
    /// outcome of open requests, then the session reconnects. An unconfirmed FAST STOP is sent again immediately,
    /// because the first one may be lost.
    pub fn disconnect(&mut self) {
        self.fast_stop.send_again();
        match self.link {
            Link::Up { .. } | Link::Closing { .. } => self.link = Link::Closing { farewell: false },
            Link::Down { .. } | Link::Connecting { .. } | Link::Ended => {
                self.known = D::NOTHING;
                self.refresh.close();
                self.link = Link::Down { retry_at: None };
            }
        }
    }

    /// Counts a message that cannot be decoded.
    pub(crate) const fn count_refused(&mut self) {
        count(&mut self.counters.refused);
    }

    /// Processes a reply or an update.
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
            Routed::ReadBack(setting, opened) => {
                let outcome = D::read_back_answer(&setting, answer, &mut self.known);
                // A queued request may change the setting, and one of two replies may predate it.
                if self.is_urgent() || !self.queue.is_empty() || self.doubled.is_some() {
                    D::forget_settings(&mut self.known);
                }
                if D::name(answer) == D::UPKEEP {
                    self.upkeep = Upkeep::Confirmed(opened);
                }
                Some(EventOf::Answered(outcome))
            }
            Routed::Reported => D::value(answer).map(|value| EventOf::Reported(*value)),
        }
    }

    /// Processes one event that is due at `now`. Call until it returns `None`.
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

    /// Returns the next request to send and counts it as sent. `borrowed` is the name of the request that the caller
    /// provides.
    pub(crate) fn next_to_send(
        &mut self,
        now: Instant,
        borrowed: Option<NameOf<D>>,
    ) -> Option<Outgoing<'_, D::Request>> {
        if matches!(self.link, Link::Closing { .. } | Link::Ended) {
            return None; // Open requests belong to a closed connection, and are still to be reported.
        }
        if !self.fast_stop.is_idle() {
            // Pauses must be silent. Otherwise a gripper that expects the rest of a frame keeps waiting.
            return self.fast_stop.send(now).then_some(Outgoing::FastStop);
        }
        [&mut self.stop, &mut self.request, &mut self.refresh]
            .into_iter()
            .find_map(|transaction| transaction.send(now, borrowed))
    }

    /// Returns the latest time of the next call to [`tick`](Self::tick), if nothing else happens before.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let (attempts, refresh_attempts) = self.attempts();
        let link = match self.link {
            // A pending FAST STOP has priority; its own time-out then applies.
            Link::Down { retry_at } if !self.is_urgent() => retry_at,
            Link::Up { refresh_at, .. } if self.refresh.is_idle() => {
                Some(self.upkeep_at().map_or(refresh_at, |at| at.earlier_of(refresh_at)))
            }
            _ => None,
        };
        let mut next = earlier(link, self.fast_stop.deadline());
        if self.is_connected() {
            next = earlier(next, self.fast_stop_deadline());
        }
        next = earlier(next, self.stop.expires_at(attempts));
        next = earlier(next, self.request.expires_at(attempts));
        next = earlier(next, self.refresh.expires_at(refresh_attempts));
        if !self.queue.is_empty() && self.request.is_idle() {
            next = earlier(next, self.doubled.map(|(_, until)| until));
        }
        for running in self.running.iter().flatten() {
            next = earlier(next, Some(self.result_deadline(running)));
        }
        next
    }

    /// Returns whether a FAST STOP was requested and is not confirmed yet.
    #[must_use]
    pub const fn fast_stop_pending(&self) -> bool {
        !self.fast_stop.is_idle()
    }

    /// Returns whether a Stop or FAST STOP is pending.
    pub(crate) const fn is_urgent(&self) -> bool {
        !self.fast_stop.is_idle() || !self.stop.is_idle()
    }

    /// Returns whether a motion is running or queued. A stopped motion counts until its reply arrives. Further motions
    /// are rejected ([`RequestError::MotionRunning`]).
    #[must_use]
    pub fn motion_is_open(&self) -> bool {
        self.motion().is_some() || self.waits(Kind::Motion)
    }

    /// Returns whether a request of this kind has no reply yet.
    fn waits(&self, kind: Kind) -> bool {
        let is_such = |name: NameOf<D>| name.kind() == kind;
        self.request.name().is_some_and(is_such) || self.queue.iter().any(|request| is_such(request.name()))
    }

    #[inline(never)]
    fn take_expired(&mut self, now: Instant, expired: [Expired; 3]) {
        for expired in expired {
            match expired {
                Expired::No => {}
                // Only requests of the caller can be overtaken.
                Expired::Overtaken => self.dropped = self.request.abandon(),
                Expired::Repeated => count(&mut self.counters.repeated),
                Expired::GivenUp => match self.link {
                    Link::Up { .. } => self.link = Link::Closing { farewell: false },
                    // Another transaction may have timed out at the same moment.
                    Link::Closing { .. } | Link::Ended => {}
                    Link::Down { .. } | Link::Connecting { .. } => {
                        self.link = Link::Down { retry_at: Some(now.plus(self.timing.reconnect_ms)) };
                        self.known = D::NOTHING;
                    }
                },
            }
        }
    }

    /// Repeats or abandons requests whose replies are overdue.
    fn expire_transactions(&mut self, now: Instant) {
        if self.doubled.is_some_and(|(_, until)| now.has_reached(until)) {
            self.doubled = None;
        }
        if !self.fast_stop.is_idle() {
            self.fast_stop.expire(now);
            if self.is_connected() && self.fast_stop_deadline().is_some_and(|at| now.has_reached(at)) {
                self.link = Link::Closing { farewell: false };
            }
        }
        if self.upkeep_at().is_some_and(|at| now.has_reached(at)) {
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
        if matches!(self.link, Link::Down { .. }) {
            self.refresh.close();
        }
    }

    /// Returns how often a request, and how often a refresh, is sent before the connection counts as lost.
    const fn attempts(&self) -> (u8, u8) {
        if self.is_connected() {
            (self.timing.attempts, self.timing.attempts.saturating_mul(REFRESH_REPEATS as u8))
        } else {
            (1, 1)
        }
    }

    /// Returns when the connection counts as lost because a FAST STOP is unconfirmed.
    fn fast_stop_deadline(&self) -> Option<Instant> {
        let unanswered_ms = self.timing.reply_timeout_ms.saturating_mul(self.timing.attempts.into());
        self.fast_stop.begun().map(|begun| begun.plus(unanswered_ms))
    }

    /// Closes the connection. Each call reports one open request, and the last one the disconnect.
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
        let setting = self.reading_back.take().map(|(setting, _)| setting.name());
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

    /// Withdraws one request that a Stop, FAST STOP or Acknowledge has overtaken.
    fn withdraw_overtaken(&mut self) -> Option<NameOf<D>> {
        if !self.overtaken.request && self.overtaken.queued == 0 {
            return None;
        }
        if core::mem::take(&mut self.overtaken.request)
            // A setting in progress is read back nevertheless.
            && self.reading_back.is_none()
            && let Some(unsent) = self.request.withdraw_unsent()
        {
            return Some(unsent);
        }
        self.overtaken.queued = self.overtaken.queued.checked_sub(1)?;
        self.queue.pop_front().map(|request| request.name())
    }

    /// Abandons a running command whose result is overdue.
    fn expire_running(&mut self, now: Instant) -> Option<NameOf<D>> {
        let mut running = self.running.iter().flatten();
        let late = running.find(|running| now.has_reached(self.result_deadline(running)))?.name;
        self.end_running(late);
        self.given_up = Some(late);
        Some(late)
    }

    /// Returns when the result of a running command is overdue.
    fn result_deadline(&self, running: &Running<NameOf<D>>) -> Instant {
        let longest = running.begun.plus(self.timing.result_timeout(running.name));
        let grace = running.still_since.map(|since| since.plus(self.timing.result_grace_ms));
        grace.map_or(longest, |grace| grace.earlier_of(longest))
    }
}

/// Returns the earlier of two times, of which either may be absent.
// Called many times in a row: inlined it takes more flash.
#[inline(never)]
fn earlier(one: Option<Instant>, other: Option<Instant>) -> Option<Instant> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.earlier_of(other)),
        (one, other) => one.or(other),
    }
}

const fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}
