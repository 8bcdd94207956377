//! The common part of both drivers: everything but the transport and the clock.

use super::gate::Gate;
use super::journal::Journal;
use super::link::Protocol;
use super::motion::{Motion, Verdict};
use super::{Config, DriverCounters, Error, StopKind, StopRequest, UPDATES_LEN, Update};
use crate::command::{Command, CommandId, Kind};
use crate::frame::Payload;
use crate::reply::{Reply, Value};
use crate::session::{Event, MISMATCH, Topic};
use crate::time::Instant;
use crate::types::Status;
use heapless::Deque;

/// Maximum wait for bytes. A driver without a deadline still checks once a second.
#[cfg(feature = "embedded-io")]
const LONGEST_WAIT_MS: u32 = 1_000;

/// Number of bytes per read.
pub(super) const CHUNK_LEN: usize = 64;
/// Number of reads before the driver checks the clock again, so that continuous input cannot suppress time-outs.
pub(super) const MAX_CHUNKS: usize = 64;

/// The condition that a method waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Goal {
    /// The gripper is connected.
    Connected,
    /// No request is open, such as one of a cancelled call.
    Free,
    /// The awaited request is answered or has failed.
    Answered,
    /// The motion has begun or has failed to begin.
    MotionDecided,
    /// The motion has ended.
    MotionOver,
    /// An update is available.
    Update,
    /// Every Stop and FAST STOP is confirmed or abandoned.
    NothingUrgent,
    /// Every Stop and FAST STOP is confirmed or abandoned, and no motion is running.
    Stopped,
}

/// A request whose outcome a method awaits.
pub(super) struct Awaited<'p> {
    id: Option<CommandId>,
    /// The command, if the caller keeps it because it borrows its payload.
    borrowed: Option<Command<'p>>,
    verdict: Option<Verdict>,
    look: Option<&'p mut (dyn FnMut(&Reply<'_>) + Send)>,
}

impl<'p> Awaited<'p> {
    pub(super) fn answer(
        id: CommandId,
        borrowed: Option<Command<'p>>,
        look: &'p mut (dyn FnMut(&Reply<'_>) + Send),
    ) -> Self {
        Self { id: Some(id), borrowed, verdict: None, look: Some(look) }
    }

    /// For methods that wait for something other than a reply.
    pub(super) const fn nothing() -> Self {
        Self { id: None, borrowed: None, verdict: None, look: None }
    }

    fn note(&mut self, event: &Event<'_>) {
        let Some(id) = self.id else { return };
        if self.verdict.is_some() {
            return;
        }
        self.verdict = Verdict::of(event, id);
        if self.verdict.is_some()
            && let Event::Answered(reply) = event
            && let Some(look) = &mut self.look
        {
            look(reply);
        }
    }

    /// Returns the outcome of the request.
    pub(super) fn result<E>(&self) -> Result<(), Error<E>> {
        match self.verdict {
            Some(Verdict::Answered(Status::Success)) => Ok(()),
            // Reserved for read-backs: no gripper answers a setting with it.
            Some(Verdict::Answered(MISMATCH)) if self.id.is_some_and(|id| id.kind() == Kind::Setting) => {
                Err(Error::Mismatch)
            }
            Some(Verdict::Answered(status)) => Err(Error::Refused(status)),
            Some(Verdict::Withdrawn) => Err(Error::NotConnected),
            Some(Verdict::Unanswered) | None => Err(Error::Unanswered),
        }
    }
}

/// The protocol, the progress of the current message, and the state of motion and updates.
#[derive(Debug)]
pub(super) struct DriverState<P> {
    link: P,
    received_at: Instant,
    outbox: Outbox,
    gate: Gate,
    reports: Reports,
    config: Config,
}

impl<P: Protocol> DriverState<P> {
    pub(super) const fn new(link: P, config: Config) -> Self {
        Self {
            link,
            received_at: Instant::from_millis(0),
            outbox: Outbox::EMPTY,
            gate: Gate::OPEN,
            reports: Reports {
                journal: Journal::NEW,
                motion: Motion::none(),
                updates: Deque::new(),
                updates_lost: 0,
                began_at: None,
                reported_at: [Instant::from_millis(0); Topic::ALL.len()],
            },
            config,
        }
    }

    pub(super) const fn link(&self) -> &P {
        &self.link
    }

    pub(super) const fn link_mut(&mut self) -> &mut P {
        &mut self.link
    }

