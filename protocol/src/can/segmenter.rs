//! Divides the bytes of messages into the data of CAN frames.

use embedded_can::{Frame, StandardId};

use super::FULL;
use crate::checksum;
use crate::frame::{OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};

/// The data of one CAN frame, 1 to 8 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Segment {
    bytes: [u8; FULL],
    len: u8,
}

/// Filler byte for spoilt segments. In the high bytes of a float it gives 3.4e38, which exceeds every limit and, unlike
/// a NaN, compares greater.
const SPOILT: u8 = 0x7F;

impl Segment {
    const EMPTY: Self = Self { bytes: [0; FULL], len: 0 };

    /// Returns the data bytes of the segment.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.bytes.get(..self.len.into()).unwrap_or(&[])
    }

    /// Returns the data frame with this identifier, or `None` if the frame type rejects it, which none should.
    #[must_use]
    pub fn frame<F: Frame>(&self, id: StandardId) -> Option<F> {
        F::new(id, self.data())
    }

    /// Invalidates the remaining segments of an aborted message of which earlier segments were sent. They must still be
    /// sent: the receiver expects as many bytes as the size field states, and would take the next message as the
    /// remainder.
    ///
    /// All bytes become 7Fh. Each width and speed with an unsent high byte then exceeds every limit, for a gripper that
    /// does not evaluate checksums (command set, 1.4.1). The last byte of the message (`is_last`) makes the checksum
    /// wrong, whether the gripper compares the checksum or computes 0 over the whole message.
    ///
    /// `checksum` is the [running value](crate::checksum) over all bytes sent before the segment. Returns the running
    /// value after it.
    ///
    /// ```
    /// use wsg_protocol::can::Segments;
    /// use wsg_protocol::checksum::{START, push_slice};
    /// use wsg_protocol::{Command, FrameEncoder, HomingDirection};
    ///
    /// let homing = Command::Homing { direction: HomingDirection::Positive };
    /// let mut segments = Segments::new(FrameEncoder::new(homing.id().code(), homing));
    /// let [sent, mut last] = [segments.next().unwrap(), segments.next().unwrap()];
    /// let running = push_slice(START, sent.data());
    /// assert_eq!(push_slice(running, last.data()), 0);
    /// assert_ne!(last.spoil(running, true), 0);
    /// ```
    pub fn spoil(&mut self, checksum: u16, is_last: bool) -> u16 {
        let bytes = self.bytes.get_mut(..usize::from(self.len)).unwrap_or_default();
        bytes.fill(SPOILT);
        let running = checksum::push_slice(checksum, bytes);
        if let (true, 0, Some(end)) = (is_last, running, bytes.last_mut()) {
            // Only one value of the last byte leads to 0, so any other one makes the checksum wrong.
            *end = !SPOILT;
            return checksum::push_slice(checksum, bytes);
        }
        running
    }

    /// Appends a byte and returns whether the segment is full.
    fn append(&mut self, byte: u8) -> bool {
        if let Some(place) = self.bytes.get_mut(usize::from(self.len)) {
            *place = byte;
            self.len = self.len.saturating_add(1);
        }
        usize::from(self.len) == FULL
    }
}

/// Divides a stream of message bytes into segments, as from a writer. The segmenter reads the end of each message from
/// its size field, so each message begins a new CAN frame.
///
/// To abort a message before its last byte, call [`reset`](Self::reset). Otherwise the bytes of the next message would
/// be taken as the remainder.
///
/// ```
/// use wsg_protocol::can::Segmenter;
/// use wsg_protocol::{Command, FrameEncoder};
///
/// let mut segmenter = Segmenter::new();
/// let grip = Command::GripPart { width: 20.0, speed: 50.0 };
/// let cut: Vec<usize> = FrameEncoder::new(grip.id().code(), grip)
///     .chain(FrameEncoder::new(0x22, Command::Stop))
///     .filter_map(|byte| segmenter.push(byte))
///     .map(|segment| segment.data().len())
///     .collect();
/// assert_eq!(cut, [8, 8, 8]);
/// ```
#[derive(Clone, Debug)]
pub struct Segmenter {
    /// Index of the next byte in its message.
    at: u32,
    /// The size field, as far as received.
    size: [u8; 2],
    filling: Segment,
}

impl Segmenter {
    /// Creates a segmenter that expects the first byte of a message.
    #[must_use]
    pub const fn new() -> Self {
        Self { at: 0, size: [0; 2], filling: Segment::EMPTY }
    }

    /// Takes the next byte and returns the segment that it completes. Discards bytes outside a message until a preamble
    /// begins, because only a message has a size field and thus an end.
    pub fn push(&mut self, byte: u8) -> Option<Segment> {
        if self.at < PREAMBLE_LEN as u32 && byte != PREAMBLE_BYTE {
            self.reset();
            return None;
        }
        match self.at {
            SIZE_LOW_AT => self.size = [byte, 0],
            SIZE_HIGH_AT => self.size = [self.size[0], byte],
            _ => {}
        }
        self.at = self.at.wrapping_add(1);
        let is_full = self.filling.append(byte);
        // Before the size field is known, this is not the end either: the overhead alone fills one segment.
        let message_len = u32::from(u16::from_le_bytes(self.size)).wrapping_add(OVERHEAD as u32);
        let is_last = self.at == message_len;
        if !is_full && !is_last {
            return None;
        }
        let segment = core::mem::replace(&mut self.filling, Segment::EMPTY);
        if is_last {
            self.reset();
        }
        Some(segment)
    }

    /// Returns whether a message has begun and its last byte is outstanding.
    #[must_use]
    pub const fn is_mid_message(&self) -> bool {
        self.at != 0
    }

    /// Aborts the current message. The next byte begins a new one.
    pub const fn reset(&mut self) {
        *self = Self::new();
    }
}

/// Indices of the two bytes of the size field in a message.
const SIZE_LOW_AT: u32 = 4;
const SIZE_HIGH_AT: u32 = 5;

impl Default for Segmenter {
    fn default() -> Self {
        Self::new()
    }
}

/// An iterator over the segments of messages from a byte iterator, such as a [`FrameEncoder`](crate::FrameEncoder). The
/// bytes of an incomplete last segment are discarded.
///
/// ```
/// use wsg_protocol::can::Segments;
/// use wsg_protocol::{CommandId, FrameEncoder, Reply, Status};
///
/// let reply = FrameEncoder::new(0x25, Reply::status_only(CommandId::GripPart, Status::CmdPending));
/// let mut segments = Segments::new(reply);
/// assert_eq!(segments.next().unwrap().data(), [0xAA, 0xAA, 0xAA, 0x25, 0x02, 0x00, 0x1A, 0x00]);
/// assert_eq!(segments.next().unwrap().data(), [0x6D, 0x48]);
/// assert!(segments.next().is_none());
/// ```
#[derive(Clone, Debug)]
pub struct Segments<I> {
    bytes: I,
    segmenter: Segmenter,
}

impl<I: Iterator<Item = u8>> Segments<I> {
    /// Creates an iterator over the segments of `bytes`.
    pub const fn new(bytes: I) -> Self {
        Self { bytes, segmenter: Segmenter::new() }
    }
}

impl<I: Iterator<Item = u8>> Iterator for Segments<I> {
    type Item = Segment;

    fn next(&mut self) -> Option<Segment> {
        loop {
            let byte = self.bytes.next()?;
            if let Some(segment) = self.segmenter.push(byte) {
                return Some(segment);
            }
        }
    }
}
