//! The frames or lines that wait for a client to read them.

use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortCounters};
use heapless::Deque;
use wsg_protocol::FrameCounters;

/// Capacity in bytes: on Modbus/TCP, the answers to all requests received at once.
const QUEUE_LEN: usize = 2_048;
/// Space that updates leave free for answers.
const RESERVED_FOR_ANSWERS: usize = 512;

const _: () = assert!(QUEUE_LEN >= RESERVED_FOR_ANSWERS + MAX_FRAME_LEN);

/// Complete frames or lines, oldest first.
#[derive(Clone, Debug, Default)]
pub(crate) struct SendQueue {
    queue: Deque<u8, QUEUE_LEN>,
    updates_lost: u32,
    replies_lost: u32,
}

impl SendQueue {
    /// Appends an answer of `len` bytes, or drops it if there is no room.
    pub(crate) fn push_answer(&mut self, len: usize, bytes: impl IntoIterator<Item = u8>) {
        if !self.push(len, bytes, QUEUE_LEN) {
            self.replies_lost = self.replies_lost.saturating_add(1);
        }
    }

    /// Appends an update of `len` bytes, or drops it if there is no room beside that for answers. Returns whether there was.
    pub(crate) fn push_update(&mut self, len: usize, bytes: impl IntoIterator<Item = u8>) -> bool {
        let found_room = self.push(len, bytes, QUEUE_LEN - RESERVED_FOR_ANSWERS);
        if !found_room {
            self.updates_lost = self.updates_lost.saturating_add(1);
        }
        found_room
    }

    /// Appends bytes unless the queue would exceed `limit` bytes. Returns whether it appended them.
    fn push(&mut self, len: usize, bytes: impl IntoIterator<Item = u8>, limit: usize) -> bool {
        self.queue.len() + len <= limit && bytes.into_iter().all(|byte| self.queue.push_back(byte).is_ok())
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Returns the two bytes at this offset, where some frames have their length.
    pub(crate) fn pair_at(&self, offset: usize) -> Option<[u8; 2]> {
        let mut bytes = self.queue.iter().skip(offset).copied();
        Some([bytes.next()?, bytes.next()?])
    }

    /// Returns the length up to the first byte with this value.
    pub(crate) fn len_to(&self, end: u8) -> Option<usize> {
        self.queue.iter().position(|byte| *byte == end).map(|at| at + 1)
    }

    /// Moves the oldest `len` bytes to `buffer`.
    pub(crate) fn pop<'a>(&mut self, len: usize, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let place = buffer.get_mut(..len)?;
        for slot in place.iter_mut() {
            *slot = self.queue.pop_front()?;
        }
        Some(place)
    }

    /// Returns the counters of a client with this decoder.
    pub(crate) const fn counters(&self, parser: FrameCounters) -> PortCounters {
        PortCounters { parser, updates_lost: self.updates_lost, replies_lost: self.replies_lost }
    }
}
