//! From bytes, one at a time or in slices, to intact frames.
//!
//! What the parser delivers is what a reader with the whole recording would find: try a frame at the first byte; when
//! it proves false (size over the limit, wrong checksum) go on one byte further, never skipping what the false frame
//! held. So noise, a false preamble or a truncated frame costs at most the messages it belongs to.

use super::{Frame, PREAMBLE_BYTE};
use crate::checksum;

/// Bytes between preamble and payload: id and size.
const HEAD_LEN: usize = 3;
/// Bytes behind the payload: the checksum.
const TAIL_LEN: usize = 2;

/// What the parser found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event<'a> {
    /// An intact frame.
    Frame(Frame<'a>),
    /// A whole frame whose checksum is wrong. Its bytes are scanned again for frames.
    BadChecksum {
        /// The id it showed.
        id: u8,
        /// The payload length it showed.
        size: u16,
    },
    /// A frame that announced more payload than the parser holds. Its bytes are scanned again for frames.
    Oversize {
        /// The id it showed.
        id: u8,
        /// The payload length it announced.
        size: u16,
    },
}

/// What a parser has refused so far; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Bytes that belonged to no intact frame.
    pub dropped: u16,
    /// Frames with a wrong checksum.
    pub bad_checksum: u16,
    /// Frames that announced more payload than the parser holds.
    pub oversize: u16,
}

/// Finds frames of up to `N` bytes of payload in a byte stream. It takes N + 16 bytes of memory (N even), all zero
/// after [`new`](Self::new).
///
/// Bytes go in by [`push`](Self::push) or [`push_slice`](Self::push_slice). After an event there may be more to tell
/// about bytes already taken: [`poll`](Self::poll) until it gives `None`. How long half a frame is waited for is the
/// caller's to say, by [`expire`](Self::expire).
///
/// Work per call is bounded: a byte that belongs to the frame being received costs one table look-up; a false frame
/// costs a new scan of at most N + 5 held bytes, in which each false preamble costs at most the bytes behind it.
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
pub struct FrameParser<const N: usize> {
    /// Held bytes, without the preamble: those of the frame being received, from its id on; or, while draining, those
    /// that wait to be scanned.
    head: [u8; HEAD_LEN],
    body: [u8; N],
    tail: [u8; TAIL_LEN],
    /// Preamble bytes seen (0 to 3), and the switches.
    flags: u8,
    /// How many bytes are held.
    held: u16,
    /// The running checksum; while draining, the index of the held byte to scan next.
    checksum_or_next: u16,
    counters: Counters,
}

/// Part of `flags`: preamble bytes seen.
const PREAMBLE_MASK: u8 = 0b11;
/// Part of `flags`: held bytes wait to be scanned (an event interrupted that).
const DRAINING: u8 = 0b0100;
/// Part of `flags`: frames are taken whatever their checksum.
const IGNORE_CHECKSUM: u8 = 0b1000;

/// What a scan of the held bytes came to.
enum Found {
    Frame { payload_at: usize, size: usize },
    BadChecksum { id: u8, size: u16 },
    Oversize { id: u8, size: u16 },
}

impl<const N: usize> FrameParser<N> {
    /// The most bytes that are ever held.
    const CAPACITY: usize = {
        assert!(N <= 65_530, "the size field counts to 65 535, and header and checksum are held as well");
        N.wrapping_add(HEAD_LEN).wrapping_add(TAIL_LEN)
    };

