//! Encodes a payload into the bytes of a frame without an intermediate buffer.

use super::{OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};
use crate::checksum;

/// A payload that is read byte by byte: a slice, a [`Command`](crate::Command) or a [`Reply`](crate::Reply).
pub trait Payload {
    /// Returns the length of the payload in bytes, at most 65 535.
    fn len(&self) -> usize;

    /// Returns the byte at `index`, or 0 at or past the end.
    fn byte(&self, index: usize) -> u8;

    /// Returns whether the payload is empty.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Payload for &[u8] {
    fn len(&self) -> usize {
        <[u8]>::len(self)
    }

    fn byte(&self, index: usize) -> u8 {
        self.get(index).copied().unwrap_or(0)
    }
}

/// An iterator over the bytes of one frame.
///
/// ```
/// use wsg_protocol::FrameEncoder;
///
/// let bytes: Vec<u8> = FrameEncoder::new(0x01, &[0x12, 0x34][..]).collect();
/// assert_eq!(bytes, [0xAA, 0xAA, 0xAA, 0x01, 0x02, 0x00, 0x12, 0x34, 0x6D, 0x66]);
/// ```
#[derive(Clone, Copy, Debug, Hash)]
pub struct FrameEncoder<P> {
    payload: P,
    /// Index of the next byte of the frame.
    next: u32,
    /// Running checksum; after the payload, the part of the checksum not yet sent.
    checksum: u16,
    id: u8,
}

/// The buffer passed to [`FrameEncoder::write_into`] is too short. Nothing was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct BufferTooSmall {
    /// Buffer length required, in bytes.
    pub needed: usize,
}

/// Index of the first payload byte in a frame.
const PAYLOAD_AT: usize = 6;

/// Bytes after the payload.
const CHECKSUM_LEN: usize = OVERHEAD - PAYLOAD_AT;

impl<P: Payload> FrameEncoder<P> {
    /// Creates an encoder for a frame with this command id and payload.
    pub const fn new(id: u8, payload: P) -> Self {
        Self { payload, next: 0, checksum: checksum::START, id }
    }

    /// Returns the command id of the frame.
    #[must_use]
    pub const fn id(&self) -> u8 {
        self.id
    }

    /// Returns the length of the whole frame in bytes, including the bytes already produced.
    pub fn frame_len(&self) -> usize {
        self.payload.len().saturating_add(OVERHEAD)
    }

    /// Writes the remaining bytes of the frame to the start of `buffer` and returns their number.
    ///
    /// # Errors
    /// Returns [`BufferTooSmall`] if the remaining bytes do not fit.
    pub fn write_into(self, buffer: &mut [u8]) -> Result<usize, BufferTooSmall> {
        let needed = self.len();
        let target = buffer.get_mut(..needed).ok_or(BufferTooSmall { needed })?;
        for (slot, byte) in target.iter_mut().zip(self) {
            *slot = byte;
        }
        Ok(needed)
    }

    /// Writes the remaining bytes of the frame to `writer` in chunks of at most 64 bytes.
    ///
    /// Use [`write_into`](Self::write_into) instead if the transport sends each write as a packet, such as TCP with
    /// `TCP_NODELAY`.
    ///
    /// # Errors
    /// Returns the first error of `writer`.
    #[cfg(feature = "embedded-io")]
    pub fn write_to<W: embedded_io::Write>(mut self, writer: &mut W) -> Result<(), W::Error> {
        let mut chunk = [0; 64];
        loop {
            let mut filled = 0usize;
            for (slot, byte) in chunk.iter_mut().zip(&mut self) {
                *slot = byte;
                filled = filled.saturating_add(1);
            }
            let mut bytes = chunk.get(..filled).unwrap_or(&[]);
            if bytes.is_empty() {
                return Ok(());
            }
            // `write_all` panics if the writer accepts no bytes. The contract forbids that; retry such a writer
            // instead.
            while !bytes.is_empty() {
                let taken = writer.write(bytes)?;
                bytes = bytes.get(taken..).unwrap_or(&[]);
            }
        }
    }
}

impl<P: Payload> Iterator for FrameEncoder<P> {
    type Item = u8;

