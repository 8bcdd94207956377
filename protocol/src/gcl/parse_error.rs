//! Why a line is not understood.

use crate::types::Status;

/// What is wrong with a line, or with a request that is to be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum ParseError {
    /// It does not begin with a name.
    NoName,
    /// The manual lists no command of this name.
    UnknownName,
    /// What follows the name is none of the forms that the command has.
    Form,
    /// Too few parameters.
    TooFew,
    /// More parameters than the command takes.
    TooMany,
    /// A number is too large for what it stands for, or not finite.
    Range,
    /// A value that the manual does not list.
    Value,
    /// An index past the end.
    Index,
    /// A text holds a control character, one that is not ASCII, or too many of them.
    Text,
    /// The line is longer than the reader holds.
    TooLong,
}

impl ParseError {
    /// The status code that a gripper answers with (GCL, appendix A).
    ///
    /// The manual names the codes and not the cases; E_NO_PARAM_EXPECTED stands for every parameter too many.
    #[must_use]
    pub const fn status(self) -> Status {
        match self {
            Self::NoName | Self::Form | Self::Text => Status::CmdFormatError,
            Self::UnknownName => Status::CmdUnknown,
            Self::TooFew => Status::NotEnoughParams,
            Self::TooMany => Status::NoParamExpected,
            Self::Range => Status::RangeError,
            Self::Value => Status::InvalidParameter,
            Self::Index => Status::IndexOutOfBounds,
            Self::TooLong => Status::Overrun,
        }
    }
}

impl core::fmt::Display for ParseError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NoName => "no name at the start",
            Self::UnknownName => "unknown name",
            Self::Form => "not a form that this command has",
            Self::TooFew => "too few parameters",
            Self::TooMany => "too many parameters",
            Self::Range => "number too large or not finite",
            Self::Value => "undefined value",
            Self::Index => "index past the end",
            Self::Text => "control or non-ASCII character in a text, or text too long",
            Self::TooLong => "line too long",
        })
    }
}

impl core::error::Error for ParseError {}
