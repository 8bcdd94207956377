//! A client of Modbus/TCP: its frames. The requests are in `fieldbus`.

use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, Request};
use crate::time::Time;
use bus_modbus::tcp::{self, Event, HEADER_LEN, Receiver};
use heapless::Deque;
use wsg_protocol::FrameCounters;

/// Capacity of the output queue in bytes: the answers to all requests received at once.
const QUEUE_LEN: usize = 2_048;
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
    queue: Deque<u8, QUEUE_LEN>,
    /// Discarded bytes of frames of other protocols.
    dropped: u16,
    replies_lost: u32,
}

impl ModbusClient {
    pub(crate) const fn new(id: PortId) -> Self {
        let line = ModbusSession { id, lost: false, queue: Deque::new(), dropped: 0, replies_lost: 0 };
        Self { receiver: Receiver::new(), line }
    }

    pub(crate) const fn id(&self) -> PortId {
        self.line.id
    }

    /// Returns whether the client's byte stream has lost synchronization for good.
    pub(crate) const fn is_lost(&self) -> bool {
        self.line.lost
    }

    pub(crate) fn counters(&self) -> PortCounters {
        let ModbusSession { lost, dropped, replies_lost, .. } = self.line;
        PortCounters {
            parser: FrameCounters { dropped, bad_checksum: 0, oversize: lost.into() },
            updates_lost: 0,
            replies_lost,
        }
    }

    /// Takes bytes up to the first event, or some of them, and handles the event. Returns the number of bytes taken and
    /// whether there was an event.
    pub(crate) fn receive(
        &mut self,
        device: &Device,
        fieldbus: &mut Fieldbus,
        now: Time,
        bytes: &[u8],
    ) -> (usize, bool) {
        let (taken, event) = self.receiver.push_slice(bytes);
        (taken, event.map(|event| self.line.handle(device, fieldbus, now, event)).is_some())
    }

    pub(crate) fn has_frame(&self) -> bool {
        !self.line.queue.is_empty()
    }

    /// Returns the oldest queued frame.
    pub(crate) fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let queue = &mut self.line.queue;
        let mut bytes = queue.iter().skip(LENGTH_AT).copied();
        let length = u16::from_be_bytes([bytes.next()?, bytes.next()?]);
        let place = buffer.get_mut(..HEADER_LEN - 1 + usize::from(length))?;
        for slot in place.iter_mut() {
            *slot = queue.pop_front()?;
        }
        Some(place)
    }
}

impl ModbusSession {
    fn handle(&mut self, device: &Device, fieldbus: &mut Fieldbus, now: Time, event: Event<'_>) {
        match event {
            Event::Request(request) => {
                let mut frame = [0; tcp::MAX_FRAME_LEN];
                let asked = Request { port: self.id, now };
                let answer =
                    request.answer(&mut frame, |pdu, place| fieldbus.serve(device, asked, pdu, place));
                self.send(answer);
            }
            Event::Foreign { len } => self.dropped = self.dropped.saturating_add(len),
            Event::Lost => self.lost = true,
        }
    }

    fn send(&mut self, frame: &[u8]) {
        if self.queue.len() + frame.len() > QUEUE_LEN {
            self.replies_lost = self.replies_lost.saturating_add(1);
            return;
        }
        // The queue has room for the whole frame.
        let _ = frame.iter().try_for_each(|byte| self.queue.push_back(*byte));
    }
}
