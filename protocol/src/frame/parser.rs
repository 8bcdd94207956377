//! Extracts intact frames from received bytes, one at a time or in slices.
//!
//! The parser delivers the same frames as a reader with the whole recording. It tries a frame at the first byte. If the
//! frame proves false (size over the limit or wrong checksum), it retries one byte later and never skips the bytes of
//! the false frame. Noise, a false preamble or a truncated frame therefore costs at most the messages it is part of.

use core::hash::{Hash, Hasher};

use super::{Frame, PREAMBLE_BYTE};
use crate::checksum;

/// Bytes between preamble and payload: command id and size.
const HEAD_LEN: usize = 3;
/// Bytes after the payload: the checksum.
const TAIL_LEN: usize = 2;

/// Whether slices are processed in bulk instead of byte by byte. The feature `small-table` disables it to save flash.
const IN_BULK: bool = cfg!(not(feature = "small-table"));

/// An event reported by the parser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum Event<'a> {
    /// An intact frame with a valid checksum.
    Frame(Frame<'a>),
    /// A complete frame with a wrong checksum. Its bytes are scanned again for frames.
    BadChecksum {
        /// The received command id.
        id: u8,
        /// The received payload length, in bytes.
        size: u16,
    },
    /// A frame whose size field exceeds the capacity of the parser. Its bytes are scanned again for frames.
    Oversize {
        /// The received command id.
        id: u8,
        /// The announced payload length, in bytes.
        size: u16,
    },
}

/// Counters of rejected input. Each counter saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct FrameCounters {
    /// Bytes that were not part of an intact frame.
    pub dropped: u16,
    /// Frames with a wrong checksum.
    pub bad_checksum: u16,
    /// Frames whose size field exceeds the capacity of the parser.
    pub oversize: u16,
}

/// Finds frames with up to `N` bytes of payload in a byte stream.
///
/// Pass bytes to [`push`](Self::push) or [`push_slice`](Self::push_slice). An event may leave further events pending
/// for bytes already taken: call [`poll`](Self::poll) until it returns `None`. The caller decides when an incomplete
/// frame times out, and then calls [`expire`](Self::expire).
///
/// Work per call is bounded. A byte of the frame being received costs one table look-up. A false frame costs a new scan
/// of at most N + 5 held bytes, in which each false preamble costs at most the bytes that follow it.
///
/// The parser takes N + 16 bytes of memory (N even), all zero after [`new`](Self::new).
///
/// ```
/// use wsg_protocol::{Event, FrameParser};
///
/// let mut parser = FrameParser::<64>::new();
/// let line = [0x00, 0xAA, 0xAA, 0xAA, 0x01, 0x00, 0x00, 0xE8, 0x10]; // one byte of noise, then a frame
/// let (taken, event) = parser.push_slice(&line);
/// assert_eq!(taken, 9);
/// assert!(matches!(event, Some(Event::Frame(frame)) if frame.id == 0x01 && frame.payload.is_empty()));
/// assert_eq!(parser.counters().dropped, 1);
/// ```
#[derive(Clone, Debug)]
// Fields used for each byte come first, within reach of short load and store instructions.
#[repr(C)]
pub struct FrameParser<const N: usize> {
    /// Number of bytes held.
    held: u16,
    /// The running checksum; while draining, the index of the held byte to scan next.
    checksum_or_next: u16,
    counters: FrameCounters,
    /// Number of preamble bytes seen (0 to 3) and the mode bits.
    flags: u8,
    /// Held bytes without the preamble: the frame being received, from its id on; while draining, the bytes still to be
    /// scanned.
    store: Store<N>,
}

/// Mask in `flags`: number of preamble bytes seen.
const PREAMBLE_MASK: u8 = 0b11;
/// Value under the mask after a complete preamble.
const IN_FRAME: u8 = PREAMBLE_MASK;
/// Bit in `flags`: an event interrupted a scan, and held bytes remain to be scanned.
const DRAINING: u8 = 0b0100;
/// Bit in `flags`: frames are accepted with any checksum.
const IGNORE_CHECKSUM: u8 = 0b1000;

/// The result of a completed frame or scan step.
#[derive(Clone, Copy, PartialEq)]
enum Found {
    Frame,
    BadChecksum,
    Oversize,
}

