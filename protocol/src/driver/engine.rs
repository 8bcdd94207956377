//! What both drivers share: everything but bytes and time.

use super::gate::Gate;
use super::link::Protocol;
use super::motion::{Motion, Verdict};
use super::{Config, DriverCounters, Error, StopKind, StopRequest, UPDATES_LEN, Update};
use crate::command::{Command, CommandId, Kind};
use crate::frame::Payload;
use crate::reply::Reply;
use crate::session::{Event, MISMATCH};
use crate::time::Instant;
use crate::types::Status;
use heapless::Deque;

/// The longest wait for bytes: a program that waits for nothing in particular still looks once a second.
#[cfg(feature = "embedded-io")]
const LONGEST_WAIT_MS: u32 = 1_000;

/// Bytes read at a time.
pub(super) const CHUNK_LEN: usize = 64;
/// Chunks read before the driver looks at the clock again, so that endless input cannot stop time.
pub(super) const MAX_CHUNKS: usize = 64;

/// What a method waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Goal {
    /// The gripper answers.
    Connected,
    /// No request is open: that of a call that was given up may be.
    Free,
    /// The awaited request is answered, or will not be.
    Answered,
    /// The motion has begun, or has not.
    MotionDecided,
    /// The motion is over.
    MotionOver,
    /// An update is there.
    Update,
    /// Every Stop and FAST STOP is confirmed, or given up.
    NothingUrgent,
    /// The same, and no motion runs.
    Stopped,
}

/// A request whose outcome a method waits for.
pub(super) struct Awaited<'p> {
    id: Option<CommandId>,
    /// The command, if it borrows its payload.
    borrowed: Option<Command<'p>>,
    verdict: Option<Verdict>,
    /// Looks at the answer.
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

    /// For methods that wait for something else.
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

    /// The outcome of the request.
    pub(super) fn result<E>(&self) -> Result<(), Error<E>> {
        match self.verdict {
            Some(Verdict::Answered(Status::Success)) => Ok(()),
            // No gripper answers a setting with it.
            Some(Verdict::Answered(MISMATCH)) if self.id.is_some_and(|id| id.kind() == Kind::Setting) => {
                Err(Error::Mismatch)
            }
            Some(Verdict::Answered(status)) => Err(Error::Refused(status)),
            Some(Verdict::Withdrawn) => Err(Error::NotConnected),
            Some(Verdict::Unanswered) | None => Err(Error::Unanswered),
        }
    }
}

/// The protocol, how far its message has left, and what became of motion and updates.
#[derive(Debug)]
pub(super) struct Engine<P> {
    link: P,
    received_at: Instant,
    outbox: Outbox,
    gate: Gate,
    motion: Motion,
    updates: Deque<Update, UPDATES_LEN>,
    updates_lost: u16,
    config: Config,
}

impl<P: Protocol> Engine<P> {
    pub(super) const fn new(link: P, config: Config) -> Self {
        Self {
            link,
            received_at: Instant::from_millis(0),
            outbox: Outbox::EMPTY,
            gate: Gate::OPEN,
            motion: Motion::none(),
            updates: Deque::new(),
            updates_lost: 0,
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
        &self.motion
    }

    pub(super) const fn config(&self) -> &Config {
        &self.config
    }

    pub(super) fn counters(&self) -> DriverCounters {
        DriverCounters {
            line: self.link.line_counters(),
            session: self.link.session_counters(),
            updates_lost: self.updates_lost,
        }
    }

    pub(super) fn has_update(&self) -> bool {
        !self.updates.is_empty()
    }

    pub(super) fn take_update(&mut self) -> Option<Update> {
        self.updates.pop_front()
    }

    /// Cancels what a dropped call has requested and what was not sent yet.
    pub(super) fn clear_up(&mut self) {
        self.link.withdraw();
        if self.outbox.is_untouched() && self.link.take_back() {
            self.outbox = Outbox::EMPTY;
        }
    }

    /// Takes over what a stop handle has requested: what was not sent is withdrawn, and the stop is awaited as one that the
    /// caller has requested.
    pub(super) fn take_stop(&mut self, now: Instant) -> Option<StopKind> {
        let StopRequest { kind, is_sent } = self.gate.take()?;
        self.clear_up();
        let is_new = !self.link.is_urgent();
        let is_taken = self.link.request::<()>(kind.command(), None).is_ok();
        if is_taken && is_new && is_sent && self.outbox.is_empty() {
            // The handle's message counts as the session's, which would send another one: it is the next, before all others.
            let _ = self.link.encode_next(now, None);
        }
        Some(kind)
    }

    pub(super) const fn gate(&self) -> &Gate {
        &self.gate
    }

    /// A handle that stops the gripper from another thread; `line` opens the way if there is none yet.
    #[cfg(feature = "std")]
    pub(super) fn stop_handle(
        &mut self,
        line: impl FnOnce() -> std::io::Result<super::StopLine>,
    ) -> std::io::Result<super::StopHandle> {
        let shared = match self.gate.shared.take() {
            Some(shared) => shared,
            None => {
                let is_mid_message = !self.outbox.is_empty() && !self.outbox.is_untouched();
                std::sync::Arc::new(super::stop::Shared::new::<P>(line()?, is_mid_message))
            }
        };
        Ok(self.gate.shared.insert(shared).handle())
    }

    /// The line is another one, which no handle knows.
    pub(super) fn change_line(&mut self) {
        self.gate = Gate::OPEN;
    }

    /// Asks for a motion; `width` is the current one if the protocol wants it.
    pub(super) fn request_motion<E>(
        &mut self,
        command: Command<'static>,
        width: Option<f32>,
    ) -> Result<(), Error<E>> {
        self.link.request(command, width)?;
        self.motion.ask(command.id());
        Ok(())
    }

    /// Takes the result of a read into `chunk`.
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
        self.received_at = now;
        let Self { link, motion, updates, updates_lost, .. } = self;
        let bytes = chunk.get(..count).unwrap_or(&[]);
        link.receive(now, bytes, &mut |event| note(motion, updates, updates_lost, awaited, event));
        Ok(())
    }

