//! Command names, with the manual's section and kind of each. `request` and `value` hold the forms of requests and values.

use super::ParseError;
use super::scanner::Scanner;
use super::table::for_each_gcl_command;
use crate::command::Kind;

macro_rules! define_names {
    ($(
        $(#[$doc:meta])*
        $name:ident $text:literal $section:literal $kind:ident
            $(unit $unit:ident)? $(with ($parameters:ty))?
            answers [$($answer:ident),*] value ($($value:ty)?);
    )*) => {
        /// The name of a command (GCL, chapters 2 and 3).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
        pub enum CommandName {
            $(#[doc = concat!("`", $text, "`, ", $section, ".")] $name,)*
        }

        impl CommandName {
            /// Every name, in the manual's order.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Returns the name as written in a line.
            #[must_use]
            pub const fn text(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }

            /// Returns the section of the manual that describes the command.
            #[must_use]
            pub const fn section(self) -> &'static str {
                match self {
                    $(Self::$name => $section,)*
                }
            }

            /// Returns the purpose of the command. PWT and CLT count as settings, although they can also be queried.
            #[must_use]
            pub const fn kind(self) -> Kind {
                match self {
                    $(Self::$name => Kind::$kind,)*
                }
            }

            /// Returns whether the command is acknowledged by `ACK`.
            #[must_use]
            pub const fn is_acknowledged(self) -> bool {
                match self {
                    $(Self::$name => define_names!(@has Ack $($answer)*),)*
                }
            }

            /// Returns whether the command is also answered by `FIN` when it is done.
            #[must_use]
            pub const fn is_finished(self) -> bool {
                match self {
                    $(Self::$name => define_names!(@has Fin $($answer)*),)*
                }
            }
        }
    };
    (@has Ack Ack $($rest:ident)*) => { true };
    (@has Fin Ack Fin) => { true };
    (@has $wanted:ident $($rest:ident)*) => { false };
}

for_each_gcl_command!(define_names);

impl CommandName {
    /// Returns the command of this name, in upper or lower case.
    ///
    /// ```
    /// use wsg_protocol::gcl::CommandName;
    ///
    /// assert_eq!(CommandName::from_text("FastStop"), Some(CommandName::Faststop));
    /// assert_eq!(CommandName::from_text("DANCE"), None);
    /// ```
    #[must_use]
    pub fn from_text(text: &str) -> Option<Self> {
        Self::from_bytes(text.as_bytes())
    }

    pub(super) fn from_bytes(text: &[u8]) -> Option<Self> {
        Self::ALL.iter().copied().find(|name| name.text().as_bytes().eq_ignore_ascii_case(text))
    }

    /// Returns whether sending the command twice has no further effect, so that a lost answer permits a repetition.
    #[must_use]
    pub const fn is_repeatable(self) -> bool {
        match self.kind() {
            Kind::Stop | Kind::Query | Kind::Setting => true,
            Kind::Connection | Kind::Motion | Kind::Acknowledge => false,
        }
    }
}

impl core::fmt::Display for CommandName {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.text())
    }
}

/// The name in an answer: a command of the manual, or any other name.
#[derive(Clone, Copy, Debug, crate::Format)]
pub enum Named<'a> {
    /// A command of the manual.
    Command(CommandName),
    /// An unknown name as spelled, truncated to [`MAX_LEN`](Self::MAX_LEN) characters.
    Other(OtherName<'a>),
}

/// A name that the manual does not list, or `?` for a line without a name.
#[derive(Clone, Copy, Debug, crate::Format)]
pub struct OtherName<'a>(&'a str);

impl<'a> OtherName<'a> {
    /// Returns the name as spelled.
    #[must_use]
    pub const fn text(self) -> &'a str {
        self.0
    }
}

/// The name in answers to a line without a name.
const NAMELESS: &str = "?";

impl<'a> Named<'a> {
    /// Maximum number of characters of an unknown name that the answer repeats.
    pub const MAX_LEN: usize = 16;

    /// Returns the name at the start of a line, or `?` if there is no name.
    #[must_use]
    pub fn at_start_of(line: &'a [u8]) -> Self {
        Self::from_bytes(Scanner::new(line).name())
    }

    pub(super) fn from_bytes(name: &'a [u8]) -> Self {
        if let Some(command) = CommandName::from_bytes(name) {
            return Self::Command(command);
        }
        let kept = name.get(..Self::MAX_LEN).unwrap_or(name);
        let text = core::str::from_utf8(kept).unwrap_or(NAMELESS);
        Self::Other(OtherName(if text.is_empty() { NAMELESS } else { text }))
    }

    /// Parses the name in an answer.
    pub(super) fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
        if input.take(b'?') {
            return Ok(Self::Other(OtherName(NAMELESS)));
        }
        match input.name() {
            [] => Err(ParseError::Form),
            name => Ok(Self::from_bytes(name)),
        }
    }

    /// Returns the command, if the manual lists it.
    #[must_use]
    pub const fn command(self) -> Option<CommandName> {
        match self {
            Self::Command(name) => Some(name),
            Self::Other(_) => None,
        }
    }

    pub(super) fn write(self, to: &mut impl core::fmt::Write) -> core::fmt::Result {
        match self {
            Self::Command(name) => to.write_str(name.text()),
            Self::Other(other) => other.0.chars().try_for_each(|c| to.write_char(c.to_ascii_uppercase())),
        }
    }
}

impl PartialEq for Named<'_> {
    /// Ignores upper and lower case.
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Command(one), Self::Command(other)) => one == other,
            (Self::Other(one), Self::Other(other)) => one.0.eq_ignore_ascii_case(other.0),
            _ => false,
        }
    }
}

impl Eq for Named<'_> {}

impl From<CommandName> for Named<'_> {
    fn from(name: CommandName) -> Self {
        Self::Command(name)
    }
}

impl core::fmt::Display for Named<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.write(f)
    }
}