impl<const N: usize> FrameParser<N> {
    /// Creates an empty parser.
    #[must_use]
    pub const fn new() -> Self {
        const {
            assert!(
                N <= 65_530,
                "N must not exceed 65 530: the size field is limited to 65 535, and header and checksum are held as well"
            )
        };
        Self {
            held: 0,
            checksum_or_next: 0,
            counters: FrameCounters { dropped: 0, bad_checksum: 0, oversize: 0 },
            flags: 0,
            store: Store { head: [0; HEAD_LEN], body: [0; N], tail: [0; TAIL_LEN] },
        }
    }

    /// Creates a parser that accepts frames with any checksum, for a gripper whose checksum evaluation is
    /// disabled (command set, 1.4.1). The stream is then unprotected except for the exact checks of the typed layer.
    #[must_use]
    pub const fn ignoring_checksums() -> Self {
        let mut parser = Self::new();
        parser.flags = IGNORE_CHECKSUM;
        parser
    }

    /// Returns the counters of rejected input since the parser was created.
    #[must_use]
    pub const fn counters(&self) -> FrameCounters {
        self.counters
    }

    /// Returns whether part of a frame is held, so that a time-out must run.
    #[must_use]
    pub const fn is_mid_frame(&self) -> bool {
        self.flags & (PREAMBLE_MASK | DRAINING) != 0
    }

