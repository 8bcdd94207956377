//! The values that AUTOSEND supports (GCL, 3.1.7).

use super::form::{Word, notation};
use super::scanner::Scanner;
use super::{CommandName, ParseError};
use core::fmt::{Result as Written, Write};

/// A value that AUTOSEND can report periodically.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum Topic {
    /// Opening width in mm.
    Pos,
    /// Speed of the fingers in mm/s.
    Speed,
    /// Gripping force in N.
    Force,
    /// Gripper state (GRIPSTATE).
    Gripstate,
    /// System state flags (SYSFLAGS).
    Sysflags,
    /// Temperature of the device in °C.
    Temp,
}

impl Topic {
    /// Every topic, in the manual's order.
    pub const ALL: [Self; 6] =
        [Self::Pos, Self::Speed, Self::Force, Self::Gripstate, Self::Sysflags, Self::Temp];

    /// Returns the command that queries the value and has the same name.
    #[must_use]
    pub const fn name(self) -> CommandName {
        match self {
            Self::Pos => CommandName::Pos,
            Self::Speed => CommandName::Speed,
            Self::Force => CommandName::Force,
            Self::Gripstate => CommandName::Gripstate,
            Self::Sysflags => CommandName::Sysflags,
            Self::Temp => CommandName::Temp,
        }
    }

    /// Returns the topic that this command queries.
    #[must_use]
    pub fn of(name: CommandName) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Returns whether it is a measured value with a threshold for changes, and not a state. The manual speaks of numeric
    /// values and defines the gripper state as an integer; here it counts as a state.
    #[must_use]
    pub const fn is_measured(self) -> bool {
        !matches!(self, Self::Gripstate | Self::Sysflags)
    }
}

impl Word<'_> for Topic {
    notation!("<string>");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let text = input.quoted()?.trim_ascii();
        let named = |topic: &Self| topic.name().text().as_bytes().eq_ignore_ascii_case(text);
        Self::ALL.into_iter().find(named).ok_or(ParseError::Value)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char('"')?;
        to.write_str(self.name().text())?;
        to.write_char('"')
    }
}
