//! The answer of a line that would have to wait.

use embedded_io::{Error, ErrorKind};

/// No byte has come, there is no room for another, or not all have left.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WouldBlock;

/// The result of moving `count` bytes between a queue and a caller's buffer.
pub(crate) fn moved(count: usize, buf: &[u8]) -> Result<usize, WouldBlock> {
    if count == 0 && !buf.is_empty() { Err(WouldBlock) } else { Ok(count) }
}

impl core::fmt::Display for WouldBlock {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the line is not ready")
    }
}

impl core::error::Error for WouldBlock {}

impl Error for WouldBlock {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}
