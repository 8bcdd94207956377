//! Requests: every command and query of the manual's chapters 2 and 3, to be sent and to be understood.

use super::form::{Ask, Call, Form};
use super::scanner::Scanner;
use super::table::for_each_gcl_command;
use super::{
    Autosend, CommandName, Grip, LineError, Move, Named, ParseError, Refused, Release, Select, Setting, Tare,
    Topic, write_line,
};
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
        /// // What is no request is refused, and the answer names the reason: E_CMD_UNKNOWN is 14.
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
            /// The name of this command.
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

            /// Whether it is written as a request that a gripper understands: finite numbers, indices inside.
            ///
            /// # Errors
            /// The mistake that reading it would find.
            pub fn check(&self) -> Result<(), ParseError> {
                match self {
                    $(define_requests!(@pattern $name parameters $($unit)?) => {
                        $(Form::check(&$unit))?
                        $(<$parameters as Form>::check(parameters))?
                    })*
                }
            }

            /// Writes it without the end of the line. No number is infinite if [`check`](Self::check) says so.
            ///
            /// # Errors
            /// Those of the writer.
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
            /// What may follow the name in a request, in the manual's notation.
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
    /// The longest request, in bytes without the end of the line.
    pub const MAX_LEN: usize =
        "GRIP(,,)".len().saturating_add(super::number::MAX_FLOAT_LEN.saturating_mul(3));

    /// The request in a line. Upper and lower case are the same, and blanks may stand between words.
    ///
    /// # Errors
    /// What is no request is refused, and says why and what to answer.
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

    /// Writes the line, with its end, to the start of `buffer`, and says how many bytes that were.
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
    /// [`LineError`]; then what stands in the buffer is of no use.
    pub fn write_line_into(&self, buffer: &mut [u8]) -> Result<usize, LineError> {
        self.check().map_err(LineError::Invalid)?;
        write_line(buffer, |line| self.write(line))
    }

    /// What it is for. To ask for PWT or CLT is a query.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Pwt(Setting::Ask) | Self::Clt(Setting::Ask) => Kind::Query,
            other => other.name().kind(),
        }
    }
}

impl Topic {
    /// The request that asks for it once.
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
    /// The line without its end.
    fn fmt(&self, f: &mut Formatter<'_>) -> Written {
        self.write(f)
    }
}
