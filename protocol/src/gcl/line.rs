//! Lines in a stream of bytes (GCL, 1.2): where one ends, and what to do about one that does not.

/// The longest line that a controller has to take, in bytes without its end.
///
/// Grippers in the field send at most 1024 bytes at a time. Only `FDATA` of tactile fingers comes near; a controller
/// that does not ask for it is served by 256.
pub const MAX_LINE_LEN: usize = 1024;

/// What a [`LineReader`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum LineEvent<'a> {
    /// A line, without its end and without blanks before it. It is never empty.
    Line(&'a [u8]),
    /// A line is longer than the reader holds; nothing more is told of it. This is how it began.
    TooLong(&'a [u8]),
}

/// What a reader has thrown away so far; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct LineCounters {
    /// Lines that were too long.
    pub too_long: u16,
    /// Bytes of such lines.
    pub dropped: u16,
}

/// Finds lines of up to `N` bytes in a stream of bytes. It is all zero after [`new`](Self::new).
///
/// A line ends with LF, CR, or both: the manual prints LF with the code of CR, and terminals send any of them. A line
/// without anything but blanks is none. After a line that is too long the next line is found again.
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
    /// The line up to here is in the buffer.
    Reading = 0,
    /// The line in the buffer was told of: the next byte begins another one.
    Told,
    /// The line is too long: its end is looked for.
    Skipping,
}

/// What a byte led to.
#[derive(Clone, Copy)]
enum Step {
    Nothing,
    Line,
    TooLong,
}

impl<const N: usize> LineReader<N> {
    /// A reader at the start of a line.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: [0; N],
            len: 0,
            state: State::Reading,
            counters: LineCounters { too_long: 0, dropped: 0 },
        }
    }

    /// Takes one byte.
    pub fn push(&mut self, byte: u8) -> Option<LineEvent<'_>> {
        let step = self.step(byte);
        self.event(step)
    }

    /// Takes bytes up to the next event, and says how many.
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

    /// Ends the line: nothing more of it comes, because its datagram ends here.
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

    /// Forgets what came of a line, for a new connection; the counters stay.
    pub const fn reset(&mut self) {
        self.len = 0;
        self.state = State::Reading;
    }

    /// What was thrown away so far.
    #[must_use]
    pub const fn counters(&self) -> LineCounters {
        self.counters
    }

    fn step(&mut self, byte: u8) -> Step {
        if self.state == State::Told {
            self.reset();
        }
        let skipping = self.state == State::Skipping;
        if matches!(byte, b'\n' | b'\r') {
            if skipping {
                self.reset();
            }
            if self.len == 0 {
                return Step::Nothing;
            }
            self.state = State::Told;
            return Step::Line;
        }
        if skipping {
            self.drop_bytes(1);
            return Step::Nothing;
        }
        if self.len == 0 && super::scanner::is_blank(byte) {
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

impl<const N: usize> Default for LineReader<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
