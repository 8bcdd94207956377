//! Parses the marks and words of a line from left to right. Blanks are permitted before each of them.

use super::ParseError;

/// Returns whether the byte is a blank, which is permitted between words.
pub(super) const fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t')
}

/// The unparsed rest of a line.
#[derive(Clone, Debug)]
pub(super) struct Scanner<'a> {
    rest: &'a [u8],
}

impl<'a> Scanner<'a> {
    pub(super) const fn new(line: &'a [u8]) -> Self {
        Self { rest: line }
    }

    /// Skips blanks and returns the next byte without consuming it.
    pub(super) fn peek(&mut self) -> Option<u8> {
        self.take_while(is_blank);
        self.rest.first().copied()
    }

    /// Consumes the mark if it is next. Returns whether it was.
    pub(super) fn take(&mut self, mark: u8) -> bool {
        let is_next = self.peek() == Some(mark);
        if is_next {
            self.rest = self.rest.get(1..).unwrap_or(&[]);
        }
        is_next
    }

    /// Consumes the mark, or returns [`ParseError::Form`].
    pub(super) fn expect(&mut self, mark: u8) -> Result<(), ParseError> {
        if self.take(mark) { Ok(()) } else { Err(ParseError::Form) }
    }

    /// Skips blanks and consumes the bytes of a word, possibly none.
    pub(super) fn word(&mut self, belongs: impl FnMut(u8) -> bool) -> &'a [u8] {
        self.take_while(is_blank);
        self.take_while(belongs)
    }

    /// Consumes a name, which is a letter and then letters, digits and `_`; possibly empty.
    pub(super) fn name(&mut self) -> &'a [u8] {
        if self.peek().is_some_and(|byte| byte.is_ascii_alphabetic()) {
            self.take_while(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
        } else {
            &[]
        }
    }

    /// Consumes a text in quotation marks.
    pub(super) fn quoted(&mut self) -> Result<&'a [u8], ParseError> {
        self.expect(b'"')?;
        let text = self.take_while(|byte| byte != b'"');
        self.expect(b'"')?;
        Ok(text)
    }

    /// Consumes numbers, commas, blanks and pairs of brackets, up to an unmatched closing bracket.
    pub(super) fn inside_brackets(&mut self) -> &'a [u8] {
        let mut depth = 0usize;
        let is_inside = |byte| match byte {
            b'[' => {
                depth = depth.saturating_add(1);
                true
            }
            b']' => match depth.checked_sub(1) {
                Some(outer) => {
                    depth = outer;
                    true
                }
                None => false,
            },
            b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E' | b',' => true,
            other => is_blank(other),
        };
        self.take_while(is_inside)
    }

    /// Consumes the rest of the line. Returns it without surrounding blanks.
    pub(super) fn remainder(&mut self) -> &'a [u8] {
        core::mem::take(&mut self.rest).trim_ascii()
    }

    /// Returns whether a blank or the end of the line is next.
    pub(super) fn at_gap(&self) -> bool {
        self.rest.first().is_none_or(|byte| is_blank(*byte))
    }

    /// Returns [`ParseError::Form`] unless the line ends here.
    pub(super) fn end(&mut self) -> Result<(), ParseError> {
        if self.peek().is_none() { Ok(()) } else { Err(ParseError::Form) }
    }

    fn take_while(&mut self, mut belongs: impl FnMut(u8) -> bool) -> &'a [u8] {
        let len = self.rest.iter().position(|byte| !belongs(*byte)).unwrap_or(self.rest.len());
        let (taken, rest) = self.rest.split_at_checked(len).unwrap_or((&[], self.rest));
        self.rest = rest;
        taken
    }
}
