//! Splits a stream of bytes into lines (GCL, 1.2), and discards lines that are too long.

/// Maximum length of a line that a controller must accept, in bytes without the line end.
///
/// Grippers in the field send at most 1024 bytes at a time. Only `FDATA` of tactile fingers approaches that; a controller that
/// does not query it needs 256.
pub const MAX_LINE_LEN: usize = 1024;

/// An event of a [`LineReader`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum LineEvent<'a> {
    /// A line without its end, and without blanks and control characters before it and control characters after it. It is
    /// never empty.
    Line(&'a [u8]),
    /// A line exceeds the reader's capacity and the rest of it is discarded. Holds the start of the line.
    TooLong(&'a [u8]),
}

/// Counts of discarded input. Each count saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct LineCounters {
    /// Lines that were too long.
    pub too_long: u16,
    /// Bytes of such lines.
    pub dropped: u16,
}

/// Splits a stream of bytes into lines of up to `N` bytes. All its fields are zero after [`new`](Self::new).
///
/// A line ends with LF, CR or both: the manual prints LF with the code of CR, and terminals send either. Blank lines are
/// ignored. After a line that is too long, the next line is found again.
///
/// Control characters between lines are ignored: telnet sends CR NUL, and C programs send the NUL that ends a string. Inside
/// a line, they remain.
///
/// ```
/// use wsg_protocol::gcl::{LineEvent, LineReader};
///
/// let mut reader = LineReader::<16>::new();
/// let mut lines = vec![];
/// for byte in *b"home()\r\n\n  pos?\n" {
///     if let Some(LineEvent::Line(line)) = reader.push(byte) {
///         lines.push(line.to_vec());
///     }
/// }
/// assert_eq!(lines, [b"home()".to_vec(), b"pos?".to_vec()]);
/// ```
#[derive(Clone, Debug)]
pub struct LineReader<const N: usize> {
    buffer: [u8; N],
    len: usize,
    state: State,
    counters: LineCounters,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Collecting a line in the buffer.
    Reading = 0,
    /// The line in the buffer was reported, so the next byte starts a new line.
    Reported,
    /// Discarding a line that is too long, up to its end.
    Skipping,
}

/// The result of a byte.
#[derive(Clone, Copy)]
enum Step {
    Nothing,
    Line,
    TooLong,
}

impl<const N: usize> LineReader<N> {
    /// Returns a reader at the start of a line.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: [0; N],
            len: 0,
            state: State::Reading,
            counters: LineCounters { too_long: 0, dropped: 0 },
        }
    }

    /// Processes one byte, and returns the line or error that it completes.
    pub fn push(&mut self, byte: u8) -> Option<LineEvent<'_>> {
        let step = self.step(byte);
        self.event(step)
    }

    /// Processes bytes up to the next event. Returns the number of processed bytes and the event.
    ///
    /// ```
    /// use wsg_protocol::gcl::{LineEvent, LineReader};
    ///
    /// let mut reader = LineReader::<16>::new();
    /// assert_eq!(reader.push_slice(b"BYE()\nPOS?"), (6, Some(LineEvent::Line(b"BYE()"))));
    /// assert_eq!(reader.push_slice(b"POS?"), (4, None));
    /// ```
    pub fn push_slice(&mut self, bytes: &[u8]) -> (usize, Option<LineEvent<'_>>) {
        let mut taken = 0usize;
        let mut step = Step::Nothing;
        for byte in bytes {
            taken = taken.saturating_add(1);
            step = self.step(*byte);
            if !matches!(step, Step::Nothing) {
                break;
            }
        }
        (taken, self.event(step))
    }

    /// Ends the current line at the end of a datagram.
    ///
    /// ```
    /// use wsg_protocol::gcl::{LineEvent, LineReader};
    ///
    /// let mut reader = LineReader::<16>::new();
    /// reader.push_slice(b"POS?");
    /// assert_eq!(reader.finish(), Some(LineEvent::Line(b"POS?")));
    /// assert_eq!(reader.finish(), None);
    /// ```
    pub fn finish(&mut self) -> Option<LineEvent<'_>> {
        self.push(b'\n')
    }

    /// Discards an incomplete line, for a new connection. The counters keep their values.
    pub const fn reset(&mut self) {
        self.len = 0;
        self.state = State::Reading;
    }

    /// Returns the counts of discarded input.
    #[must_use]
    pub const fn counters(&self) -> LineCounters {
        self.counters
    }

    fn step(&mut self, byte: u8) -> Step {
        if self.state == State::Reported {
            self.reset();
        }
        let skipping = self.state == State::Skipping;
        if matches!(byte, b'\n' | b'\r') {
            if skipping {
                self.reset();
            }
            // Ends at the first byte, which is no control character.
            while self.buffer.get(self.len.wrapping_sub(1)).copied().is_some_and(is_control) {
                self.len = self.len.wrapping_sub(1);
            }
            if self.len == 0 {
                return Step::Nothing;
            }
            self.state = State::Reported;
            return Step::Line;
        }
        if skipping {
            self.drop_bytes(1);
            return Step::Nothing;
        }
        if self.len == 0 && (super::scanner::is_blank(byte) || is_control(byte)) {
            return Step::Nothing;
        }
        match self.buffer.get_mut(self.len) {
            Some(slot) => {
                *slot = byte;
                self.len = self.len.saturating_add(1);
                Step::Nothing
            }
            None => {
                self.counters.too_long = self.counters.too_long.saturating_add(1);
                self.drop_bytes(self.len.saturating_add(1));
                self.state = State::Skipping;
                Step::TooLong
            }
        }
    }

    fn event(&self, step: Step) -> Option<LineEvent<'_>> {
        let line = self.buffer.get(..self.len).unwrap_or(&[]);
        match step {
            Step::Nothing => None,
            Step::Line => Some(LineEvent::Line(line)),
            Step::TooLong => Some(LineEvent::TooLong(line)),
        }
    }

    fn drop_bytes(&mut self, count: usize) {
        let count = u16::try_from(count).unwrap_or(u16::MAX);
        self.counters.dropped = self.counters.dropped.saturating_add(count);
    }
}

/// Returns whether the byte is a control character other than a blank.
const fn is_control(byte: u8) -> bool {
    byte.is_ascii_control() && !super::scanner::is_blank(byte)
}

impl<const N: usize> Default for LineReader<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
