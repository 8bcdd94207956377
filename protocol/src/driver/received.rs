//! Bytes that a transport has read and the driver has not yet taken.

use std::io::{self, ErrorKind};

/// A read buffer, refilled only when empty.
#[derive(Debug)]
pub(super) struct Received<const N: usize> {
    bytes: [u8; N],
    at: usize,
    len: usize,
    /// Whether the peer has closed the connection.
    has_ended: bool,
}

impl<const N: usize> Received<N> {
    pub(super) const fn new() -> Self {
        Self { bytes: [0; N], at: 0, len: 0, has_ended: false }
    }

    /// Returns whether neither bytes nor the end of the stream are pending.
    pub(super) const fn is_empty(&self) -> bool {
        self.at >= self.len && !self.has_ended
    }

    /// Returns the number of bytes of the last read.
    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// Returns the space for the next read.
    pub(super) const fn space(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    /// Records a read of `len` bytes; 0 means that the peer has closed the connection.
    pub(super) const fn filled(&mut self, len: usize) {
        (self.at, self.len) = (0, len);
        self.has_ended = len == 0;
    }

    /// Reads if nothing is pending, and returns whether something is now. No input is not an error.
    pub(super) fn fill(&mut self, read: impl FnOnce(&mut [u8]) -> io::Result<usize>) -> io::Result<bool> {
        use ErrorKind::{Interrupted, TimedOut, WouldBlock};
        if self.is_empty() {
            match read(self.space()) {
                Ok(len) => self.filled(len),
                Err(error) if matches!(error.kind(), WouldBlock | TimedOut | Interrupted) => {
                    return Ok(false);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }

    /// Moves as many bytes as fit to `buffer` and returns their number.
    pub(super) fn take(&mut self, buffer: &mut [u8]) -> usize {
        let held = self.bytes.get(self.at..self.len).unwrap_or(&[]);
        let count = held.len().min(buffer.len());
        for (slot, byte) in buffer.iter_mut().zip(held) {
            *slot = *byte;
        }
        self.at = self.at.saturating_add(count);
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moves pending bytes to a buffer of two.
    fn take(received: &mut Received<4>) -> ([u8; 2], usize) {
        let mut buffer = [0; 2];
        let count = received.take(&mut buffer);
        (buffer, count)
    }

    #[test]
    fn bytes_are_taken_once_before_the_next_read() {
        let mut received = Received::<4>::new();
        assert!(received.is_empty());
        let read = |bytes: &mut [u8]| {
            bytes.copy_from_slice(&[1, 2, 3, 9]);
            Ok(3)
        };
        assert!(received.fill(read).unwrap());
        assert_eq!(received.len(), 3);
        assert_eq!(take(&mut received), ([1, 2], 2));
        assert!(received.fill(|_| panic!("a byte is pending")).unwrap());
        assert_eq!(take(&mut received), ([3, 0], 1));
        assert!(received.is_empty());
        assert!(received.fill(|_| Ok(0)).unwrap());
        assert!(!received.is_empty(), "the end is pending");
        assert_eq!(take(&mut received), ([0, 0], 0));
    }

    #[test]
    fn no_input_is_not_an_error_and_a_broken_line_is() {
        let mut received = Received::<4>::new();
        for kind in [ErrorKind::WouldBlock, ErrorKind::TimedOut, ErrorKind::Interrupted] {
            assert!(!received.fill(|_| Err(kind.into())).unwrap());
        }
        let reset = ErrorKind::ConnectionReset;
        assert_eq!(received.fill(|_| Err(reset.into())).unwrap_err().kind(), reset);
        assert!(received.is_empty());
    }
}
