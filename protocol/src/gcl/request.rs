//! Requests: every command and query of the manual's chapters 2 and 3, with parser and writer.

use super::form::{Ask, Call, Form};
// The table names them.
use super::parameters::*;
use super::scanner::Scanner;
use super::table::for_each_gcl_command;
use super::{CommandName, LineError, Named, ParseError, Refused, Topic, write_line};
use crate::command::Kind;
use crate::types::HomingDirection;
use core::fmt::{Formatter, Result as Written, Write};

macro_rules! define_requests {
    ($(
        $(#[$doc:meta])*
        $name:ident $text:literal $section:literal $kind:ident
            $(unit $unit:ident)? $(with ($parameters:ty))?
            answers [$($answer:ident),*] value ($($value:ty)?);
    )*) => {
        /// A request to the gripper.
        ///
        /// ```
        /// use wsg_protocol::gcl::{Grip, Request, Select};
        ///
        /// let grip = Request::parse(b"grip( 20, 35.5 )").unwrap();
        /// assert_eq!(grip, Request::Grip(Grip::Part { force: 20.0, width: 35.5 }));
        /// assert_eq!(grip.to_string(), "GRIP(20.0,35.5)");
        /// assert_eq!(Request::parse(b"SYSFLAGS[12]?"), Ok(Request::Sysflags(Select::One(12))));
        ///
        /// // Invalid lines are refused with the reason: E_CMD_UNKNOWN is 14.
        /// let refused = Request::parse(b"dance(3)").unwrap_err();
        /// assert_eq!(refused.answer(false).to_string(), "ERR DANCE 14");
        /// ```
        #[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
        pub enum Request {
            $(
                $(#[$doc])*
                #[doc = ""]
                #[doc = concat!("`", $text, "`, ", $section, ".")]
                $name $(($parameters))?,
            )*
        }

        impl Request {
            /// Returns the name of this command.
            #[must_use]
            pub const fn name(&self) -> CommandName {
                match self {
                    $(Self::$name { .. } => CommandName::$name,)*
                }
            }

            fn read(name: CommandName, input: &mut Scanner<'_>) -> Result<Self, ParseError> {
                Ok(match name {
                    $(CommandName::$name => {
                        $(
                            let $unit = Form::read(input)?;
                            Self::$name
                        )?
                        $(Self::$name(<$parameters as Form>::read(input)?))?
                    })*
                })
            }

            /// Checks that a gripper can parse the request: finite numbers and valid indices.
            ///
            /// # Errors
            /// Returns the error that parsing it would find.
            pub fn check(&self) -> Result<(), ParseError> {
                match self {
                    $(define_requests!(@pattern $name parameters $($unit)?) => {
                        $(Form::check(&$unit))?
                        $(<$parameters as Form>::check(parameters))?
                    })*
                }
            }

            /// Writes the request without a line end. Call [`check`](Self::check) first to exclude non-finite numbers.
            ///
            /// # Errors
            /// Returns the errors of the writer.
            pub fn write(&self, to: &mut impl Write) -> Written {
                to.write_str(self.name().text())?;
                match self {
                    $(define_requests!(@pattern $name parameters $($unit)?) => {
                        $(Form::write(&$unit, to))?
                        $(<$parameters as Form>::write(parameters, to))?
                    })*
                }
            }
        }

        impl CommandName {
            /// Returns the forms that may follow the name in a request, in the manual's notation.
            #[must_use]
            pub fn forms(self) -> &'static [&'static str] {
                match self {
                    $(Self::$name => $(<$unit as Form>::FORMS)? $(<$parameters as Form>::FORMS)?,)*
                }
            }
        }
    };
    (@pattern $name:ident $binding:ident $unit:ident) => { Self::$name };
    (@pattern $name:ident $binding:ident) => { Self::$name($binding) };
}

for_each_gcl_command!(define_requests);

impl Request {
    /// Maximum length of a request in bytes, without the line end.
    pub const MAX_LEN: usize =
        "GRIP(,,)".len().saturating_add(super::number::MAX_FLOAT_LEN.saturating_mul(3));

    /// Parses a line. Case is ignored, and blanks are permitted between words.
    ///
    /// # Errors
    /// Returns [`Refused`] for an invalid request, with the reason and the answer.
    pub fn parse(line: &[u8]) -> Result<Self, Refused<'_>> {
        let mut input = Scanner::new(line);
        let name = Named::from_bytes(input.name());
        let refuse = |mistake| Refused { name, mistake };
        let Some(command) = name.command() else {
            let is_nameless = Scanner::new(line).name().is_empty();
            return Err(refuse(if is_nameless { ParseError::NoName } else { ParseError::UnknownName }));
        };
        let request = Self::read(command, &mut input).map_err(refuse)?;
        input.end().map_err(refuse)?;
        Ok(request)
    }

    /// Writes the line, including its end (LF), to the start of `buffer`. Returns its length in bytes.
    ///
    /// ```
    /// use wsg_protocol::gcl::Request;
    ///
    /// let mut buffer = [0; Request::MAX_LEN + 1];
    /// let length = Request::Faststop.write_line_into(&mut buffer).unwrap();
    /// assert_eq!(&buffer[..length], b"FASTSTOP()\n");
    /// ```
    ///
    /// # Errors
    /// Returns [`LineError`]. The content of the buffer is then undefined.
    pub fn write_line_into(&self, buffer: &mut [u8]) -> Result<usize, LineError> {
        self.check().map_err(LineError::Invalid)?;
        write_line(buffer, |line| self.write(line))
    }

    /// Returns the purpose of the request. Reading PWT or CLT is a query.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Pwt(Setting::Ask) | Self::Clt(Setting::Ask) => Kind::Query,
            other => other.name().kind(),
        }
    }
}

impl Topic {
    /// Returns the request that queries the value once.
    #[must_use]
    pub const fn query(self) -> Request {
        match self {
            Self::Pos => Request::Pos,
            Self::Speed => Request::Speed,
            Self::Force => Request::Force,
            Self::Gripstate => Request::Gripstate,
            Self::Sysflags => Request::Sysflags(Select::All),
            Self::Temp => Request::Temp,
        }
    }
}

impl core::fmt::Display for Request {
    /// Writes the line without its end.
    fn fmt(&self, f: &mut Formatter<'_>) -> Written {
        self.write(f)
    }
}
