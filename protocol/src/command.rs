//! Requests: every command of the manual's chapter 3, for encoding and decoding.

use core::hash::{Hash, Hasher};

use crate::field::{DecodeError, Field};
use crate::frame::{Frame, Payload};
use crate::table::for_each_command;
use crate::types::{
    AckKey, AutoUpdate, DeviceTag, HomingDirection, LoopData, PrePositionFlags, SoftLimits, Status,
};

/// The kind of a command, which determines how a controller may treat it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub enum Kind {
    /// Concerns the connection itself.
    Connection,
    /// Moves the fingers. It is never repeated automatically and has two replies.
    Motion,
    /// Ends a motion. It may be repeated until it is answered.
    Stop,
    /// Unlocks motion. It is never repeated automatically.
    Acknowledge,
    /// Changes a setting of the gripper.
    Setting,
    /// Queries a value from the gripper.
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
            /// An id that the manual does not define. A script on the gripper may use it (A0h to BFh are in use).
            Unknown(u8),
        }

        impl CommandId {
            /// All commands of the manual, in the order of their ids.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Returns the id byte of the command.
            #[must_use]
            pub const fn code(self) -> u8 {
                match self {
                    $(Self::$name => $code,)*
                    Self::Unknown(code) => code,
                }
            }

            /// Returns the command with this id byte.
            // Used in several places, so it is not inlined to save flash.
            #[inline(never)]
            #[must_use]
            pub const fn from_code(code: u8) -> Self {
                match code {
                    $($code => Self::$name,)*
                    code => Self::Unknown(code),
                }
            }

            /// Returns the manual's name of the command, or `script command` for A0h to BFh, which are used by scripts
            /// on the gripper.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$name => $title,)*
                    Self::Unknown(0xA0..=0xBF) => "script command",
                    Self::Unknown(_) => "unknown command",
                }
            }

            /// Returns the section of the command set manual that describes the command, or an empty string for an
            /// unknown one.
            #[must_use]
            pub const fn section(self) -> &'static str {
                match self {
                    $(Self::$name => $section,)*
                    Self::Unknown(_) => "",
                }
            }

            /// Returns the kind of the command. An unknown command counts as a motion because it may move the fingers.
            #[must_use]
            pub const fn kind(self) -> Kind {
                match self {
                    $(Self::$name => Kind::$kind,)*
                    Self::Unknown(_) => Kind::Motion,
                }
            }

            /// Returns the status codes that the manual lists for the first reply.
            #[must_use]
            pub const fn immediate_statuses(self) -> &'static [Status] {
                match self {
                    $(Self::$name => &[$(Status::$immediate),*],)*
                    Self::Unknown(_) => &[Status::CmdUnknown],
                }
            }

            /// Returns the status codes that the manual lists for the second reply; empty if there is no second reply.
            #[must_use]
            pub const fn completion_statuses(self) -> &'static [Status] {
                match self {
                    $(Self::$name => &[$(Status::$completion),*],)*
                    Self::Unknown(_) => &[],
                }
            }

            /// Returns whether the manual lists a second reply.
            pub(crate) const fn has_completion(self) -> bool {
                match self {
                    $(Self::$name => const { <[Status]>::len(&[$(Status::$completion),*]) > 0 },)*
                    Self::Unknown(_) => false,
                }
            }

            /// Returns whether the manual lists this status for the second reply only.
            // By bits, because two lists for each command take more flash.
            pub(crate) const fn is_completion_only(self, status: Status) -> bool {
                let statuses = match self {
                    $(Self::$name => const {
                        bits(&[$(Status::$completion),*]) & !bits(&[$(Status::$immediate),*])
                    },)*
                    Self::Unknown(_) => 0,
                };
                statuses & bit(status) != 0
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
        // A one-byte tag would be followed by eleven more bytes, which are copied one by one in a function call.
        #[repr(u32)]
        pub enum Command<'a> {
            $(
                $(#[$doc])*
                #[doc = ""]
                #[doc = concat!($title, " (", $code, "), ", $section, ".")]
                $name $({ $($(#[$field_doc])* $field: $type),+ })?,
            )*
            /// A command that the manual does not define, as received.
            Unknown {
                /// The id byte of the command.
                id: u8,
                /// The undecoded payload.
                payload: &'a [u8],
            },
        }

        impl<'a> Command<'a> {
            /// Returns the id of the command.
            #[must_use]
            pub const fn id(&self) -> CommandId {
                match self {
                    $(Self::$name { .. } => CommandId::$name,)*
                    Self::Unknown { id, .. } => CommandId::from_code(*id),
                }
            }

            /// Decodes the command in a frame.
            ///
            /// # Errors
            /// Returns a [`DecodeError`] if the payload violates the manual.
            pub fn decode(frame: &Frame<'a>) -> Result<Self, DecodeError> {
                let mut input = frame.payload;
                let command = match CommandId::from_code(frame.id) {
                    $(CommandId::$name => Self::$name $({ $($field: Field::take(&mut input)?),+ })?,)*
                    CommandId::Unknown(id) => Self::Unknown { id, payload: core::mem::take(&mut input) },
                };
                if input.is_empty() { Ok(command) } else { Err(DecodeError::TooLong) }
            }

            /// Checks the parameters as a gripper does: finite numbers, and no undefined bits.
            ///
            /// # Errors
            /// Returns the error that decoding its frame would return.
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

        /// Hashes id and payload.
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
            /// Formats id, name and parameters with their units: `25h Grip Part 20.0 mm 50.0 mm/s`.
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

/// Returns the bit of a status of the manual, and none for another one.
const fn bit(status: Status) -> u32 {
    match 1u32.checked_shl(status.code() as u32) {
        Some(bit) => bit,
        None => 0,
    }
}

/// Returns the bits of these statuses.
const fn bits(mut statuses: &[Status]) -> u32 {
    let mut bits = 0;
    while let [status, rest @ ..] = statuses {
        bits |= bit(*status);
        statuses = rest;
    }
    bits
}

impl CommandId {
    /// Returns whether the manual lists this status code for the first or second reply to this command.
    #[must_use]
    pub fn may_answer(self, status: Status) -> bool {
        self.immediate_statuses().contains(&status) || self.completion_statuses().contains(&status)
    }

    /// Returns whether the command can be sent twice with the same effect as once, so it may be repeated after a lost
    /// reply. For Get Gripping Statistics this requires a request without reset; see [`Command::is_repeatable`].
    #[must_use]
    pub const fn is_repeatable(self) -> bool {
        match self.kind() {
            Kind::Stop | Kind::Query | Kind::Setting => true,
            Kind::Connection => matches!(self, Self::Loop),
            Kind::Motion | Kind::Acknowledge => false,
        }
    }

    /// Returns whether the rest of a half-sent request is still sent after the loss of the connection, because the gripper
    /// would otherwise take the next request for it. This applies to a FAST STOP, which remains due, and to queries, which
    /// neither move the fingers nor change a setting. The rest of any other request must not be sent.
    ///
    /// ```
    /// use wsg_protocol::CommandId;
    ///
    /// assert!(CommandId::FastStop.outlives_connection());
    /// assert!(CommandId::GetForce.outlives_connection());
    /// assert!(!CommandId::GripPart.outlives_connection());
    /// ```
    #[must_use]
    pub const fn outlives_connection(self) -> bool {
        matches!(self, Self::FastStop) || matches!(self.kind(), Kind::Query)
    }

    /// Returns the status code with which a gripper rejects a request with this error, according to the manual.
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
    /// Formats the id as in the manual, and the name: `25h Grip Part`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:02X}h {}", self.code(), self.name())
    }
}

/// The ready-to-send form of [`Command::Acknowledge`].
impl Command<'_> {
    /// A request that acknowledges a FAST STOP or a fault.
    pub const ACKNOWLEDGE: Self = Self::Acknowledge { key: AckKey };

    /// Returns whether the command can be sent twice with the same effect as once, so it may be repeated after a lost
    /// reply.
    ///
    /// ```
    /// use wsg_protocol::Command;
    ///
    /// assert!(Command::GetGrippingStatistics { reset: false }.is_repeatable());
    /// // The statistics in the lost reply would be gone.
    /// assert!(!Command::GetGrippingStatistics { reset: true }.is_repeatable());
    /// assert!(!Command::GripPart { width: 20.0, speed: 50.0 }.is_repeatable());
    /// ```
    #[must_use]
    pub const fn is_repeatable(&self) -> bool {
        !matches!(self, Self::GetGrippingStatistics { reset: true }) && self.id().is_repeatable()
    }

    /// Maximum payload length in bytes of a request with fixed length (all but Loop, Set Device Tag and unknown
    /// commands): that of Pre-position Fingers.
    pub const MAX_FIXED_LEN: usize = 9;
}

#[cfg(test)]
mod tests;
