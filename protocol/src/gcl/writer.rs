//! Writes a line to a slice of bytes.

use super::ParseError;
use core::fmt::{Error, Result as Written, Write};

/// The reason why a line was not written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum LineError {
    /// The recipient could not parse the line.
    Invalid(ParseError),
    /// The line is longer than the slice.
    BufferTooSmall,
}

impl core::fmt::Display for LineError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> Written {
        match self {
            Self::Invalid(mistake) => mistake.fmt(f),
            Self::BufferTooSmall => f.write_str("buffer too small"),
        }
    }
}

impl core::error::Error for LineError {}

/// The unused rest of a slice.
pub(super) struct Line<'b> {
    rest: &'b mut [u8],
}

impl Write for Line<'_> {
    fn write_str(&mut self, text: &str) -> Written {
        let rest = core::mem::take(&mut self.rest);
        let (target, rest) = rest.split_at_mut_checked(text.len()).ok_or(Error)?;
        target.copy_from_slice(text.as_bytes());
        self.rest = rest;
        Ok(())
    }
}

/// Writes a line and its end (LF) to the start of `buffer`. Returns its length in bytes.
pub(super) fn write_line(
    buffer: &mut [u8],
    write: impl FnOnce(&mut Line<'_>) -> Written,
) -> Result<usize, LineError> {
    let room = buffer.len();
    let mut line = Line { rest: buffer };
    let written = write(&mut line).and_then(|()| line.write_char('\n'));
    written.map_err(|_| LineError::BufferTooSmall)?;
    Ok(room.saturating_sub(line.rest.len()))
}
