//! A client of the binary protocol: its frames and its subscriptions. The commands are in `device`.

use crate::config::Config;
use crate::deframer::Deframer;
use crate::device::Device;
use crate::port::{Completion, FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind, Request};
use crate::time::{Time, earlier};
use crate::updates::{Readings, Silence, Subscriptions};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{AutoUpdate, Command, CommandId, Event, Frame, FrameEncoder, Payload, Reply, Status};

/// Capacity of the output queue in bytes.
const QUEUE_LEN: usize = 2_048;
/// Space in the queue that updates leave free for answers.
const RESERVED_FOR_REPLIES: usize = 512;
/// Offset of the size field in a frame.
const SIZE_AT: usize = 4;

const _: () = assert!(QUEUE_LEN >= RESERVED_FOR_REPLIES + MAX_FRAME_LEN);

/// A client: its frame decoder and its line.
#[derive(Clone, Debug)]
pub(crate) struct BinaryClient {
    deframer: Deframer,
    line: BinarySession,
}

/// The state of a client apart from its frame decoder.
#[derive(Clone, Debug)]
struct BinarySession {
    id: PortId,
    kind: PortKind,
    subscriptions: Subscriptions,
    silence: Silence,
    /// Whether the client has sent a Disconnect Announcement.
    announced: bool,
    /// Whether frames with a wrong checksum are answered.
    answer_bad_checksum: bool,
    queue: FrameQueue,
    updates_lost: u32,
    replies_lost: u32,
}

impl BinaryClient {
    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        Self {
            deframer: Deframer::new(kind, config),
            line: BinarySession {
                id,
                kind,
                subscriptions: Subscriptions::default(),
                silence: Silence::new(kind, config),
                announced: false,
                answer_bad_checksum: config.answer_bad_checksum,
                queue: FrameQueue::new(),
                updates_lost: 0,
                replies_lost: 0,
            },
        }
    }

    /// Takes over the settings, and keeps the subscriptions.
    pub(crate) fn reconfigure(&mut self, before: &Config, config: &Config) {
        let Self { deframer, line } = self;
        if before.check_checksum != config.check_checksum {
            *deframer = Deframer::new(line.kind, config);
        }
        line.answer_bad_checksum = config.answer_bad_checksum;
        line.silence.reconfigure(line.kind, config);
    }

    pub(crate) const fn id(&self) -> PortId {
        self.line.id
    }

    /// Returns whether the end of the connection is an error.
    pub(crate) const fn is_missed(&self) -> bool {
        self.line.kind.is_connection() && !self.line.announced
    }

    pub(crate) fn counters(&self) -> PortCounters {
        PortCounters {
            parser: self.deframer.counters(),
            updates_lost: self.line.updates_lost,
            replies_lost: self.line.replies_lost,
        }
    }

    /// Takes bytes up to the first event, or some of them, and handles the event. Returns the number of bytes taken and
    /// whether there was an event.
    pub(crate) fn receive(&mut self, device: &mut Device, now: Time, bytes: &[u8]) -> (usize, bool) {
        self.line.silence.end(now);
        let (taken, event) = self.deframer.push_slice(now, bytes);
        (taken, event.map(|event| self.line.handle(device, now, event)).is_some())
    }

    /// Starts the time-out of an incomplete frame: no more bytes are available at present.
    pub(crate) fn pause(&mut self, now: Time) {
        self.deframer.pause(now);
    }

    /// Ends all subscriptions, because another sender uses the line now.
    pub(crate) fn end_updates(&mut self) {
        self.line.subscriptions.clear();
    }

    /// Handles one event in an incomplete frame whose time-out has expired, and returns whether there was one. Call
    /// until there is none. Also ends the subscriptions of a client that has been silent for too long.
    pub(crate) fn expire(&mut self, device: &mut Device, now: Time) -> bool {
        if self.line.silence.is_too_long(now) {
            self.line.subscriptions.clear();
        }
        let event = self.deframer.expire(now);
        event.map(|event| self.line.handle(device, now, event)).is_some()
    }

    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        let BinarySession { subscriptions, silence, .. } = &self.line;
        let end = if subscriptions.are_none() { None } else { silence.due() };
        earlier(earlier(subscriptions.next_due(now), end), self.deframer.due())
    }

    /// Sends the second answer to a command.
    pub(crate) fn complete(&mut self, done: Completion) {
        self.line.reply(Reply::status_only(done.id, done.status));
    }

    /// Sends an answer of a script.
    pub(crate) fn answer_script(&mut self, id: u8, payload: &[u8]) {
        self.line.push(FrameEncoder::new(id, payload));
    }

    /// Sends the updates that are due.
    pub(crate) fn publish(&mut self, now: Time, readings: &Readings) {
        let BinarySession { subscriptions, queue, updates_lost, .. } = &mut self.line;
        subscriptions.publish(now, readings, |value| {
            let reply = Reply::success(value);
            let frame = FrameEncoder::new(reply.id().code(), reply);
            let found_room = queue.push(frame, QUEUE_LEN - RESERVED_FOR_REPLIES);
            if !found_room {
                *updates_lost = updates_lost.saturating_add(1);
            }
            found_room
        });
    }

    pub(crate) const fn has_frame(&self) -> bool {
        self.line.queue.len > 0
    }

    pub(crate) fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let len = self.line.queue.pop(buffer)?;
        buffer.get(..len)
    }
}

