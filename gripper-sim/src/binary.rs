//! A client of the binary protocol: its frames and its subscriptions. The commands are in `device`.

use crate::client::Client;
use crate::config::Config;
use crate::deframer::Deframer;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::port::{Completion, FrameBuffer, PortCounters, PortId, PortKind, Request};
use crate::send_queue::SendQueue;
use crate::time::{Time, earlier};
use crate::updates::{Readings, Updates};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{AutoUpdate, Command, CommandId, Event, Frame, FrameEncoder, Payload, Reply, Status};

/// Offset of the size field in a frame.
const SIZE_AT: usize = 4;

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
    subscriptions: Updates,
    /// Whether the client has sent a Disconnect Announcement.
    announced: bool,
    /// Whether frames with a wrong checksum are answered.
    answer_bad_checksum: bool,
    queue: SendQueue,
}

impl BinaryClient {
    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        Self {
            deframer: Deframer::new(kind, config),
            line: BinarySession {
                id,
                kind,
                subscriptions: Updates::new(kind, config),
                announced: false,
                answer_bad_checksum: config.answer_bad_checksum,
                queue: SendQueue::default(),
            },
        }
    }
}

impl Client for BinaryClient {
    fn id(&self) -> PortId {
        self.line.id
    }

    fn counters(&self) -> PortCounters {
        self.line.queue.counters(self.deframer.counters())
    }

    fn reconfigure(&mut self, before: &Config, config: &Config) {
        let Self { deframer, line } = self;
        if before.check_checksum != config.check_checksum {
            *deframer = Deframer::new(line.kind, config);
        }
        line.answer_bad_checksum = config.answer_bad_checksum;
        line.subscriptions.reconfigure(line.kind, config);
    }

    fn is_missed(&self) -> bool {
        self.line.kind.is_connection() && !self.line.announced
    }

    fn receive(&mut self, device: &mut Device, _: &mut Fieldbus, now: Time, bytes: &[u8]) -> (usize, bool) {
        self.line.subscriptions.end_silence(now);
        let (taken, event) = self.deframer.push_slice(now, bytes);
        (taken, event.map(|event| self.line.handle(device, now, event)).is_some())
    }

    /// Starts the time-out of an incomplete frame.
    fn pause(&mut self, _: &mut Device, now: Time) -> bool {
        self.deframer.pause(now);
        false
    }

    fn expire(&mut self, device: &mut Device, _: &mut Fieldbus, now: Time) -> bool {
        self.line.subscriptions.expire(now);
        let event = self.deframer.expire(now);
        event.map(|event| self.line.handle(device, now, event)).is_some()
    }

    fn end_updates(&mut self) {
        self.line.subscriptions.clear();
    }

    fn next_due(&self, now: Time) -> Option<Time> {
        earlier(self.line.subscriptions.next_due(now), self.deframer.due())
    }

    fn complete(&mut self, done: Completion) {
        self.line.reply(Reply::status_only(done.id, done.status));
    }

    fn answer_script(&mut self, id: u8, payload: &[u8]) {
        self.line.push(FrameEncoder::new(id, payload));
    }

    fn publish(&mut self, now: Time, readings: &Readings) {
        let BinarySession { subscriptions, queue, .. } = &mut self.line;
        subscriptions.publish(now, readings, |update| {
            let reply = Reply::success(update.value(readings));
            let frame = FrameEncoder::new(reply.id().code(), reply);
            queue.push_update(frame.frame_len(), frame)
        });
    }

    fn has_frame(&self) -> bool {
        !self.line.queue.is_empty()
    }

    fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let size = u16::from_le_bytes(self.line.queue.pair_at(SIZE_AT)?);
        self.line.queue.pop(usize::from(size) + OVERHEAD, buffer)
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
        device.motion_mut().abort();
    }

    fn reply(&mut self, reply: Reply<'_>) {
        self.push(FrameEncoder::new(reply.id().code(), reply));
    }

    fn push<P: Payload>(&mut self, frame: FrameEncoder<P>) {
        self.queue.push_answer(frame.frame_len(), frame);
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
