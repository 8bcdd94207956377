//! A client of the Gripper Control Language (GCL).
//!
//! This module is the connection: its lines, its subscriptions, and the order of `ACK`, `FIN` and `ERR`. The requests
//! are in `requests`. `docs/gcl.md` records the decisions made where the manual is silent.

mod autosend;
mod requests;

use crate::config::Config;
use crate::device::Device;
use crate::port::{Completion, FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind};
use crate::time::{Time, earlier};
use crate::updates::{Readings, Silence};
use autosend::Autosends;
use heapless::{Deque, String};
use requests::Outcome;
use wsg_protocol::gcl::{Answer, CommandName, Description, LineEvent, LineReader, Named, Refused, Request};
use wsg_protocol::{CommandId, FrameCounters, Kind, Status};

/// Longest accepted line in bytes; requests are shorter, apart from blanks.
const LINE_LEN: usize = 256;
/// Capacity of the output queue in bytes.
const QUEUE_LEN: usize = 2_048;
/// Space in the queue that updates leave free for answers.
const RESERVED_FOR_ANSWERS: usize = 512;

/// A client: its line decoder and its connection.
#[derive(Clone, Debug)]
pub(crate) struct TextClient {
    reader: LineReader<LINE_LEN>,
    line: TextSession,
}

/// The state of a client apart from its line decoder.
#[derive(Clone, Debug)]
struct TextSession {
    id: PortId,
    kind: PortKind,
    /// Whether the client has sent BYE.
    announced: bool,
    verbose: bool,
    part_width_tolerance: f32,
    clamping_travel: f32,
    autosends: Autosends,
    silence: Silence,
    queue: Deque<u8, QUEUE_LEN>,
    updates_lost: u32,
    replies_lost: u32,
}

impl TextClient {
    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        Self {
            reader: LineReader::new(),
            line: TextSession {
                id,
                kind,
                announced: false,
                verbose: config.gcl_verbose,
                part_width_tolerance: config.part_width_tolerance,
                clamping_travel: config.clamping_travel,
                autosends: Autosends::default(),
                silence: Silence::new(kind, config),
                queue: Deque::new(),
                updates_lost: 0,
                replies_lost: 0,
            },
        }
    }

    /// Takes over the settings that the client cannot change itself.
    pub(crate) const fn reconfigure(&mut self, config: &Config) {
        self.line.silence.reconfigure(self.line.kind, config);
    }

    pub(crate) const fn id(&self) -> PortId {
        self.line.id
    }

    /// Returns whether the end of the connection is an error.
    pub(crate) const fn is_missed(&self) -> bool {
        self.line.kind.is_connection() && !self.line.announced
    }

    pub(crate) const fn counters(&self) -> PortCounters {
        let lines = self.reader.counters();
        PortCounters {
            parser: FrameCounters { dropped: lines.dropped, bad_checksum: 0, oversize: lines.too_long },
            updates_lost: self.line.updates_lost,
            replies_lost: self.line.replies_lost,
        }
    }

    /// Takes bytes up to the first line, or some of them, and answers the line. Returns the number of bytes taken and
    /// whether there was a line.
    pub(crate) fn receive(&mut self, device: &mut Device, now: Time, bytes: &[u8]) -> (usize, bool) {
        self.line.silence.end(now);
        let (taken, event) = self.reader.push_slice(bytes);
        (taken, event.map(|event| self.line.handle(device, now, event)).is_some())
    }

    /// Marks the end of the available bytes and answers a line that the end of its datagram completes. Returns whether
    /// there was one.
    pub(crate) fn pause(&mut self, device: &mut Device, now: Time) -> bool {
        if !self.line.kind.is_datagram() {
            return false;
        }
        self.reader.finish().map(|event| self.line.handle(device, now, event)).is_some()
    }

    /// Sends the second answer to a motion.
    pub(crate) fn complete(&mut self, done: Completion) {
        self.line.complete(done);
    }

    /// Sends the values that are due.
    pub(crate) fn publish(&mut self, now: Time, readings: &Readings) {
        let TextSession { autosends, queue, updates_lost, .. } = &mut self.line;
        autosends.publish(now, readings, |value| {
            let found_room = push(queue, &Answer::Update(value), QUEUE_LEN - RESERVED_FOR_ANSWERS);
            if !found_room {
                *updates_lost = updates_lost.saturating_add(1);
            }
            found_room
        });
    }

    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        let TextSession { autosends, silence, .. } = &self.line;
        let end = if autosends.are_none() { None } else { silence.due() };
        earlier(autosends.next_due(now), end)
    }

    /// Ends all subscriptions, because another sender uses the line now.
    pub(crate) fn end_updates(&mut self) {
        self.line.autosends.clear();
    }

    /// Ends the subscriptions of a client that has been silent for too long.
    pub(crate) fn expire(&mut self, now: Time) {
        if self.line.silence.is_too_long(now) {
            self.line.autosends.clear();
        }
    }

    pub(crate) fn has_line(&self) -> bool {
        !self.line.queue.is_empty()
    }

    /// Returns the oldest line, including its line end.
    pub(crate) fn next_line<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let mut len = 0;
        while let Some(byte) = self.line.queue.pop_front() {
            *buffer.get_mut(len)? = byte;
            len += 1;
            if byte == b'\n' {
                return buffer.get(..len);
            }
        }
        None
    }
}