impl BinarySession {
    fn handle(&mut self, device: &mut Device, now: Time, event: Event<'_>) {
        match event {
            Event::Frame(frame) => self.answer(device, now, &frame),
            Event::BadChecksum { id, .. } if self.answer_bad_checksum => {
                self.reply(Reply::status_only(CommandId::from_code(id), Status::ChecksumError));
            }
            Event::BadChecksum { .. } | Event::Oversize { .. } => {}
        }
    }

    /// Executes the request in a frame and answers it.
    fn answer(&mut self, device: &mut Device, now: Time, frame: &Frame<'_>) {
        let id = CommandId::from_code(frame.id);
        if self.announced {
            return self.refuse(device, id, Status::AccessDenied);
        }
        // Room for FLAGS and a period.
        let mut place = [0; 3];
        let payload: &[u8] = match (used_flags(id), place.get_mut(..frame.payload.len())) {
            (Some(used), Some(copy)) => {
                copy.copy_from_slice(frame.payload);
                copy.iter_mut().take(1).for_each(|flags| *flags &= used);
                copy
            }
            // A FAST STOP is executed regardless of its payload.
            _ if id == CommandId::FastStop => &[],
            _ => frame.payload,
        };
        match device.script_mut().keep(self.id, frame.id, frame.payload) {
            Some(Ok(())) => return,
            Some(Err(status)) => return self.refuse(device, id, status),
            None => {}
        }
        let command = match Command::decode(&Frame { id: frame.id, payload }) {
            Ok(command) => command,
            Err(refusal) => return self.refuse(device, id, id.status_of(refusal)),
        };
        if command == Command::DisconnectAnnouncement {
            return self.announce_disconnection(device);
        }
        let reply = device.execute(Request { port: self.id, now }, &command);
        let status = reply.status();
        self.reply(reply);
        if let Some(update) = update_of(&command) {
            self.subscriptions.request(id, update, now, device.readings());
        }
        device.note_result(id.kind(), status);
    }

    fn refuse(&mut self, device: &mut Device, id: CommandId, status: Status) {
        self.reply(Reply::status_only(id, status));
        device.note_result(id.kind(), status);
    }

    fn announce_disconnection(&mut self, device: &mut Device) {
        let id = CommandId::DisconnectAnnouncement;
        if self.kind != PortKind::Tcp {
            return self.refuse(device, id, Status::NotAvailable);
        }
        self.announced = true;
        self.subscriptions.clear();
        self.reply(Reply::status_only(id, Status::Success));
        device.note_result(id.kind(), Status::Success);
        device.abort_motion();
    }

    fn reply(&mut self, reply: Reply<'_>) {
        self.push(FrameEncoder::new(reply.id().code(), reply));
    }

    fn push<P: Payload>(&mut self, frame: FrameEncoder<P>) {
        if !self.queue.push(frame, QUEUE_LEN) {
            self.replies_lost = self.replies_lost.saturating_add(1);
        }
    }
}

/// Returns the used bits of FLAGS, the first byte, for commands that ignore the unused bits: the manual lists a wrong
/// length as their only error. The same applies to Pre-position (21h), but a damaged frame must not start a motion.
const fn used_flags(id: CommandId) -> Option<u8> {
    match id {
        CommandId::OverdriveMode | CommandId::GetGrippingStatistics => Some(0b01),
        CommandId::GetSystemState
        | CommandId::GetGripperState
        | CommandId::GetOpeningWidth
        | CommandId::GetSpeed
        | CommandId::GetForce => Some(0b11),
        _ => None,
    }
}

const fn update_of(command: &Command<'_>) -> Option<AutoUpdate> {
    match command {
        Command::GetSystemState { update }
        | Command::GetGripperState { update }
        | Command::GetOpeningWidth { update }
        | Command::GetSpeed { update }
        | Command::GetForce { update } => Some(*update),
        _ => None,
    }
}

/// Frames in a ring buffer. Each frame contains its own length.
#[derive(Clone, Debug)]
struct FrameQueue {
    bytes: [u8; QUEUE_LEN],
    first: usize,
    len: usize,
}

impl FrameQueue {
    const fn new() -> Self {
        Self { bytes: [0; QUEUE_LEN], first: 0, len: 0 }
    }

    /// Appends a frame unless the queue would exceed `limit` bytes. Returns whether it did.
    fn push<P: Payload>(&mut self, frame: FrameEncoder<P>, limit: usize) -> bool {
        if self.len + frame.frame_len() > limit {
            return false;
        }
        for byte in frame {
            self.bytes[(self.first + self.len) % QUEUE_LEN] = byte;
            self.len += 1;
        }
        true
    }

    /// Copies the oldest frame to `buffer`, removes it and returns its length.
    fn pop(&mut self, buffer: &mut FrameBuffer) -> Option<usize> {
        if self.len == 0 {
            return None;
        }
        let size = u16::from_le_bytes([self.byte(SIZE_AT), self.byte(SIZE_AT + 1)]);
        let len = usize::from(size) + OVERHEAD;
        for (at, slot) in buffer.iter_mut().enumerate().take(len) {
            *slot = self.byte(at);
        }
        self.first = (self.first + len) % QUEUE_LEN;
        self.len -= len;
        Some(len)
    }

    fn byte(&self, at: usize) -> u8 {
        self.bytes[(self.first + at) % QUEUE_LEN]
    }
}