    fn next(&mut self) -> Option<u8> {
        let len = self.payload.len();
        let [size_low, size_high, ..] = len.to_le_bytes();
        let end = len.wrapping_add(PAYLOAD_AT);
        let at = self.next as usize;
        let byte = if at < end {
            let byte = match at {
                0..PREAMBLE_LEN => PREAMBLE_BYTE,
                3 => self.id,
                4 => size_low,
                5 => size_high,
                _ => self.payload.byte(at.wrapping_sub(PAYLOAD_AT)),
            };
            self.checksum = checksum::push(self.checksum, byte);
            byte
        } else if at < end.wrapping_add(CHECKSUM_LEN) {
            let low = self.checksum as u8;
            self.checksum >>= 8;
            low
        } else {
            return None;
        };
        self.next = self.next.wrapping_add(1);
        Some(byte)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.frame_len().saturating_sub(self.next as usize);
        (left, Some(left))
    }
}

impl<P: Payload> ExactSizeIterator for FrameEncoder<P> {}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn size_counts_down_to_none() {
        let mut encoder = FrameEncoder::new(6, &[1, 2, 3][..]);
        assert_eq!((encoder.id(), encoder.len()), (6, 11));
        assert_eq!(encoder.by_ref().take(10).count(), 10);
        assert_eq!(encoder.len(), 1);
        assert!(encoder.next().is_some());
        assert_eq!((encoder.len(), encoder.next()), (0, None));
        assert_eq!(encoder.next(), None);
    }

    #[test]
    fn payload_is_empty_without_bytes_alone() {
        assert!(Payload::is_empty(&&[][..]));
        assert!(!Payload::is_empty(&&[0][..]));
    }

    #[test]
    fn slice_too_short_is_refused_whole() {
        let mut buffer = [0x55; 9];
        let refused = FrameEncoder::new(1, &[0x12, 0x34][..]).write_into(&mut buffer);
        assert_eq!(refused, Err(BufferTooSmall { needed: 10 }));
        assert_eq!(buffer, [0x55; 9]);
    }

    #[test]
    fn slice_and_iterator_agree_for_long_payloads() {
        let payload: Vec<u8> = (0..600u32).map(|n| n as u8).collect();
        let bytes: Vec<u8> = FrameEncoder::new(6, &payload[..]).collect();
        let mut buffer = [0; 700];
        let length = FrameEncoder::new(6, &payload[..]).write_into(&mut buffer).unwrap();
        assert_eq!(bytes, buffer[..length]);
        assert_eq!(bytes[4..6], [0x58, 0x02]);
        assert_eq!(checksum::of(&bytes), 0);
    }

    /// Accepts three bytes at a time, and none on every other call.
    #[cfg(feature = "embedded-io")]
    #[derive(Default)]
    struct Reluctant {
        taken: Vec<u8>,
        asked: usize,
    }

    #[cfg(feature = "embedded-io")]
    impl embedded_io::ErrorType for Reluctant {
        type Error = core::convert::Infallible;
    }

    #[cfg(feature = "embedded-io")]
    impl embedded_io::Write for Reluctant {
        fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
            self.asked += 1;
            let count = if self.asked.is_multiple_of(2) { 0 } else { bytes.len().min(3) };
            self.taken.extend_from_slice(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> Result<(), Self::Error> {
            Ok(())
        }
    }

    #[cfg(feature = "embedded-io")]
    #[test]
    fn writer_accepting_few_or_no_bytes_gets_every_byte_once() {
        let payload = [7u8; 150];
        let mut writer = Reluctant::default();
        FrameEncoder::new(6, &payload[..]).write_to(&mut writer).unwrap();
        let bytes: Vec<u8> = FrameEncoder::new(6, &payload[..]).collect();
        assert_eq!(writer.taken, bytes);
    }

    #[cfg(feature = "embedded-io")]
    #[test]
    fn writer_gets_every_byte_in_chunks() {
        let payload = [7u8; 150];
        let mut out = [0u8; 200];
        let mut rest = &mut out[..];
        FrameEncoder::new(6, &payload[..]).write_to(&mut rest).unwrap();
        let left = rest.len();
        let bytes: Vec<u8> = FrameEncoder::new(6, &payload[..]).collect();
        assert_eq!(out[..200 - left], bytes);
    }
}