    pub(super) const fn motion(&self) -> &Motion {
        &self.reports.motion
    }

    pub(super) const fn journal(&self) -> &Journal {
        &self.reports.journal
    }

    #[cfg(feature = "log")]
    pub(super) const fn journal_mut(&mut self) -> &mut Journal {
        &mut self.reports.journal
    }

    pub(super) const fn config(&self) -> &Config {
        &self.config
    }

    pub(super) fn counters(&self) -> DriverCounters {
        DriverCounters {
            line: self.link.line_counters(),
            session: self.link.session_counters(),
            updates_lost: self.reports.updates_lost,
        }
    }

    pub(super) fn has_update(&self) -> bool {
        !self.reports.updates.is_empty()
    }

    pub(super) fn take_update(&mut self) -> Option<Update> {
        self.reports.updates.pop_front()
    }

    /// Returns the time since the last report of a known value, in milliseconds. It is right for 49 days.
    pub(super) fn age_ms(&self, now: Instant, topic: Topic) -> Option<u32> {
        let known = self.link.known();
        let is_known = match topic {
            Topic::SystemState => known.flags.is_some(),
            Topic::GripperState => known.state.is_some(),
            Topic::Width => known.width.is_some(),
            Topic::Speed => known.speed.is_some(),
            Topic::Force => known.force.is_some(),
        };
        let reported_at = self.reports.reported_at.get(topic as usize).filter(|_| is_known)?;
        Some(now.as_millis().wrapping_sub(reported_at.as_millis()))
    }

    /// Withdraws the unsent requests of a dropped call.
    pub(super) fn clear_up(&mut self) {
        self.link.withdraw();
        if self.outbox.is_untouched() && self.link.take_back() {
            self.outbox = Outbox::EMPTY;
        }
    }

    /// Takes over the request of a stop handle. Withdraws unsent requests, and awaits the stop as if the caller had
    /// requested it.
    pub(super) fn take_stop(&mut self, now: Instant) -> Option<StopKind> {
        let StopRequest { kind, is_sent } = self.gate.take()?;
        self.clear_up();
        let is_new = !self.link.is_urgent();
        let is_taken = self.link.request::<()>(kind.command(), None).is_ok();
        if is_taken && is_new && is_sent && self.outbox.is_empty() {
            // The handle's message replaces the session's next one, which is the stop and would otherwise be sent
            // again.
            let _ = self.link.encode_next(now, None);
        }
        Some(kind)
    }

    pub(super) const fn gate(&self) -> &Gate {
        &self.gate
    }

    /// Creates a handle that stops the gripper from another thread. `line` opens the line for the first handle.
    #[cfg(feature = "std")]
    pub(super) fn stop_handle(
        &mut self,
        line: impl FnOnce() -> std::io::Result<super::StopLine>,
    ) -> std::io::Result<super::StopHandle> {
        let shared = match self.gate.shared.take() {
            Some(shared) => shared,
            None => {
                let is_mid_message = !self.outbox.is_empty() && !self.outbox.is_untouched();
                std::sync::Arc::new(super::stop::Shared::new::<P>(
                    line()?,
                    is_mid_message,
                    self.journal().clone(),
                ))
            }
        };
        Ok(self.gate.shared.insert(shared).handle())
    }

    /// Detaches all handles, because the line has been replaced.
    pub(super) fn change_line(&mut self) {
        self.gate = Gate::OPEN;
    }

    /// Checks a command before any part of it is sent. `width` is the current opening width, for a relative motion.
    pub(super) fn check<E>(&self, command: &Command<'_>, width: Option<f32>) -> Result<(), Error<E>> {
        command.check()?;
        let flags = self.link.known().flags.unwrap_or_default();
        Ok(command.check_limits(&self.link.limits(), flags, width)?)
    }

    /// Returns whether the limits permit this force in overdrive mode only.
    pub(super) fn requires_overdrive(&self, force: f32) -> bool {
        let limits = self.link.known().limits;
        limits.is_some_and(|limits| limits.nominal_force < force && force <= limits.overdrive_force)
    }

    /// Returns whether a motion can begin: none is running, and no FAST STOP is unconfirmed.
    pub(super) fn may_begin<E>(&self) -> Result<(), Error<E>> {
        if self.link.fast_stop_pending() {
            return Err(Error::FastStopRunning);
        }
        if self.link.motion().is_some() { Err(Error::MotionRunning) } else { Ok(()) }
    }