    /// A parser that holds nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            head: [0; HEAD_LEN],
            body: [0; N],
            tail: [0; TAIL_LEN],
            flags: 0,
            held: 0,
            checksum_or_next: 0,
            counters: Counters { dropped: 0, bad_checksum: 0, oversize: 0 },
        }
    }

    /// A parser that takes frames whatever their checksum, for a peer whose checksum evaluation is off (command set,
    /// 1.4.1). Such a stream has no protection: only the exact checks of the typed layer are left.
    #[must_use]
    pub const fn ignoring_checksums() -> Self {
        let mut parser = Self::new();
        parser.flags = IGNORE_CHECKSUM;
        parser
    }

    /// What has been refused so far.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Whether part of a frame is held, so that a time-out should run.
    #[must_use]
    pub const fn is_mid_frame(&self) -> bool {
        self.flags & (PREAMBLE_MASK | DRAINING) != 0
    }

    /// Takes one byte.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Event<'_>> {
        let found = self.step(byte)?;
        self.event(found)
    }

    /// Takes bytes up to the first event, and says how many that were. The same events as [`push`](Self::push) byte
    /// by byte. With an empty slice it is [`poll`](Self::poll).
    pub fn push_slice(&mut self, bytes: &[u8]) -> (usize, Option<Event<'_>>) {
        if self.is_draining()
            && let Some(found) = self.scan()
        {
            return (0, self.event(found));
        }
        let mut taken = 0usize;
        let mut found = None;
        while found.is_none() {
            let rest = bytes.get(taken..).unwrap_or(&[]);
            let Some((&byte, _)) = rest.split_first() else { break };
            let bulk = self.take_payload(rest);
            if bulk > 0 {
                taken = taken.wrapping_add(bulk);
            } else {
                found = self.step(byte);
                taken = taken.wrapping_add(1);
            }
        }
        match found {
            Some(found) => (taken, self.event(found)),
            None => (taken, None),
        }
    }

    /// The next event about bytes already taken.
    pub fn poll(&mut self) -> Option<Event<'_>> {
        if !self.is_draining() {
            return None;
        }
        let found = self.scan()?;
        self.event(found)
    }

    /// Gives up the frame being received because its rest does not come, and scans what it held again. Call until it
    /// gives `None`; then nothing is held any more.
    pub fn expire(&mut self) -> Option<Event<'_>> {
        loop {
            if self.is_draining()
                && let Some(found) = self.scan()
            {
                return self.event(found);
            }
            match self.preamble_seen() {
                0 => return None,
                3 => self.give_up_frame(0, self.held as usize),
                seen => {
                    self.drop_bytes(seen as usize);
                    self.set_preamble_seen(0);
                }
            }
        }
    }

    /// Forgets what is held; the bytes count as dropped.
    pub fn reset(&mut self) {
        let waiting =
            if self.is_draining() { self.held.saturating_sub(self.checksum_or_next) } else { self.held };
        self.drop_bytes((self.preamble_seen() as usize).wrapping_add(waiting as usize));
        self.flags &= IGNORE_CHECKSUM;
        self.held = 0;
    }

    /// One byte into the state machine.
    #[inline]
    fn step(&mut self, byte: u8) -> Option<Found> {
        if self.flags & (PREAMBLE_MASK | DRAINING) == PREAMBLE_MASK {
            return self.step_in_frame(byte);
        }
        if self.is_draining() {
            self.append(byte);
            return self.scan();
        }
        self.step_preamble(byte);
        None
    }

    /// One byte while the preamble is looked for.
    #[inline]
    fn step_preamble(&mut self, byte: u8) {
        let seen = self.preamble_seen();
        if byte == PREAMBLE_BYTE {
            self.set_preamble_seen(seen.wrapping_add(1));
            self.held = 0;
            self.checksum_or_next = checksum::AFTER_PREAMBLE;
        } else {
            self.drop_bytes((seen as usize).wrapping_add(1));
            self.set_preamble_seen(0);
        }
    }

    /// One byte behind a preamble.
    #[inline]
    fn step_in_frame(&mut self, byte: u8) -> Option<Found> {
        let at = self.held as usize;
        self.put(at, byte);
        let held = at.wrapping_add(1);
        self.held = held as u16;
        if at < HEAD_LEN {
            self.checksum_or_next = checksum::push(self.checksum_or_next, byte);
            let size = self.head_size();
            return if held == HEAD_LEN && size > N { Some(self.oversize(0, held)) } else { None };
        }
        let size = self.head_size();
        let checksum_at = HEAD_LEN.wrapping_add(size);
        if at < checksum_at {
            self.checksum_or_next = checksum::push(self.checksum_or_next, byte);
            return None;
        }
        if held < checksum_at.wrapping_add(TAIL_LEN) {
            return None;
        }
        if self.accepts(self.checksum_or_next, checksum_at) {
            self.set_preamble_seen(0);
            self.held = 0;
            return Some(Found::Frame { payload_at: 0, size });
        }
        Some(self.bad_checksum(0, held))
    }

    /// Whether the two bytes held at `at` are this checksum, low byte first.
    ///
    /// The manual lets a receiver take them in as well and look for 0. But four different pairs of bytes lead to 0 from
    /// any value, so comparing lets through a quarter of the corruptions that looking for 0 would.
    #[inline]
    fn accepts(&self, checksum: u16, at: usize) -> bool {
        let received = u16::from_le_bytes([self.get(at), self.get(at.wrapping_add(1))]);
        received == checksum || self.flags & IGNORE_CHECKSUM != 0
    }

    /// Copies payload bytes of the frame being received at one go; how many.
    #[inline]
    fn take_payload(&mut self, bytes: &[u8]) -> usize {
        let held = self.held as usize;
        if self.flags & (PREAMBLE_MASK | DRAINING) != PREAMBLE_MASK || held < HEAD_LEN {
            return 0;
        }
        let done = held.wrapping_sub(HEAD_LEN);
        let size = self.head_size();
        let room = self.body.get_mut(done..size).unwrap_or(&mut []);
        let count = room.len().min(bytes.len());
        let mut value = self.checksum_or_next;
        for (slot, &byte) in room.iter_mut().zip(bytes) {
            *slot = byte;
            value = checksum::push(value, byte);
        }
        self.checksum_or_next = value;
        self.held = held.wrapping_add(count) as u16;
        count
    }

    /// Scans held bytes from the marked one on, in place, up to the next event or to their end. A frame that begins
    /// there and is not yet whole is moved to the front, and reception goes on behind it.
    fn scan(&mut self) -> Option<Found> {
        let end = self.held as usize;
        let mut next = self.checksum_or_next as usize;
        let mut seen = self.preamble_seen();
        while seen < 3 && next < end {
            if self.get(next) == PREAMBLE_BYTE {
                seen = seen.wrapping_add(1);
            } else {
                self.drop_bytes((seen as usize).wrapping_add(1));
                seen = 0;
            }
            next = next.wrapping_add(1);
        }
        self.set_preamble_seen(seen);
        let start = next;
        let available = end.wrapping_sub(start);
        if seen == 3 && available >= HEAD_LEN {
            let size = self.size_at(start);
            if size > N {
                return Some(self.oversize(start, end));
            }
            let whole = HEAD_LEN.wrapping_add(size).wrapping_add(TAIL_LEN);
            if available >= whole {
                let behind = start.wrapping_add(whole);
                let checksum_at = behind.wrapping_sub(TAIL_LEN);
                if !self.accepts(self.checksum_of(start, checksum_at), checksum_at) {
                    return Some(self.bad_checksum(start, end));
                }
                self.set_preamble_seen(0);
                self.drain_from(behind, end);
                return Some(Found::Frame { payload_at: start, size });
            }
        }
        self.flags &= !DRAINING;
        for at in start..end {
            let byte = self.get(at);
            self.put(at.wrapping_sub(start), byte);
        }
        self.held = available as u16;
        // The checksum itself is not part of what it is taken over.
        let summed = if available < HEAD_LEN {
            available
        } else {
            available.min(HEAD_LEN.wrapping_add(self.head_size()))
        };
        self.checksum_or_next = self.checksum_of(0, summed);
        None
    }

    /// The checksum of a frame's preamble and the bytes held from `start` to `end`.
    fn checksum_of(&self, start: usize, end: usize) -> u16 {
        (start..end).fold(checksum::AFTER_PREAMBLE, |value, at| checksum::push(value, self.get(at)))
    }

    /// The frame whose id is held at `start` announces too much.
    fn oversize(&mut self, start: usize, end: usize) -> Found {
        self.counters.oversize = self.counters.oversize.saturating_add(1);
        let found = Found::Oversize { id: self.get(start), size: self.size_at(start) as u16 };
        self.give_up_frame(start, end);
        found
    }

    /// The frame whose id is held at `start` is whole, and its checksum wrong.
    fn bad_checksum(&mut self, start: usize, end: usize) -> Found {
        self.counters.bad_checksum = self.counters.bad_checksum.saturating_add(1);
        let found = Found::BadChecksum { id: self.get(start), size: self.size_at(start) as u16 };
        self.give_up_frame(start, end);
        found
    }

    /// The frame whose id is held at `start` is none: its first byte is dropped, and all others will be scanned again,
    /// beginning with the two preamble bytes that are left.
    fn give_up_frame(&mut self, start: usize, end: usize) {
        self.drop_bytes(1);
        self.set_preamble_seen(2);
        self.drain_from(start, end);
    }

    /// Marks the held bytes from `next` to `end` to be scanned.
    fn drain_from(&mut self, next: usize, end: usize) {
        self.flags |= DRAINING;
        self.checksum_or_next = next as u16;
        self.held = end as u16;
    }

    /// Puts a byte behind those that wait to be scanned.
    fn append(&mut self, byte: u8) {
        let mut end = self.held as usize;
        if end == Self::CAPACITY {
            // A full store never waits from its very first byte on: a frame that long was given up, and its id is
            // settled here (it opens a preamble or is dropped), which makes room for one byte.
            let mut next = self.checksum_or_next as usize;
            if next == 0 {
                let seen = self.preamble_seen();
                if self.get(0) == PREAMBLE_BYTE {
                    self.set_preamble_seen(seen.wrapping_add(1));
                } else {
                    self.drop_bytes((seen as usize).wrapping_add(1));
                    self.set_preamble_seen(0);
                }
                next = 1;
            }
            for at in next..end {
                let moved = self.get(at);
                self.put(at.wrapping_sub(next), moved);
            }
            end = end.wrapping_sub(next);
            self.checksum_or_next = 0;
        }
        self.put(end, byte);
        self.held = end.wrapping_add(1) as u16;
    }

    /// The event to hand out, with its view of the payload.
    #[inline]
    fn event(&self, found: Found) -> Option<Event<'_>> {
        Some(match found {
            Found::Frame { payload_at, size } => Event::Frame(Frame {
                id: self.get(payload_at),
                // The payload lies HEAD_LEN behind the id, so from the same index on in `body`; its checksum is held
                // behind it, so it ends inside.
                payload: self.body.get(payload_at..payload_at.wrapping_add(size))?,
            }),
            Found::BadChecksum { id, size } => Event::BadChecksum { id, size },
            Found::Oversize { id, size } => Event::Oversize { id, size },
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

    fn drop_bytes(&mut self, count: usize) {
        self.counters.dropped = self.counters.dropped.saturating_add(count.min(u16::MAX as usize) as u16);
    }

    /// The payload size announced by the frame at the front of the store.
    #[inline]
    fn head_size(&self) -> usize {
        let [_, low, high] = self.head;
        u16::from_le_bytes([low, high]) as usize
    }

    /// The payload size announced by the frame whose id is held at `start`.
    fn size_at(&self, start: usize) -> usize {
        let low = self.get(start.wrapping_add(1));
        let high = self.get(start.wrapping_add(2));
        u16::from_le_bytes([low, high]) as usize
    }

    /// The held byte at `at`.
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

    /// Stores a byte at `at`.
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

impl<const N: usize> Default for FrameParser<N> {
    fn default() -> Self {
        Self::new()
    }
}

const _: () = assert!(size_of::<FrameParser<64>>() == 64 + 16, "the parser's memory is N + 16 bytes");

#[cfg(test)]
#[path = "parser_tests.rs"]
mod tests;
