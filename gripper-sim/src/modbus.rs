//! A client of Modbus/TCP: its frames. The requests are in `fieldbus`.

use crate::client::Client;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, Request};
use crate::send_queue::SendQueue;
use crate::time::Time;
use bus_modbus::tcp::{self, Event, HEADER_LEN, Receiver};
use wsg_protocol::FrameCounters;

/// Offset of the length field in a frame; it counts the bytes that follow it.
const LENGTH_AT: usize = HEADER_LEN - 3;

const _: () = assert!(tcp::MAX_FRAME_LEN <= MAX_FRAME_LEN);

/// A client: its frame decoder and its connection.
#[derive(Clone, Debug)]
pub(crate) struct ModbusClient {
    receiver: Receiver,
    line: ModbusSession,
}

/// The state of a client apart from its frame decoder.
#[derive(Clone, Debug)]
struct ModbusSession {
    id: PortId,
    /// Whether synchronization is lost: queued frames are sent, then the connection is closed.
    lost: bool,
    queue: SendQueue,
    /// Discarded bytes of frames of other protocols.
    dropped: u16,
}

impl ModbusClient {
    pub(crate) fn new(id: PortId) -> Self {
        let line = ModbusSession { id, lost: false, queue: SendQueue::default(), dropped: 0 };
        Self { receiver: Receiver::new(), line }
    }
}

impl Client for ModbusClient {
    fn id(&self) -> PortId {
        self.line.id
    }

    fn counters(&self) -> PortCounters {
        let ModbusSession { lost, dropped, queue, .. } = &self.line;
        queue.counters(FrameCounters { dropped: *dropped, bad_checksum: 0, oversize: (*lost).into() })
    }

    fn is_lost(&self) -> bool {
        self.line.lost
    }

    fn receive(
        &mut self,
        device: &mut Device,
        fieldbus: &mut Fieldbus,
        now: Time,
        bytes: &[u8],
    ) -> (usize, bool) {
        let (taken, event) = self.receiver.push_slice(bytes);
        (taken, event.map(|event| self.line.handle(device, fieldbus, now, event)).is_some())
    }

    fn has_frame(&self) -> bool {
        !self.line.queue.is_empty()
    }

    fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let length = u16::from_be_bytes(self.line.queue.pair_at(LENGTH_AT)?);
        self.line.queue.pop(HEADER_LEN - 1 + usize::from(length), buffer)
    }
}

impl ModbusSession {
    fn handle(&mut self, device: &Device, fieldbus: &mut Fieldbus, now: Time, event: Event<'_>) {
        match event {
            Event::Request(request) => {
                let mut frame = [0; tcp::MAX_FRAME_LEN];
                let sender = Request { port: self.id, now };
                let answer =
                    request.answer(&mut frame, |pdu, place| fieldbus.serve(device, sender, pdu, place));
                self.queue.push_answer(answer.len(), answer.iter().copied());
            }
            Event::Foreign { len } => self.dropped = self.dropped.saturating_add(len),
            Event::Lost => self.lost = true,
        }
    }
}