    /// Takes one byte and returns the event it completes.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Event<'_>> {
        // Inlined up to this point: most bytes are payload and complete no event.
        if self.flags & (DRAINING | PREAMBLE_MASK) == IN_FRAME && self.take_payload_byte(byte) {
            return None;
        }
        let found = self.step(byte)?;
        self.event(found)
    }

    /// Takes bytes up to the first event and returns their number. The events are the same as with [`push`](Self::push)
    /// byte by byte. An empty slice makes the call equal to [`poll`](Self::poll).
    pub fn push_slice(&mut self, bytes: &[u8]) -> (usize, Option<Event<'_>>) {
        let mut rest = bytes;
        let mut found = self.drain();
        while found.is_none() {
            if IN_BULK {
                rest = self.take_run(rest);
            }
            let Some((&byte, behind)) = rest.split_first() else { break };
            rest = behind;
            found = self.step(byte);
        }
        let taken = bytes.len().wrapping_sub(rest.len());
        (taken, found.and_then(|found| self.event(found)))
    }

    /// Returns the next pending event for bytes already taken.
    pub fn poll(&mut self) -> Option<Event<'_>> {
        let found = self.drain()?;
        self.event(found)
    }

    /// Discards the incomplete frame after a time-out and scans its bytes again. Call until it returns `None`; no bytes
    /// are held then.
    pub fn expire(&mut self) -> Option<Event<'_>> {
        loop {
            if let Some(found) = self.drain() {
                return self.event(found);
            }
            match self.preamble_seen() {
                0 => return None,
                IN_FRAME => self.give_up_frame(),
                seen => {
                    self.drop_bytes(seen.into());
                    self.set_preamble_seen(0);
                }
            }
        }
    }

    /// Discards all held bytes and counts them as dropped.
    pub fn reset(&mut self) {
        let seen = u16::from(self.preamble_seen());
        let waiting = if self.is_draining() {
            self.held.saturating_sub(self.checksum_or_next)
        } else if self.preamble_seen() == IN_FRAME {
            self.held
        } else {
            0
        };
        self.drop_bytes(waiting.saturating_add(seen));
        self.flags &= IGNORE_CHECKSUM;
    }

    /// Processes one byte after all bytes that wait to be scanned, up to the next event.
    fn step(&mut self, byte: u8) -> Option<Found> {
        if self.is_draining() { self.step_draining(byte) } else { self.receive(byte) }
    }

    /// Processes one byte while held bytes wait to be scanned.
    #[cold]
    fn step_draining(&mut self, byte: u8) -> Option<Found> {
        let found = self.drain();
        self.receive_after(found, byte)
    }

    /// Scans the waiting bytes by receiving them again, up to the next event or the end. Each byte is stored at its old
    /// position or nearer the front. Bytes after the event keep waiting.
    fn drain(&mut self) -> Option<Found> {
        if !self.is_draining() {
            return None;
        }
        self.flags &= !DRAINING;
        let end = self.held as usize;
        let mut next = self.checksum_or_next as usize;
        let mut found = None;
        self.held = 0;
        while next < end {
            found = self.receive_after(found, self.store.get(next));
            next = next.wrapping_add(1);
        }
        found
    }

    /// Processes one byte, or queues it for the scan if an event was found. There is room: finding an event consumes at
    /// least one byte of a drain.
    fn receive_after(&mut self, found: Option<Found>, byte: u8) -> Option<Found> {
        if found.is_none() {
            return self.receive(byte);
        }
        self.store.put(self.held as usize, byte);
        self.held = self.held.wrapping_add(1);
        self.flags |= DRAINING;
        found
    }

    /// Processes one byte while none waits to be scanned.
    #[inline]
    fn receive(&mut self, byte: u8) -> Option<Found> {
        match self.preamble_seen() {
            IN_FRAME => self.step_in_frame(byte),
            seen => {
                self.look_for_preamble(seen, byte);
                None
            }
        }
    }

    /// Processes one byte after a complete preamble.
    fn step_in_frame(&mut self, byte: u8) -> Option<Found> {
        if self.take_payload_byte(byte) {
            return None;
        }
        let at = self.held as usize;
        self.held = at.wrapping_add(1) as u16;
        let Some(slot) = self.store.head.get_mut(at) else { return self.end(at, byte) };
        *slot = byte;
        if at == HEAD_LEN - 1 && self.store.size() > N {
            return Some(self.dispatch(Found::Oversize));
        }
        self.checksum_or_next = checksum::push(self.checksum_or_next, byte);
        None
    }

    /// Takes one byte after the preamble if it is payload, and returns whether it was.
    #[inline(always)]
    fn take_payload_byte(&mut self, byte: u8) -> bool {
        let at = self.held as usize;
        let index = at.wrapping_sub(HEAD_LEN);
        if index >= self.store.size() {
            return false;
        }
        let Some(slot) = self.store.body.get_mut(index) else { return false };
        *slot = byte;
        self.held = at.wrapping_add(1) as u16;
        self.checksum_or_next = checksum::push(self.checksum_or_next, byte);
        true
    }

    /// Processes one byte of the checksum field.
    fn end(&mut self, at: usize, byte: u8) -> Option<Found> {
        self.store.put(at, byte);
        if at == HEAD_LEN.wrapping_add(self.store.size()) {
            return None;
        }
        // The manual also allows processing both checksum bytes and testing for 0. Four different pairs of bytes lead
        // to 0 from any value, so that test would miss four times as many corruptions as this comparison.
        let received = u16::from_le_bytes([self.store.get(at.wrapping_sub(1)), byte]);
        let accepted = received == self.checksum_or_next || self.flags & IGNORE_CHECKSUM != 0;
        Some(self.dispatch(if accepted { Found::Frame } else { Found::BadChecksum }))
    }

    /// Processes one byte outside a frame.
    fn look_for_preamble(&mut self, seen: u8, byte: u8) {
        if byte == PREAMBLE_BYTE {
            self.flags = self.flags.wrapping_add(1);
            self.held = 0;
            self.checksum_or_next = checksum::AFTER_PREAMBLE;
        } else {
            self.drop_bytes(u16::from(seen).wrapping_add(1));
            self.set_preamble_seen(0);
        }
    }

    /// Ends the frame being received. Any bytes held after it wait to be scanned.
    fn dispatch(&mut self, found: Found) -> Found {
        let count = match found {
            Found::Frame => {
                self.set_preamble_seen(0);
                self.checksum_or_next = self.held;
                return found;
            }
            Found::BadChecksum => &mut self.counters.bad_checksum,
            Found::Oversize => &mut self.counters.oversize,
        };
        *count = count.saturating_add(1);
        self.give_up_frame();
        found
    }

    /// Rejects the frame being received: drops its first byte and queues all others for a scan, starting with the two
    /// remaining preamble bytes.
    // Not inlined: called from three places, none of them time-critical.
    #[inline(never)]
    fn give_up_frame(&mut self) {
        self.drop_bytes(1);
        self.set_preamble_seen(2);
        self.checksum_or_next = 0;
        self.flags |= DRAINING;
    }

    /// Builds the event for the caller, with a view of the payload. Its bytes are at the front of the store.
    // Not inlined: called from five places, none of them time-critical.
    #[inline(never)]
    fn event(&self, found: Found) -> Option<Event<'_>> {
        let [id, low, high] = self.store.head;
        let size = u16::from_le_bytes([low, high]);
        Some(match found {
            Found::Frame => Event::Frame(Frame { id, payload: self.store.body.get(..size as usize)? }),
            Found::BadChecksum => Event::BadChecksum { id, size },
            Found::Oversize => Event::Oversize { id, size },
        })
    }

    const fn is_draining(&self) -> bool {
        self.flags & DRAINING != 0
    }

    const fn preamble_seen(&self) -> u8 {
        self.flags & PREAMBLE_MASK
    }

    fn set_preamble_seen(&mut self, seen: u8) {
        self.flags = (self.flags & !PREAMBLE_MASK) | (seen & PREAMBLE_MASK);
    }

    fn drop_bytes(&mut self, count: u16) {
        self.counters.dropped = self.counters.dropped.saturating_add(count);
    }

    /// Takes a run of payload bytes, or the complete head of a frame, at once. Returns the bytes that follow.
    #[inline]
    fn take_run<'b>(&mut self, bytes: &'b [u8]) -> &'b [u8] {
        match self.preamble_seen() {
            IN_FRAME => self.take_payload(bytes),
            0 => self.take_head(bytes),
            _ => bytes,
        }
    }

    #[inline]
    fn take_payload<'b>(&mut self, bytes: &'b [u8]) -> &'b [u8] {
        let held = self.held as usize;
        let done = held.wrapping_sub(HEAD_LEN);
        let size = self.store.size();
        if done >= size {
            return bytes;
        }
        let room = self.store.body.get_mut(done..size).unwrap_or(&mut []);
        let count = room.len().min(bytes.len());
        let (taken, rest) = bytes.split_at_checked(count).unwrap_or((&[], bytes));
        self.checksum_or_next = checksum::push_copied(self.checksum_or_next, taken, room);
        self.held = held.wrapping_add(count) as u16;
        rest
    }

    #[inline]
    fn take_head<'b>(&mut self, bytes: &'b [u8]) -> &'b [u8] {
        let [PREAMBLE_BYTE, PREAMBLE_BYTE, PREAMBLE_BYTE, id, low, high, rest @ ..] = bytes else {
            return bytes;
        };
        if u16::from_le_bytes([*low, *high]) as usize > N {
            return bytes;
        }
        self.store.head = [*id, *low, *high];
        self.flags |= IN_FRAME;
        self.held = HEAD_LEN as u16;
        self.checksum_or_next = checksum::push_slice(checksum::AFTER_PREAMBLE, &self.store.head);
        rest
    }
}

