//! Answers: every line that a gripper sends, with parser and writer (GCL, 1.3 and the commands' sections).

use super::name::Named;
use super::number::{read_integer, write_integer};
use super::scanner::Scanner;
use super::{CommandName, Description, LineError, ParseError, Value, write_line};
use crate::types::Status;
use core::fmt::{Formatter, Result as Written, Write};

/// A line from the gripper.
///
/// ```
/// use wsg_protocol::gcl::{Answer, CommandName, Value};
/// use wsg_protocol::{GripperState, Status};
///
/// assert_eq!(Answer::parse(b"ACK GRIP"), Ok(Answer::Ack(CommandName::Grip)));
/// assert_eq!(Answer::parse(b"GRIPSTATE=4"), Ok(Answer::Value(Value::Gripstate(GripperState::Holding))));
/// assert_eq!(Answer::parse(b"@POS=20.5"), Ok(Answer::Update(Value::Pos(20.5))));
/// assert_eq!(Answer::failed(CommandName::Grip, Status::CmdFailed).to_string(), "ERR GRIP 18");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
pub enum Answer<'a> {
    /// `ACK NAME`: accepted; a motion starts.
    Ack(CommandName),
    /// `FIN NAME`: a motion has ended successfully.
    Fin(CommandName),
    /// `ERR NAME code`, with a text in verbose mode: invalid, refused or failed.
    Err {
        /// The name of the request.
        name: Named<'a>,
        /// The reason.
        status: Status,
        /// The reason as a text, in verbose mode.
        description: Option<Description<'a>>,
    },
    /// `NAME=value`: the answer to a query.
    Value(Value<'a>),
    /// `@NAME=value`: an automatic update, after AUTOSEND.
    Update(Value<'a>),
}

const ACK: &str = "ACK";
const FIN: &str = "FIN";
const ERR: &str = "ERR";
/// The name of TAG in the manual's example (3.1.4).
const TAG_IN_THE_EXAMPLE: &[u8] = b"DEVTAG";

impl<'a> Answer<'a> {
    /// Returns an error without a text.
    #[must_use]
    pub const fn failed(name: CommandName, status: Status) -> Self {
        Self::Err { name: Named::Command(name), status, description: None }
    }

    /// Parses a line. Case is ignored, and blanks are permitted between words.
    ///
    /// # Errors
    /// Returns [`ParseError`] for an invalid answer.
    pub fn parse(line: &'a [u8]) -> Result<Self, ParseError> {
        let mut input = Scanner::new(line);
        let is_update = input.take(b'@');
        let word = input.name();
        let is = |mark: &str| !is_update && word.eq_ignore_ascii_case(mark.as_bytes()) && input.at_gap();
        let (is_ack, is_fin, is_err) = (is(ACK), is(FIN), is(ERR));
        let answer = if is_ack || is_fin {
            let name = Named::read(&mut input)?.command().ok_or(ParseError::UnknownName)?;
            match is_ack {
                true if name.is_acknowledged() => Self::Ack(name),
                false if name.is_finished() => Self::Fin(name),
                _ => return Err(ParseError::Form),
            }
        } else if is_err {
            Self::read_error(&mut input)?
        } else {
            let name = match CommandName::from_bytes(word) {
                Some(name) => name,
                None if word.is_empty() => return Err(ParseError::NoName),
                None if word.eq_ignore_ascii_case(TAG_IN_THE_EXAMPLE) => CommandName::Tag,
                None => return Err(ParseError::UnknownName),
            };
            let value = Value::read(name, &mut input)?;
            match is_update {
                true if value.is_of_an_update() => Self::Update(value),
                true => return Err(ParseError::Value),
                false => Self::Value(value),
            }
        };
        input.end()?;
        Ok(answer)
    }

    fn read_error(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
        let name = Named::read(input)?;
        if !input.at_gap() {
            return Err(ParseError::Form);
        }
        let code = u16::try_from(read_integer(input)?).map_err(|_| ParseError::Range)?;
        if !input.at_gap() {
            return Err(ParseError::Form);
        }
        let description = Description::new(input.remainder());
        Ok(Self::Err { name, status: Status::from_code(code), description })
    }

    /// Returns the name of the request that this answers.
    #[must_use]
    pub const fn name(&self) -> Named<'a> {
        match self {
            Self::Ack(name) | Self::Fin(name) => Named::Command(*name),
            Self::Err { name, .. } => *name,
            Self::Value(value) | Self::Update(value) => Named::Command(value.name()),
        }
    }

    /// Returns the status of the request: E_CMD_PENDING for an acknowledged motion, E_SUCCESS, or the error.
    ///
    /// ```
    /// use wsg_protocol::Status;
    /// use wsg_protocol::gcl::Answer;
    ///
    /// assert_eq!(Answer::parse(b"ACK MOVE").unwrap().status(), Status::CmdPending);
    /// assert_eq!(Answer::parse(b"FIN MOVE").unwrap().status(), Status::Success);
    /// assert_eq!(Answer::parse(b"ERR MOVE 29").unwrap().status(), Status::AxisBlocked);
    /// assert_eq!(Answer::parse(b"ACK STOP").unwrap().status(), Status::Success);
    /// ```
    #[must_use]
    pub const fn status(&self) -> Status {
        match self {
            Self::Ack(name) if name.is_finished() => Status::CmdPending,
            Self::Ack(_) | Self::Fin(_) | Self::Value(_) | Self::Update(_) => Status::Success,
            Self::Err { status, .. } => *status,
        }
    }

    /// Checks that a controller can parse the answer: finite numbers, valid indices, and only an `ACK`, `FIN` or update that
    /// the manual defines.
    ///
    /// # Errors
    /// Returns the error that parsing it would find.
    pub fn check(&self) -> Result<(), ParseError> {
        match self {
            Self::Ack(name) if !name.is_acknowledged() => Err(ParseError::Form),
            Self::Fin(name) if !name.is_finished() => Err(ParseError::Form),
            Self::Ack(_) | Self::Fin(_) | Self::Err { .. } => Ok(()),
            Self::Update(value) if !value.is_of_an_update() => Err(ParseError::Value),
            Self::Value(value) | Self::Update(value) => value.check(),
        }
    }

    /// Writes the answer without a line end. Call [`check`](Self::check) first to ensure that it can be parsed.
    ///
    /// # Errors
    /// Returns the errors of the writer.
    pub fn write(&self, to: &mut impl Write) -> Written {
        match self {
            Self::Ack(name) => {
                to.write_str(ACK)?;
                to.write_char(' ')?;
                to.write_str(name.text())
            }
            Self::Fin(name) => {
                to.write_str(FIN)?;
                to.write_char(' ')?;
                to.write_str(name.text())
            }
            Self::Err { name, status, description } => {
                to.write_str(ERR)?;
                to.write_char(' ')?;
                name.write(to)?;
                to.write_char(' ')?;
                write_integer(status.code().into(), to)?;
                description.map_or(Ok(()), |description| {
                    to.write_char(' ')?;
                    description.write(to)
                })
            }
            Self::Value(value) => {
                to.write_str(value.name().text())?;
                value.write(to)
            }
            Self::Update(value) => {
                to.write_char('@')?;
                to.write_str(value.name().text())?;
                value.write(to)
            }
        }
    }

    /// Writes the line, including its end (LF), to the start of `buffer`. Returns its length in bytes.
    ///
    /// ```
    /// use wsg_protocol::gcl::{Answer, Value};
    ///
    /// let mut buffer = [0; 32];
    /// let length = Answer::Value(Value::Temp(34.2)).write_line_into(&mut buffer).unwrap();
    /// assert_eq!(&buffer[..length], b"TEMP=34.2\n");
    /// ```
    ///
    /// # Errors
    /// Returns [`LineError`]. The content of the buffer is then undefined.
    pub fn write_line_into(&self, buffer: &mut [u8]) -> Result<usize, LineError> {
        self.check().map_err(LineError::Invalid)?;
        write_line(buffer, |line| self.write(line))
    }
}

impl core::fmt::Display for Answer<'_> {
    /// Writes the line without its end.
    fn fmt(&self, f: &mut Formatter<'_>) -> Written {
        self.write(f)
    }
}