    /// Requests a motion. `width` is the current opening width if the protocol needs it.
    pub(super) fn request_motion<E>(
        &mut self,
        command: Command<'static>,
        width: Option<f32>,
    ) -> Result<(), Error<E>> {
        self.link.request(command, width)?;
        self.reports.motion.ask(command.id());
        Ok(())
    }

    /// Processes the result of a read into `chunk`.
    pub(super) fn receive<E>(
        &mut self,
        now: Instant,
        read: Result<usize, E>,
        chunk: &[u8],
        awaited: &mut Awaited<'_>,
    ) -> Result<(), Error<E>> {
        let count = read.map_err(Error::Transport)?;
        if count == 0 {
            self.hang_up(now, awaited);
            return Err(Error::Closed);
        }
        let is_after_silence = now.since(self.received_at) > self.config.session.reply_timeout_ms;
        if is_after_silence || self.reports.began_at.is_none() {
            self.reports.began_at = Some(now);
        }
        self.received_at = now;
        let Self { link, reports, .. } = self;
        let bytes = chunk.get(..count).unwrap_or(&[]);
        link.receive(now, bytes, &mut |event| reports.note(now, awaited, event));
        Ok(())
    }

    /// Processes elapsed time: time-outs and due events.
    pub(super) fn elapse(&mut self, now: Instant, awaited: &mut Awaited<'_>) {
        let Self { link, reports, outbox, config, .. } = self;
        if link.is_mid_message() && now.since(self.received_at) >= config.half_frame_ms {
            link.give_up_half(now, &mut |event| reports.note(now, awaited, event));
        }
        while let Some(event) = link.tick(now) {
            if event == Event::Disconnected && !link.outlives_connection() {
                // Unsent bytes must not be sent when the line recovers. The exception is the rest of a query or a FAST
                // STOP, for which the gripper would otherwise take the next message.
                *outbox = Outbox::EMPTY;
            }
            reports.note(now, awaited, &event);
        }
    }

    /// Encodes the next message if the last one is complete. Returns whether there are bytes to send.
    pub(super) fn fetch(&mut self, now: Instant, awaited: &Awaited<'_>) -> bool {
        if self.outbox.is_empty()
            && let Some(len) = self.link.encode_next(now, awaited.borrowed)
        {
            self.outbox = Outbox { len, ..Outbox::EMPTY };
        }
        !self.outbox.is_empty()
    }

    /// Returns the unsent rest of the message.
    pub(super) fn rest(&self) -> &[u8] {
        self.link.encoded().get(self.outbox.sent..self.outbox.len).unwrap_or(&[])
    }

    /// Returns whether the message is complete and the transport needs a flush.
    pub(super) const fn needs_flush(&self) -> bool {
        self.outbox.needs_flush
    }

    /// Processes the result of writing the rest.
    pub(super) fn written<E>(
        &mut self,
        written: Result<usize, E>,
        now: impl FnOnce() -> Instant,
        awaited: &mut Awaited<'_>,
    ) -> Result<(), Error<E>> {
        match written {
            Ok(0) => {
                self.hang_up(now(), awaited);
                return Err(Error::Closed);
            }
            Ok(count) => self.outbox.sent(count),
            Err(error) => {
                self.outbox = Outbox::EMPTY;
                return Err(Error::Transport(error));
            }
        }
        Ok(())
    }

    /// Processes the result of a flush.
    pub(super) fn flushed<E>(&mut self, flushed: Result<(), E>) -> Result<(), Error<E>> {
        self.outbox.needs_flush = false;
        flushed.map_err(|error| {
            self.outbox = Outbox::EMPTY;
            Error::Transport(error)
        })
    }

    /// Handles the loss of the line.
    pub(super) fn hang_up(&mut self, now: Instant, awaited: &mut Awaited<'_>) {
        self.link.hang_up();
        self.outbox = Outbox::EMPTY;
        self.elapse(now, awaited);
    }

    pub(super) fn has_reached(&self, goal: Goal, awaited: &Awaited<'_>) -> bool {
        match goal {
            Goal::Connected => self.link.is_connected(),
            Goal::Free => !self.link.is_busy(),
            Goal::Answered => awaited.verdict.is_some(),
            Goal::MotionDecided => self.reports.motion.is_decided(),
            Goal::MotionOver => self.reports.motion.is_over(),
            Goal::Update => self.has_update(),
            Goal::NothingUrgent => !self.link.is_urgent(),
            Goal::Stopped => !self.link.is_urgent() && self.link.motion().is_none(),
        }
    }

