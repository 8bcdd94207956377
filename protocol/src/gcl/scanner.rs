//! The marks and words of a line, from left to right. Blanks may stand before each of them.

use super::ParseError;

/// Whether a person may type this between words.
pub(super) const fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t')
}

/// What is left of a line.
#[derive(Clone, Debug)]
pub(super) struct Scanner<'a> {
    rest: &'a [u8],
}

impl<'a> Scanner<'a> {
    pub(super) const fn new(line: &'a [u8]) -> Self {
        Self { rest: line }
    }

    /// The next byte that is not a blank.
    pub(super) fn peek(&mut self) -> Option<u8> {
        self.take_while(is_blank);
        self.rest.first().copied()
    }

    /// Takes this mark if it is the next.
    pub(super) fn take(&mut self, mark: u8) -> bool {
        let is_next = self.peek() == Some(mark);
        if is_next {
            self.rest = self.rest.get(1..).unwrap_or(&[]);
        }
        is_next
    }

    /// Takes this mark.
    pub(super) fn expect(&mut self, mark: u8) -> Result<(), ParseError> {
        if self.take(mark) { Ok(()) } else { Err(ParseError::Form) }
    }

    /// Takes bytes as long as they belong to the word, blanks before it left out; it may be empty.
    pub(super) fn word(&mut self, belongs: impl FnMut(u8) -> bool) -> &'a [u8] {
        self.take_while(is_blank);
        self.take_while(belongs)
    }

    /// Takes a name: letters, then letters, digits and `_`; it may be empty.
    pub(super) fn name(&mut self) -> &'a [u8] {
        if self.peek().is_some_and(|byte| byte.is_ascii_alphabetic()) {
            self.take_while(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
        } else {
            &[]
        }
    }

    /// Takes what stands between two quotation marks.
    pub(super) fn quoted(&mut self) -> Result<&'a [u8], ParseError> {
        self.expect(b'"')?;
        let text = self.take_while(|byte| byte != b'"');
        self.expect(b'"')?;
        Ok(text)
    }

    /// Takes numbers, commas, blanks and pairs of brackets, up to a bracket that closes none of them.
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

    /// Takes all that is left, without the blanks around it.
    pub(super) fn remainder(&mut self) -> &'a [u8] {
        core::mem::take(&mut self.rest).trim_ascii()
    }

    /// Whether a blank is next, or nothing.
    pub(super) fn at_gap(&self) -> bool {
        self.rest.first().is_none_or(|byte| is_blank(*byte))
    }

    /// Takes the end of the line.
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