    /// Lets time pass.
    pub(super) fn elapse(&mut self, now: Instant, awaited: &mut Awaited<'_>) {
        let Self { link, motion, updates, updates_lost, outbox, config, .. } = self;
        if link.is_mid_message() && now.since(self.received_at) >= config.half_frame_ms {
            link.give_up_half(now, &mut |event| note(motion, updates, updates_lost, awaited, event));
        }
        while let Some(event) = link.tick(now) {
            if event == Event::Disconnected {
                // What has not left by now must not leave when the line takes bytes again. The gripper skips half a message.
                *outbox = Outbox::EMPTY;
            }
            note(motion, updates, updates_lost, awaited, &event);
        }
    }

    /// Fetches the next message to send, if the last one has left; whether there is something to send.
    pub(super) fn fetch(&mut self, now: Instant, awaited: &Awaited<'_>) -> bool {
        if self.outbox.is_empty()
            && let Some(len) = self.link.encode_next(now, awaited.borrowed)
        {
            self.outbox = Outbox { len, ..Outbox::EMPTY };
        }
        !self.outbox.is_empty()
    }

    /// Whether nothing of the message has left.
    pub(super) const fn is_at_begin(&self) -> bool {
        self.outbox.is_untouched()
    }

    /// What is left of the message.
    pub(super) fn rest(&self) -> &[u8] {
        self.link.encoded().get(self.outbox.sent..self.outbox.len).unwrap_or(&[])
    }

    /// Whether the message is written and the transport is to be flushed.
    pub(super) const fn needs_flush(&self) -> bool {
        self.outbox.needs_flush
    }

    /// Takes the result of a write of the rest.
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

    /// Takes the result of a flush.
    pub(super) fn flushed<E>(&mut self, flushed: Result<(), E>) -> Result<(), Error<E>> {
        self.outbox.needs_flush = false;
        flushed.map_err(|error| {
            self.outbox = Outbox::EMPTY;
            Error::Transport(error)
        })
    }

    /// The line is gone.
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
            Goal::MotionDecided => self.motion.is_decided(),
            Goal::MotionOver => self.motion.is_over(),
            Goal::Update => self.has_update(),
            Goal::NothingUrgent => !self.link.is_urgent(),
            Goal::Stopped => !self.link.is_urgent() && self.link.motion().is_none(),
        }
    }

    /// When something is due even if no byte comes: `until`, or a step of the protocol before it.
    pub(super) fn next_due(&self, until: Option<Instant>) -> Option<Instant> {
        let half = self.link.is_mid_message().then(|| self.received_at.plus(self.config.half_frame_ms));
        [until, self.link.poll_timeout(), half].into_iter().flatten().reduce(Instant::earlier_of)
    }

    /// For how many milliseconds nothing is due if no byte comes.
    #[cfg(feature = "embedded-io")]
    pub(super) fn idle_ms(&self, now: Instant, until: Option<Instant>) -> u32 {
        self.next_due(until).map_or(LONGEST_WAIT_MS, |due| due.since(now).min(LONGEST_WAIT_MS))
    }
}

fn note(
    motion: &mut Motion,
    updates: &mut Deque<Update, UPDATES_LEN>,
    updates_lost: &mut u16,
    awaited: &mut Awaited<'_>,
    event: &Event<'_>,
) {
    motion.note(event);
    awaited.note(event);
    if let Event::Reported(value) = event
        && let Some(update) = Update::of(value)
    {
        if updates.is_full() {
            updates.pop_front();
            *updates_lost = updates_lost.saturating_add(1);
        }
        // There is room now.
        let _ = updates.push_back(update);
    }
}

/// What follows the status code of an answer, copied to the caller's buffer.
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

/// Bytes of the status code.
const STATUS_LEN: usize = 2;

/// How far the message that was encoded last has left.
#[derive(Debug)]
struct Outbox {
    len: usize,
    sent: usize,
    /// All of it is written, and the transport may still hold it back.
    needs_flush: bool,
}

impl Outbox {
    /// Nothing is to be sent. The rest of a message that was cut off makes no sense to a gripper; the session misses the
    /// answer.
    const EMPTY: Self = Self { len: 0, sent: 0, needs_flush: false };

    /// So many bytes have left.
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
