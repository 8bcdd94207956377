//! From bytes, one at a time or in slices, to intact frames.
//!
//! What the parser delivers is what a reader with the whole recording would find: try a frame at the first byte; when
//! it proves false (size over the limit, wrong checksum) go on one byte further, never skipping what the false frame
//! held. So noise, a false preamble or a truncated frame costs at most the messages it belongs to.

use core::hash::{Hash, Hasher};

use super::{Frame, PREAMBLE_BYTE};
use crate::checksum;

/// Bytes between preamble and payload: id and size.
const HEAD_LEN: usize = 3;
/// Bytes behind the payload: the checksum.
const TAIL_LEN: usize = 2;

/// Whether slices are taken in bulk; else byte by byte. The feature `small-table` is for programs that save flash.
const IN_BULK: bool = cfg!(not(feature = "small-table"));

/// What the parser found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct FrameCounters {
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
// What is used for each byte comes first, near enough for short instructions.
#[repr(C)]
pub struct FrameParser<const N: usize> {
    /// How many bytes are held.
    held: u16,
    /// The running checksum; while draining, the index of the held byte to scan next.
    checksum_or_next: u16,
    counters: FrameCounters,
    /// Preamble bytes seen (0 to 3), and the switches.
    flags: u8,
    /// Held bytes, without the preamble: those of the frame being received, from its id on; or, while draining, those
    /// that wait to be scanned.
    store: Store<N>,
}

/// Part of `flags`: preamble bytes seen.
const PREAMBLE_MASK: u8 = 0b11;
/// All of them: behind a preamble.
const IN_FRAME: u8 = PREAMBLE_MASK;
/// Part of `flags`: held bytes wait to be scanned (an event interrupted that).
const DRAINING: u8 = 0b0100;
/// Part of `flags`: frames are taken whatever their checksum.
const IGNORE_CHECKSUM: u8 = 0b1000;

/// What a byte completed.
#[derive(Clone, Copy, PartialEq)]
enum Found {
    Frame,
    BadChecksum,
    Oversize,
}

impl<const N: usize> FrameParser<N> {
    /// A parser that holds nothing.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N <= 65_530, "the size field counts to 65 535, and header and checksum are held as well") };
        Self {
            held: 0,
            checksum_or_next: 0,
            counters: FrameCounters { dropped: 0, bad_checksum: 0, oversize: 0 },
            flags: 0,
            store: Store { head: [0; HEAD_LEN], body: [0; N], tail: [0; TAIL_LEN] },
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
    pub const fn counters(&self) -> FrameCounters {
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
        // Inlined up to here: most bytes are payload, and an event is only made where there is one.
        if self.flags & (DRAINING | PREAMBLE_MASK) == IN_FRAME && self.take_payload_byte(byte) {
            return None;
        }
        let found = self.step(byte)?;
        self.event(found)
    }

    /// Takes bytes up to the first event, and says how many that were. The same events as [`push`](Self::push) byte
    /// by byte. With an empty slice it is [`poll`](Self::poll).
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

    /// The next event about bytes already taken.
    pub fn poll(&mut self) -> Option<Event<'_>> {
        let found = self.drain()?;
        self.event(found)
    }

    /// Gives up the frame being received because its rest does not come, and scans what it held again. Call until it
    /// gives `None`; then nothing is held any more.
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

    /// Forgets what is held; the bytes count as dropped.
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

    /// One byte into the state machine, behind those that wait to be scanned; up to the next event.
    fn step(&mut self, byte: u8) -> Option<Found> {
        if self.is_draining() { self.step_behind(byte) } else { self.receive(byte) }
    }

    /// The same while bytes wait.
    #[cold]
    fn step_behind(&mut self, byte: u8) -> Option<Found> {
        let found = self.drain();
        self.receive_after(found, byte)
    }

    /// Scans the bytes that wait, up to the next event or to their end, by receiving them once more. Each comes to lie
    /// where it was or nearer the front; those behind the event wait on.
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

    /// One byte into the state machine; behind an event, one more that waits. There is room: to find an event, a drain
    /// has used up at least one byte.
    fn receive_after(&mut self, found: Option<Found>, byte: u8) -> Option<Found> {
        if found.is_none() {
            return self.receive(byte);
        }
        self.store.put(self.held as usize, byte);
        self.held = self.held.wrapping_add(1);
        self.flags |= DRAINING;
        found
    }

    /// One byte into the state machine, while none waits.
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

    /// One byte behind a preamble.
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

    /// One byte of payload behind a preamble; whether it is.
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

    /// A byte of the checksum.
    fn end(&mut self, at: usize, byte: u8) -> Option<Found> {
        self.store.put(at, byte);
        if at == HEAD_LEN.wrapping_add(self.store.size()) {
            return None;
        }
        // The manual lets a receiver take the two bytes in as well and look for 0. But four different pairs of bytes
        // lead to 0 from any value, so comparing lets through a quarter of the corruptions that looking for 0 would.
        let received = u16::from_le_bytes([self.store.get(at.wrapping_sub(1)), byte]);
        let accepted = received == self.checksum_or_next || self.flags & IGNORE_CHECKSUM != 0;
        Some(self.dispatch(if accepted { Found::Frame } else { Found::BadChecksum }))
    }

    /// One byte outside a frame.
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

    /// Ends the frame being received. If more bytes are held, they wait from behind it on.
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

    /// The frame being received is none: its first byte is dropped, and all others wait to be scanned, beginning with
    /// the two preamble bytes that are left.
    // Three functions give up, and none of them is in a hurry then.
    #[inline(never)]
    fn give_up_frame(&mut self) {
        self.drop_bytes(1);
        self.set_preamble_seen(2);
        self.checksum_or_next = 0;
        self.flags |= DRAINING;
    }

    /// The event to hand out, with its view of the payload. What it is about lies at the front of the store.
    // Not inlined: five functions give events, and none of them is in a hurry once there is one.
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

    /// Takes payload bytes of the frame being received, or the whole beginning of a frame, at one go; gives the bytes
    /// behind them.
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

/// Head, payload and checksum of the longest frame.
///
/// Three arrays, because the sum N + 5 is none of stable Rust's array lengths. In this order they lie one behind the
/// other, so an index becomes an address after one comparison.
#[derive(Clone, Debug)]
#[repr(C)]
struct Store<const N: usize> {
    head: [u8; HEAD_LEN],
    body: [u8; N],
    tail: [u8; TAIL_LEN],
}

impl<const N: usize> Store<N> {
    /// The payload size announced by the frame at the front.
    #[inline]
    fn size(&self) -> usize {
        let [_, low, high] = self.head;
        u16::from_le_bytes([low, high]) as usize
    }

    /// The byte at `at`.
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

/// By what is held and not by what was: parsers that take the same bytes in the same way from now on are alike. Counts do
/// not matter.
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

const _: () = assert!(size_of::<FrameParser<64>>() == 64 + 16, "the parser's memory is N + 16 bytes");

#[cfg(test)]
mod tests;
