//! The answer of a gripper to an invalid line.

use super::{Answer, Description, Named, ParseError};

/// An invalid request, with the name to use in the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct Refused<'a> {
    /// The name at the start of the line.
    pub name: Named<'a>,
    /// The error in the line.
    pub mistake: ParseError,
}

impl<'a> Refused<'a> {
    /// Returns the refusal of a line that exceeds the reader's capacity, given its start.
    ///
    /// ```
    /// use wsg_protocol::gcl::Refused;
    ///
    /// let refused = Refused::too_long(b"move(0.000000000000000000000000000000000");
    /// assert_eq!(refused.answer(false).to_string(), "ERR MOVE 27");
    /// ```
    #[must_use]
    pub fn too_long(start: &'a [u8]) -> Self {
        Self { name: Named::at_start_of(start), mistake: ParseError::TooLong }
    }

    /// Returns the gripper's answer (GCL, 1.3), with a text in verbose mode.
    #[must_use]
    pub const fn answer(&self, verbose: bool) -> Answer<'a> {
        let status = self.mistake.status();
        let description = if verbose { Some(Description::of(status)) } else { None };
        Answer::Err { name: self.name, status, description }
    }
}

impl core::fmt::Display for Refused<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}: {}", self.name, self.mistake)
    }
}

impl core::error::Error for Refused<'_> {}
