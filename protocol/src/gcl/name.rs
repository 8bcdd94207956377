//! The names of commands, and what the manual says of each. The forms of their requests and values are in `request` and
//! `value`.

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

            /// The name as it stands in a line.
            #[must_use]
            pub const fn text(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }

            /// The section of the manual that describes it.
            #[must_use]
            pub const fn section(self) -> &'static str {
                match self {
                    $(Self::$name => $section,)*
                }
            }

            /// What it is for. PWT and CLT, which also ask, count as settings.
            #[must_use]
            pub const fn kind(self) -> Kind {
                match self {
                    $(Self::$name => Kind::$kind,)*
                }
            }

            /// Whether `ACK` answers it.
            #[must_use]
            pub const fn is_acknowledged(self) -> bool {
                match self {
                    $(Self::$name => define_names!(@has Ack $($answer)*),)*
                }
            }

            /// Whether `FIN` answers it once more, when it is done.
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
    /// The command of this name, in upper or lower case.
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

    /// Whether sending it a second time changes nothing, so that a lost answer may be asked for again.
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

/// The name in an answer: one of the manual, or another one that a line began with.
#[derive(Clone, Copy, Debug, crate::Format)]
pub enum Named<'a> {
    /// One of the manual.
    Command(CommandName),
    /// Another one; how it was spelled. At most [`MAX_LEN`](Self::MAX_LEN) characters of it are kept.
    Other(OtherName<'a>),
}

/// A name that the manual does not list, or `?` for a line that begins with none.
#[derive(Clone, Copy, Debug, crate::Format)]
pub struct OtherName<'a>(&'a str);

impl<'a> OtherName<'a> {
    /// The name as it was spelled.
    #[must_use]
    pub const fn text(self) -> &'a str {
        self.0
    }
}

/// What a line without a name is called.
const NAMELESS: &str = "?";

impl<'a> Named<'a> {
    /// How much of a name that nobody knows is repeated in the answer.
    pub const MAX_LEN: usize = 16;

    /// What a line that begins like this is called: `?` if not by a name.
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

    /// Takes the name in an answer.
    pub(super) fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
        if input.take(b'?') {
            return Ok(Self::Other(OtherName(NAMELESS)));
        }
        match input.name() {
            [] => Err(ParseError::Form),
            name => Ok(Self::from_bytes(name)),
        }
    }

    /// The command, if it is one of the manual.
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
    /// Upper and lower case are the same.
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