/// Storage for the head, payload and checksum of the longest frame.
///
/// Stable Rust cannot express the array length N + 5, so there are three arrays. In this order they are contiguous, so
/// an index becomes an address after one comparison.
#[derive(Clone, Debug)]
#[repr(C)]
struct Store<const N: usize> {
    head: [u8; HEAD_LEN],
    body: [u8; N],
    tail: [u8; TAIL_LEN],
}

impl<const N: usize> Store<N> {
    /// Returns the payload size announced by the frame at the front.
    #[inline]
    fn size(&self) -> usize {
        let [_, low, high] = self.head;
        u16::from_le_bytes([low, high]) as usize
    }

    /// Returns the byte at index `at`.
    #[inline]
    fn get(&self, at: usize) -> u8 {
        let slot = match at.checked_sub(HEAD_LEN) {
            None => self.head.get(at),
            Some(at) => match at.checked_sub(N) {
                None => self.body.get(at),
                Some(at) => self.tail.get(at),
            },
        };
        slot.copied().unwrap_or(0)
    }

    /// Stores a byte at index `at`.
    #[inline]
    fn put(&mut self, at: usize, byte: u8) {
        let slot = match at.checked_sub(HEAD_LEN) {
            None => self.head.get_mut(at),
            Some(at) => match at.checked_sub(N) {
                None => self.body.get_mut(at),
                Some(at) => self.tail.get_mut(at),
            },
        };
        if let Some(slot) = slot {
            *slot = byte;
        }
    }
}

/// Hashes the current state only: parsers that will process the same input in the same way are equal. Counters are
/// ignored.
impl<const N: usize> Hash for FrameParser<N> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        state.write_u8(self.flags);
        if self.is_mid_frame() {
            state.write_u16(self.checksum_or_next);
            state.write_u16(self.held);
            (0..usize::from(self.held)).for_each(|at| state.write_u8(self.store.get(at)));
        }
    }
}

impl<const N: usize> Default for FrameParser<N> {
    fn default() -> Self {
        Self::new()
    }
}

const _: () = assert!(size_of::<FrameParser<64>>() == 64 + 16, "the parser must take N + 16 bytes");

#[cfg(test)]
mod tests;
