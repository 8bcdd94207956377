//! What a transport has read and the driver has not taken yet.

use std::io::{self, ErrorKind};

/// A buffer of what was read; empty before the next read.
#[derive(Debug)]
pub(super) struct Received<const N: usize> {
    bytes: [u8; N],
    at: usize,
    len: usize,
    /// The other end has closed.
    has_ended: bool,
}

impl<const N: usize> Received<N> {
    pub(super) const fn new() -> Self {
        Self { bytes: [0; N], at: 0, len: 0, has_ended: false }
    }

    /// Whether there is nothing to take: no byte, and no end.
    pub(super) const fn is_empty(&self) -> bool {
        self.at >= self.len && !self.has_ended
    }

    /// How many bytes the last read had.
    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// Where the next bytes are read to.
    pub(super) const fn space(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    /// So many bytes were read; none: the other end has closed.
    pub(super) const fn filled(&mut self, len: usize) {
        (self.at, self.len) = (0, len);
        self.has_ended = len == 0;
    }

    /// Reads if there is nothing to take; whether there is something now. Silence is no error.
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

    /// Moves as much as fits to `buffer`; how much that was.
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
