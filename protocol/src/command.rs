//! Requests: every command of the manual's chapter 3, to be sent and to be understood.

use core::hash::{Hash, Hasher};

use crate::field::{DecodeError, Field};
use crate::frame::{Frame, Payload};
use crate::table::for_each_command;
use crate::types::{
    AckKey, AutoUpdate, DeviceTag, HomingDirection, LoopData, PrePositionFlags, SoftLimits, Status,
};

/// What a command is for, which decides how a controller may treat it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum Kind {
    /// About the connection itself.
    Connection,
    /// Moves the fingers: never sent a second time on its own, and answered twice.
    Motion,
    /// Ends motion: may be sent again until it is answered.
    Stop,
    /// Unlocks motion: never sent a second time on its own.
    Acknowledge,
    /// Changes a setting.
    Setting,
    /// Asks for a value.
    Query,
}

macro_rules! define_commands {
    ($(
        $(#[$doc:meta])*
        $code:literal $name:ident $title:literal $section:literal $kind:ident
            request $({ $($(#[$field_doc:meta])* $field:ident: $type:ty = $unit:literal),+ })?
            reply $(($value:ty $(= $value_unit:literal)?))?
            immediate [$($immediate:ident),*] completion [$($completion:ident),*];
    )*) => {
        /// The id of a command (command set, chapter 3).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
        pub enum CommandId {
            $(#[doc = concat!($title, " (", $code, "), ", $section, ".")] $name,)*
            /// An id that the manual does not list: a script on the gripper may serve it (A0h to BFh are in use).
            Unknown(u8),
        }

        impl CommandId {
            /// Every command of the manual, by id.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The id byte.
            #[must_use]
            pub const fn code(self) -> u8 {
                match self {
                    $(Self::$name => $code,)*
                    Self::Unknown(code) => code,
                }
            }

            /// The command with this id byte.
            // Asked in several places: once in the image.
            #[inline(never)]
            #[must_use]
            pub const fn from_code(code: u8) -> Self {
                match code {
                    $($code => Self::$name,)*
                    code => Self::Unknown(code),
                }
            }

            /// The manual's name of it; `script command` for A0h to BFh, which scripts on the gripper answer.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$name => $title,)*
                    Self::Unknown(0xA0..=0xBF) => "script command",
                    Self::Unknown(_) => "unknown command",
                }
            }

            /// The section of the command set manual that describes it; empty for an unknown one.
            #[must_use]
            pub const fn section(self) -> &'static str {
                match self {
                    $(Self::$name => $section,)*
                    Self::Unknown(_) => "",
                }
            }

            /// What it is for. An unknown one counts as a motion: it may move the fingers.
            #[must_use]
            pub const fn kind(self) -> Kind {
                match self {
                    $(Self::$name => Kind::$kind,)*
                    Self::Unknown(_) => Kind::Motion,
                }
            }

            /// The status codes that the manual lists for its first answer.
            #[must_use]
            pub const fn immediate_statuses(self) -> &'static [Status] {
                match self {
                    $(Self::$name => &[$(Status::$immediate),*],)*
                    Self::Unknown(_) => &[Status::CmdUnknown],
                }
            }

            /// The status codes that the manual lists for its second answer; none when there is no second one.
            // Asked in several places: once in the image.
            #[inline(never)]
            #[must_use]
            pub const fn completion_statuses(self) -> &'static [Status] {
                match self {
                    $(Self::$name => &[$(Status::$completion),*],)*
                    Self::Unknown(_) => &[],
                }
            }
        }

        /// A request to the gripper.
        ///
        /// ```
        /// use wsg_protocol::{Command, Frame, HomingDirection, DecodeError};
        ///
        /// let homing = Command::decode(&Frame { id: 0x20, payload: &[1] });
        /// assert_eq!(homing, Ok(Command::Homing { direction: HomingDirection::Positive }));
        /// let undefined = Command::decode(&Frame { id: 0x20, payload: &[3] });
        /// assert_eq!(undefined, Err(DecodeError::UndefinedValue));
        /// ```
        #[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
        // A tag of one byte would leave eleven behind it, which are copied by a call and byte by byte.
        #[repr(u32)]
        pub enum Command<'a> {
            $(
                $(#[$doc])*
                #[doc = ""]
                #[doc = concat!($title, " (", $code, "), ", $section, ".")]
                $name $({ $($(#[$field_doc])* $field: $type),+ })?,
            )*
            /// A command that the manual does not list, as it stands in the frame.
            Unknown {
                /// The id byte.
                id: u8,
                /// The payload.
                payload: &'a [u8],
            },
        }

        impl<'a> Command<'a> {
            /// The id of this command.
            #[must_use]
            pub const fn id(&self) -> CommandId {
                match self {
                    $(Self::$name { .. } => CommandId::$name,)*
                    Self::Unknown { id, .. } => CommandId::from_code(*id),
                }
            }

            /// The command in a frame.
            ///
            /// # Errors
            /// What the manual forbids is refused, and says why.
            pub fn decode(frame: &Frame<'a>) -> Result<Self, DecodeError> {
                let mut input = frame.payload;
                let command = match CommandId::from_code(frame.id) {
                    $(CommandId::$name => Self::$name $({ $($field: Field::take(&mut input)?),+ })?,)*
                    CommandId::Unknown(id) => Self::Unknown { id, payload: core::mem::take(&mut input) },
                };
                if input.is_empty() { Ok(command) } else { Err(DecodeError::TooLong) }
            }

            /// Whether a gripper may take it: finite numbers, defined bits.
            ///
            /// # Errors
            /// The refusal that decoding its frame would give.
            pub fn check(&self) -> Result<(), DecodeError> {
                match self {
                    $(Self::$name $({ $($field),+ })? => {
                        $($(Field::check($field)?;)+)?
                    })*
                    Self::Unknown { .. } => {}
                }
                Ok(())
            }
        }

        /// By id and payload.
        impl Hash for Command<'_> {
            fn hash<H: Hasher>(&self, state: &mut H) {
                state.write_u8(self.id().code());
                for index in 0..Payload::len(self) {
                    state.write_u8(Payload::byte(self, index));
                }
            }
        }

        impl Payload for Command<'_> {
            fn len(&self) -> usize {
                match self {
                    $(Self::$name $({ $($field),+ })? => 0usize $($(.saturating_add(Field::len($field)))+)?,)*
                    Self::Unknown { payload, .. } => payload.len(),
                }
            }

            fn byte(&self, index: usize) -> u8 {
                match self {
                    $(Self::$name $({ $($field),+ })? => {
                        let _at = index;
                        $($(
                            let len = Field::len($field);
                            if _at < len {
                                return Field::byte($field, _at);
                            }
                            let _at = _at.wrapping_sub(len);
                        )+)?
                        0
                    })*
                    Self::Unknown { payload, .. } => Payload::byte(payload, index),
                }
            }
        }

        impl core::fmt::Display for Command<'_> {
            /// Id, name and parameters with their units: `25h Grip Part 20.0 mm 50.0 mm/s`.
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                let id = self.id();
                write!(f, "{id}")?;
                match self {
                    $(Self::$name $({ $($field),+ })? => {
                        $($(
                            f.write_str(" ")?;
                            Field::describe($field, f)?;
                            if !$unit.is_empty() {
                                f.write_str(concat!(" ", $unit))?;
                            }
                        )+)?
                    })*
                    Self::Unknown { payload, .. } => write!(f, " {} bytes", payload.len())?,
                }
                Ok(())
            }
        }
    };
}

for_each_command!(define_commands);

impl CommandId {
    /// Whether the manual lists this status code for this command, in its first or second answer.
    #[must_use]
    pub fn may_answer(self, status: Status) -> bool {
        self.immediate_statuses().contains(&status) || self.completion_statuses().contains(&status)
    }

    /// Whether sending it a second time changes nothing, so that a lost answer may be asked for again. For Get Gripping
    /// Statistics that is so without a reset only: see [`Command::is_repeatable`].
    #[must_use]
    pub const fn is_repeatable(self) -> bool {
        match self.kind() {
            Kind::Stop | Kind::Query | Kind::Setting => true,
            Kind::Connection => matches!(self, Self::Loop),
            Kind::Motion | Kind::Acknowledge => false,
        }
    }

    /// The status code that the manual asks a gripper to answer with when it refuses a request.
    #[must_use]
    pub fn status_of(self, refusal: DecodeError) -> Status {
        let listed = |status: Status| self.immediate_statuses().contains(&status);
        match refusal {
            DecodeError::TagTooLong => Status::Overrun,
            DecodeError::TooShort | DecodeError::TooLong | DecodeError::AckKey
                if listed(Status::CmdFormatError) =>
            {
                Status::CmdFormatError
            }
            DecodeError::TooShort | DecodeError::TooLong | DecodeError::AckKey => Status::NoParamExpected,
            DecodeError::UndefinedValue
            | DecodeError::ReservedBits
            | DecodeError::NotFinite
            | DecodeError::Character => {
                if listed(Status::InvalidParameter) {
                    Status::InvalidParameter
                } else {
                    Status::CmdFormatError
                }
            }
        }
    }
}

impl core::fmt::Display for CommandId {
    /// The id as the manual writes it, and the name: `25h Grip Part`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:02X}h {}", self.code(), self.name())
    }
}

/// The key of [`Command::Acknowledge`], ready to send.
impl Command<'_> {
    /// Acknowledges a FAST STOP or a fault.
    pub const ACKNOWLEDGE: Self = Self::Acknowledge { key: AckKey };

    /// Whether sending it a second time changes nothing, so that a lost answer may be asked for again.
    ///
    /// ```
    /// use wsg_protocol::Command;
    ///
    /// assert!(Command::GetGrippingStatistics { reset: false }.is_repeatable());
    /// // The counts that the lost answer brought would be gone.
    /// assert!(!Command::GetGrippingStatistics { reset: true }.is_repeatable());
    /// assert!(!Command::GripPart { width: 20.0, speed: 50.0 }.is_repeatable());
    /// ```
    #[must_use]
    pub const fn is_repeatable(&self) -> bool {
        !matches!(self, Self::GetGrippingStatistics { reset: true }) && self.id().is_repeatable()
    }

    /// The longest request without the ones of variable length (Loop, Set Device Tag, unknown ones): Pre-position
    /// Fingers, in bytes of payload.
    pub const MAX_FIXED_LEN: usize = 9;
}

#[cfg(test)]
mod tests;
