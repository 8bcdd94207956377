//! What both drivers share: everything but bytes and time.

use super::motion::{Motion, Verdict};
use super::{Config, Counters, Error, UPDATES_LEN, Update};
use crate::command::{Command, CommandId, Kind};
use crate::frame::{Event, FrameEncoder, FrameParser, OVERHEAD, Payload};
use crate::reply::Reply;
use crate::session::{MISMATCH, Notice, Session};
use crate::time::Instant;
use crate::types::Status;
use heapless::Deque;

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
}

/// A request whose outcome a method waits for.
pub(super) struct Awaited<'p> {
    id: Option<CommandId>,
    /// The command, if it borrows its payload.
    lent: Option<Command<'p>>,
    verdict: Option<Verdict>,
    /// Looks at the answer.
    look: &'p mut (dyn FnMut(&Reply<'_>) + Send),
}

impl<'p> Awaited<'p> {
    pub(super) fn answer(
        id: CommandId,
        lent: Option<Command<'p>>,
        look: &'p mut (dyn FnMut(&Reply<'_>) + Send),
    ) -> Self {
        Self { id: Some(id), lent, verdict: None, look }
    }

    /// For methods that wait for something else.
    pub(super) fn nothing(look: &'p mut (dyn FnMut(&Reply<'_>) + Send)) -> Self {
        Self { id: None, lent: None, verdict: None, look }
    }

    fn note(&mut self, notice: &Notice<'_>) {
        let Some(id) = self.id else { return };
        if self.verdict.is_some() {
            return;
        }
        self.verdict = Verdict::of(notice, id);
        if self.verdict.is_some()
            && let Notice::Answered(reply) = notice
        {
            (self.look)(reply);
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

/// The session, its parser, and the frame being sent.
#[derive(Debug)]
pub(super) struct Engine<const RX: usize, const TX: usize> {
    session: Session,
    parser: FrameParser<RX>,
    received_at: Instant,
    outbox: Outbox<TX>,
    motion: Motion,
    updates: Deque<Update, UPDATES_LEN>,
    updates_lost: u16,
    config: Config,
}

impl<const RX: usize, const TX: usize> Engine<RX, TX> {
    pub(super) const fn new(config: Config) -> Self {
        const {
            assert!(RX >= 34, "the session asks for the limits, 32 bytes behind a status");
            assert!(TX >= OVERHEAD + Command::MAX_FIXED_LEN, "every command of fixed length fits");
        }
        Self {
            session: Session::new(config.session),
            parser: FrameParser::new(),
            received_at: Instant::from_millis(0),
            outbox: Outbox::new(),
            motion: Motion::none(),
            updates: Deque::new(),
            updates_lost: 0,
            config,
        }
    }

    pub(super) const fn session(&self) -> &Session {
        &self.session
    }

    pub(super) const fn session_mut(&mut self) -> &mut Session {
        &mut self.session
    }

    pub(super) const fn motion(&self) -> &Motion {
        &self.motion
    }

    pub(super) const fn config(&self) -> &Config {
        &self.config
    }

    pub(super) const fn counters(&self) -> Counters {
        Counters {
            line: self.parser.counters(),
            session: self.session.counters(),
            updates_lost: self.updates_lost,
        }
    }

    pub(super) fn take_update(&mut self) -> Option<Update> {
        self.updates.pop_front()
    }

    /// Takes back what a call that was given up has left behind, as far as it did not leave.
    pub(super) fn clear_up(&mut self) {
        self.session.withdraw();
        if self.outbox.is_untouched() && self.session.take_back(self.outbox.id) {
            self.outbox.clear();
        }
        if !self.session.is_busy() {
            self.motion.withdraw();
        }
    }

    /// Asks for a command of fixed length.
    pub(super) fn request<E>(&mut self, command: Command<'static>) -> Result<(), Error<E>> {
        Ok(self.session.request(command)?)
    }

    /// Asks for a command that borrows its payload.
    pub(super) fn request_lent<E>(&mut self, command: &Command<'_>) -> Result<(), Error<E>> {
        let needed = command.len().saturating_add(OVERHEAD);
        if needed > TX {
            return Err(Error::TooLong { needed });
        }
        Ok(self.session.request_lent(command)?)
    }

    /// Asks for a motion.
    pub(super) fn request_motion<E>(&mut self, command: Command<'static>) -> Result<(), Error<E>> {
        self.session.request(command)?;
        self.motion.ask(command.id());
        Ok(())
    }

    /// Takes bytes from the line.
    pub(super) fn receive(&mut self, now: Instant, bytes: &[u8], awaited: &mut Awaited<'_>) {
        self.received_at = now;
        let Self { session, parser, motion, updates, updates_lost, .. } = self;
        let mut rest = bytes;
        loop {
            let (taken, event) = parser.push_slice(rest);
            rest = rest.get(taken..).unwrap_or(&[]);
            let Some(event) = event else { return };
            take(session, now, &event, |notice| note(motion, updates, updates_lost, awaited, notice));
        }
    }

    /// Lets time pass.
    pub(super) fn elapse(&mut self, now: Instant, awaited: &mut Awaited<'_>) {
        let Self { session, parser, motion, updates, updates_lost, outbox, config, .. } = self;
        if parser.is_mid_frame() && now.since(self.received_at) >= config.half_frame_ms {
            while let Some(event) = parser.expire() {
                take(session, now, &event, |notice| note(motion, updates, updates_lost, awaited, notice));
            }
        }
        while let Some(notice) = session.tick(now) {
            if notice == Notice::Disconnected && outbox.is_untouched() {
                outbox.clear();
            }
            note(motion, updates, updates_lost, awaited, &notice);
        }
    }

    /// Fetches the next frame to send, if the last one has left; whether there is something to send.
    pub(super) fn fetch(&mut self, now: Instant, awaited: &Awaited<'_>) -> bool {
        if self.outbox.is_empty()
            && let Some(command) = self.session.poll_transmit_lent(now, awaited.lent)
        {
            self.outbox.put(command);
        }
        !self.outbox.is_empty()
    }

    pub(super) const fn outbox(&mut self) -> &mut Outbox<TX> {
        &mut self.outbox
    }

    /// The line is gone.
    pub(super) fn hang_up(&mut self, now: Instant, awaited: &mut Awaited<'_>) {
        self.session.disconnect();
        self.parser.reset();
        self.outbox.clear();
        self.elapse(now, awaited);
    }

    pub(super) fn has_reached(&self, goal: Goal, awaited: &Awaited<'_>) -> bool {
        match goal {
            Goal::Connected => self.session.is_connected(),
            Goal::Free => !self.session.is_busy(),
            Goal::Answered => awaited.verdict.is_some(),
            Goal::MotionDecided => self.motion.is_decided(),
            Goal::MotionOver => self.motion.is_over(),
            Goal::Update => !self.updates.is_empty(),
        }
    }

    /// When something is due even if no byte comes.
    #[cfg(feature = "embedded-io-async")]
    pub(super) fn next_timeout(&self) -> Option<Instant> {
        let half_frame = self.parser.is_mid_frame().then(|| self.received_at.plus(self.config.half_frame_ms));
        [self.session.poll_timeout(), half_frame].into_iter().flatten().reduce(Instant::earlier_of)
    }
}

fn take(session: &mut Session, now: Instant, event: &Event<'_>, mut note: impl FnMut(&Notice<'_>)) {
    if let Some(notice) = session.handle(now, event) {
        note(&notice);
    }
}

fn note(
    motion: &mut Motion,
    updates: &mut Deque<Update, UPDATES_LEN>,
    updates_lost: &mut u16,
    awaited: &mut Awaited<'_>,
    notice: &Notice<'_>,
) {
    motion.note(notice);
    awaited.note(notice);
    if let Notice::Reported(value) = notice
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

/// The frame being sent.
#[derive(Debug)]
pub(super) struct Outbox<const TX: usize> {
    bytes: [u8; TX],
    len: usize,
    sent: usize,
    id: CommandId,
    /// All of it is written, and the transport may still hold it back.
    needs_flush: bool,
}

impl<const TX: usize> Outbox<TX> {
    const fn new() -> Self {
        Self { bytes: [0; TX], len: 0, sent: 0, id: CommandId::Unknown(0), needs_flush: false }
    }

    fn put(&mut self, command: Command<'_>) {
        self.id = command.id();
        self.sent = 0;
        // It fits: what is lent was checked, and there is room for all others.
        self.len = FrameEncoder::new(self.id.code(), command).write_into(&mut self.bytes).unwrap_or(0);
    }

    /// What is left of the frame.
    pub(super) fn rest(&self) -> &[u8] {
        self.bytes.get(self.sent..self.len).unwrap_or(&[])
    }

    /// So many bytes have left.
    pub(super) fn sent(&mut self, count: usize) {
        self.sent = self.sent.saturating_add(count);
        self.needs_flush = self.rest().is_empty();
    }

    pub(super) const fn needs_flush(&self) -> bool {
        self.needs_flush
    }

    pub(super) const fn flushed(&mut self) {
        self.needs_flush = false;
    }

    /// The rest of a frame that was cut off makes no sense to a gripper; the session misses the answer.
    pub(super) const fn clear(&mut self) {
        self.len = 0;
        self.sent = 0;
        self.needs_flush = false;
    }

    fn is_empty(&self) -> bool {
        self.rest().is_empty() && !self.needs_flush
    }

    fn is_untouched(&self) -> bool {
        self.sent == 0 && !self.rest().is_empty()
    }
}
