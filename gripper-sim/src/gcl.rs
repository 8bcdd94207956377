//! A client of the Gripper Control Language (GCL).
//!
//! This module is the connection: its lines, its subscriptions, and the order of `ACK`, `FIN` and `ERR`. The requests
//! are in `requests`. `docs/decisions.md` records the decisions made where the manual is silent.

mod autosend;
mod requests;

use crate::client::Client;
use crate::config::Config;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::port::{Completion, FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind};
use crate::send_queue::SendQueue;
use crate::time::Time;
use crate::updates::Readings;
use autosend::{Autosends, value};
use heapless::{String, Vec};
use requests::Outcome;
use wsg_protocol::gcl::{Answer, CommandName, Description, LineEvent, LineReader, Named, Refused, Request};
use wsg_protocol::{CommandId, FrameCounters, Kind, Status};

/// Longest accepted line in bytes; requests are shorter, apart from blanks.
const LINE_LEN: usize = 256;
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
    queue: SendQueue,
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
                autosends: Autosends::new(kind, config),
                queue: SendQueue::default(),
            },
        }
    }
}

impl Client for TextClient {
    fn id(&self) -> PortId {
        self.line.id
    }

    fn counters(&self) -> PortCounters {
        let lines = self.reader.counters();
        let parser = FrameCounters { dropped: lines.dropped, bad_checksum: 0, oversize: lines.too_long };
        self.line.queue.counters(parser)
    }

    fn reconfigure(&mut self, _: &Config, config: &Config) {
        self.line.autosends.reconfigure(self.line.kind, config);
    }

    fn is_missed(&self) -> bool {
        self.line.kind.is_connection() && !self.line.announced
    }

    fn receive(&mut self, device: &mut Device, _: &mut Fieldbus, now: Time, bytes: &[u8]) -> (usize, bool) {
        self.line.autosends.end_silence(now);
        let (taken, event) = self.reader.push_slice(bytes);
        (taken, event.map(|event| self.line.handle(device, now, event)).is_some())
    }

    fn pause(&mut self, device: &mut Device, now: Time) -> bool {
        if !self.line.kind.is_datagram() {
            return false;
        }
        self.reader.finish().map(|event| self.line.handle(device, now, event)).is_some()
    }

    fn expire(&mut self, _: &mut Device, _: &mut Fieldbus, now: Time) -> bool {
        self.line.autosends.expire(now);
        false
    }

    fn end_updates(&mut self) {
        self.line.autosends.clear();
    }

    fn next_due(&self, now: Time) -> Option<Time> {
        self.line.autosends.next_due(now)
    }

    fn complete(&mut self, done: Completion) {
        self.line.complete(done);
    }

    fn publish(&mut self, now: Time, readings: &Readings) {
        let TextSession { autosends, queue, .. } = &mut self.line;
        autosends.publish(now, readings, |autosend| {
            let value = value(autosend.topic, readings);
            line_of(&Answer::Update(value)).is_some_and(|line| queue.push_update(line.len(), line))
        });
    }

    fn has_frame(&self) -> bool {
        !self.line.queue.is_empty()
    }

    /// Returns the oldest line, including its line end.
    fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let len = self.line.queue.len_to(b'\n')?;
        self.line.queue.pop(len, buffer)
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
            device.motion_mut().abort();
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
        if let Some(line) = line_of(answer) {
            self.queue.push_answer(line.len(), line);
        }
    }
}

/// Returns the line of an answer; `None` if it is longer than any line of the protocol.
fn line_of(answer: &Answer<'_>) -> Option<Vec<u8, MAX_FRAME_LEN>> {
    let mut line = Vec::new();
    line.resize_default(MAX_FRAME_LEN).ok()?;
    let len = answer.write_line_into(&mut line).ok()?;
    line.truncate(len);
    Some(line)
}

/// Returns the temperature in °C.
fn celsius(readings: &Readings) -> f32 {
    f32::from(readings.temperature.0) / 10.0
}
