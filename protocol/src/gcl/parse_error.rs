//! Errors of the parser, and the status codes that report them.

use crate::types::Status;

/// The error in a line, or in a request to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum ParseError {
    /// The line does not start with a name.
    NoName,
    /// The manual lists no command of this name.
    UnknownName,
    /// The text after the name matches none of the command's forms.
    Form,
    /// The request lacks a required parameter.
    TooFew,
    /// The request has more parameters than the command accepts.
    TooMany,
    /// A number is out of range or not finite.
    Range,
    /// The manual does not define this value.
    Value,
    /// An index is past the end.
    Index,
    /// A text contains a control or non-ASCII character, or is too long.
    Text,
    /// The line exceeds the reader's capacity.
    TooLong,
}

impl ParseError {
    /// Returns the status code of the gripper's answer (GCL, appendix A).
    ///
    /// The manual names the codes without their cases. Here, E_NO_PARAM_EXPECTED reports any excess parameter.
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
            Self::Form => "not a form of this command",
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