    /// Returns the next deadline without received bytes: `until`, or an earlier one of the protocol.
    pub(super) fn next_due(&self, until: Option<Instant>) -> Option<Instant> {
        let half = self.link.is_mid_message().then(|| self.received_at.plus(self.config.half_frame_ms));
        [until, self.link.poll_timeout(), half].into_iter().flatten().reduce(Instant::earlier_of)
    }

    /// Returns the milliseconds until the next deadline without received bytes.
    #[cfg(feature = "embedded-io")]
    pub(super) fn idle_ms(&self, now: Instant, until: Option<Instant>) -> u32 {
        self.next_due(until).map_or(LONGEST_WAIT_MS, |due| due.since(now).min(LONGEST_WAIT_MS))
    }
}

/// What the gripper has reported.
#[derive(Debug)]
struct Reports {
    journal: Journal,
    motion: Motion,
    updates: Deque<Update, UPDATES_LEN>,
    updates_lost: u16,
    /// The time of the first byte after the last silence that was too long for an answer. All values that were reported while
    /// the connection was established are younger.
    began_at: Option<Instant>,
    /// The time of the last report of each topic.
    reported_at: [Instant; Topic::ALL.len()],
}

impl Reports {
    fn note(&mut self, now: Instant, awaited: &mut Awaited<'_>, event: &Event<'_>) {
        self.motion.note(event);
        awaited.note(event);
        self.journal.note(event);
        match event {
            Event::Connected => self.reported_at = [self.began_at.unwrap_or(now); Topic::ALL.len()],
            Event::Disconnected => {
                // An update from before the loss would look like a current one.
                let lost = u16::try_from(self.updates.len()).unwrap_or(u16::MAX);
                self.updates_lost = self.updates_lost.saturating_add(lost);
                self.updates.clear();
            }
            Event::Answered(reply) => self.note_time(now, reply.value_ref()),
            Event::Reported(value) => {
                self.note_time(now, Some(value));
                if let Some(update) = Update::of(value) {
                    self.queue(update);
                }
            }
            _ => {}
        }
    }

    fn note_time(&mut self, now: Instant, value: Option<&Value<'_>>) {
        if let Some(topic) = value.and_then(|value| Topic::of(value.id()))
            && let Some(reported_at) = self.reported_at.get_mut(topic as usize)
        {
            *reported_at = now;
        }
    }

    fn queue(&mut self, update: Update) {
        if self.updates.is_full() {
            self.updates.pop_front();
            self.updates_lost = self.updates_lost.saturating_add(1);
        }
        // The queue has room: the oldest update was removed.
        let _ = self.updates.push_back(update);
    }
}

/// The bytes after the status code of a reply, copied to the caller's buffer.
pub(super) struct Copied<'b> {
    buffer: &'b mut [u8],
    len: usize,
}

impl<'b> Copied<'b> {
    pub(super) const fn new(buffer: &'b mut [u8]) -> Self {
        Self { buffer, len: 0 }
    }

    pub(super) fn take(&mut self, reply: &Reply<'_>) {
        self.len = reply.len().saturating_sub(STATUS_LEN);
        for (at, slot) in self.buffer.iter_mut().take(self.len).enumerate() {
            *slot = reply.byte(at.saturating_add(STATUS_LEN));
        }
    }

    pub(super) fn finish<E>(self) -> Result<&'b [u8], Error<E>> {
        let needed = self.len;
        let buffer: &'b [u8] = self.buffer;
        buffer.get(..needed).ok_or(Error::TooLong { needed })
    }
}

/// Length of the status code in bytes.
const STATUS_LEN: usize = 2;

/// The progress of the current message.
#[derive(Debug)]
struct Outbox {
    len: usize,
    sent: usize,
    /// Whether the message is complete and may still be in the transport's buffer.
    needs_flush: bool,
}

impl Outbox {
    /// Nothing to send. A gripper cannot use the rest of an interrupted message, and the session notices the missing
    /// reply.
    const EMPTY: Self = Self { len: 0, sent: 0, needs_flush: false };

    /// Records that `count` more bytes were sent.
    const fn sent(&mut self, count: usize) {
        self.sent = self.sent.saturating_add(count);
        self.needs_flush = self.sent >= self.len;
    }

    const fn is_empty(&self) -> bool {
        self.sent >= self.len && !self.needs_flush
    }

    const fn is_untouched(&self) -> bool {
        self.sent == 0 && self.len > 0
    }
}