impl TextSession {
    /// Executes the request in a line and answers it.
    fn handle(&mut self, device: &mut Device, now: Time, event: LineEvent<'_>) {
        let request = match event {
            LineEvent::Line(text) => Request::parse(text),
            LineEvent::TooLong(start) => Err(Refused::too_long(start)),
        };
        let request = match request {
            Ok(request) => request,
            Err(refused) => {
                device.note_result(Kind::Motion, refused.mistake.status());
                return self.answer(&refused.answer(self.verbose));
            }
        };
        let name = request.name();
        if self.announced {
            device.note_result(request.kind(), Status::AccessDenied);
            return self.fail(name.into(), Status::AccessDenied);
        }
        // Texts of an answer that the device does not store.
        let mut text = String::new();
        let status = match requests::carry_out(device, self, now, request, &mut text) {
            Outcome::Value(value) => {
                self.answer(&Answer::Value(value));
                Status::Success
            }
            Outcome::Status(status @ (Status::Success | Status::CmdPending)) => {
                self.answer(&Answer::Ack(name));
                status
            }
            Outcome::Status(status) => {
                self.fail(name.into(), status);
                status
            }
        };
        // A subscription is a query in the binary protocol, so it does not clear an earlier failure.
        let is_subscription = matches!(request, Request::Autosend(_));
        device.note_result(if is_subscription { Kind::Query } else { request.kind() }, status);
        if self.announced {
            // BYE is answered first; the answers to motions that it ends follow.
            device.abort_motion();
        }
    }

    /// Queues the second answer to a motion.
    fn complete(&mut self, done: Completion) {
        let name = match done.id {
            CommandId::Homing => CommandName::Home,
            CommandId::PrePosition => CommandName::Move,
            CommandId::GripPart => CommandName::Grip,
            CommandId::ReleasePart => CommandName::Release,
            // No other GCL request has a second answer.
            _ => return,
        };
        match done.status {
            Status::Success => self.answer(&Answer::Fin(name)),
            status => self.fail(name.into(), status),
        }
    }

    fn fail(&mut self, name: Named<'_>, status: Status) {
        let description = self.verbose.then(|| Description::of(status));
        self.answer(&Answer::Err { name, status, description });
    }

    fn answer(&mut self, answer: &Answer<'_>) {
        if !push(&mut self.queue, answer, QUEUE_LEN) {
            self.replies_lost = self.replies_lost.saturating_add(1);
        }
    }
}

/// Appends a line unless the queue would exceed `limit` bytes. Returns whether it did.
fn push(queue: &mut Deque<u8, QUEUE_LEN>, answer: &Answer<'_>, limit: usize) -> bool {
    let mut buffer = [0; MAX_FRAME_LEN];
    let Ok(len) = answer.write_line_into(&mut buffer) else { return false };
    if queue.len() + len > limit {
        return false;
    }
    buffer.iter().take(len).all(|byte| queue.push_back(*byte).is_ok())
}

/// Returns the temperature in °C.
fn celsius(readings: &Readings) -> f32 {
    f32::from(readings.temperature.0) / 10.0
}
