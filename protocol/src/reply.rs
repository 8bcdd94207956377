//! Replies: a status code and, on success, the requested values (command set, 1.2.2).

use crate::command::CommandId;
use crate::field::{DecodeError, Field};
use crate::frame::{Frame, Payload};
use crate::table::for_each_command;
use crate::types::{
    DeviceTag, FingerData, FingerFlags, FingerInfo, GripperState, GrippingStatistics, LoopData, SoftLimits,
    Status, SystemFlags, SystemInfo, SystemLimits, Temperature,
};

/// Length of the status code in bytes.
const STATUS_LEN: usize = 2;

macro_rules! define_replies {
    ($(
        $(#[$doc:meta])*
        $code:literal $name:ident $title:literal $section:literal $kind:ident
            request $({ $($(#[$field_doc:meta])* $field:ident: $type:ty = $unit:literal),+ })?
            reply $(($value:ty $(= $value_unit:literal)?))?
            immediate [$($immediate:ident),*] completion [$($completion:ident),*];
    )*) => {
        /// The values of a successful reply: one variant per command.
        #[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
        pub enum Value<'a> {
            $(#[doc = concat!("Of ", $title, " (", $code, "), ", $section, ".")] $name $(($value))?,)*
            /// The parameters of a command that the manual does not define, as received.
            Unknown {
                /// The id byte of the command.
                id: u8,
                /// The undecoded bytes after the status code.
                parameters: &'a [u8],
            },
        }

        impl<'a> Value<'a> {
            /// Returns the id of the command.
            #[must_use]
            pub const fn id(&self) -> CommandId {
                match self {
                    $(Self::$name { .. } => CommandId::$name,)*
                    Self::Unknown { id, .. } => CommandId::from_code(*id),
                }
            }

            fn take(id: CommandId, input: &mut &'a [u8]) -> Result<Self, DecodeError> {
                Ok(match id {
                    $(CommandId::$name => Self::$name $((<$value as Field>::take(input)?))?,)*
                    CommandId::Unknown(id) => Self::Unknown { id, parameters: core::mem::take(input) },
                })
            }

            fn len(&self) -> usize {
                match self {
                    $(define_replies!(@pattern $name value $($value)?) => {
                        0usize $(.saturating_add(<$value as Field>::len(value)))?
                    })*
                    Self::Unknown { parameters, .. } => parameters.len(),
                }
            }

            fn byte(&self, index: usize) -> u8 {
                match self {
                    $(define_replies!(@pattern $name value $($value)?) => {
                        let _byte = 0;
                        $(let _byte = <$value as Field>::byte(value, index);)?
                        _byte
                    })*
                    Self::Unknown { parameters, .. } => Payload::byte(parameters, index),
                }
            }

            fn describe(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    $(define_replies!(@pattern $name value $($value)?) => {
                        $(
                            f.write_str(" ")?;
                            <$value as Field>::describe(value, f)?;
                            $(f.write_str(concat!(" ", $value_unit))?;)?
                        )?
                    })*
                    Self::Unknown { parameters, .. } => write!(f, " {} bytes", parameters.len())?,
                }
                Ok(())
            }
        }
    };
    (@pattern $name:ident $binding:ident $value:ty) => { Self::$name($binding) };
    (@pattern $name:ident $binding:ident) => { Self::$name };
}

for_each_command!(define_replies);

/// The reply of a gripper to one request.
///
/// ```
/// use wsg_protocol::{CommandId, Frame, Reply, Status, Value};
///
/// // The manual's third example: 150.0 mm/s², with the id printed there.
/// let reply = Reply::decode(&Frame { id: 0x31, payload: &[0, 0, 0, 0, 0x16, 0x43] }).unwrap();
/// assert_eq!(reply.value(), Some(Value::GetAcceleration(150.0)));
/// // A grip that found no part.
/// let reply = Reply::decode(&Frame { id: 0x25, payload: &[18, 0] }).unwrap();
/// assert_eq!((reply.id(), reply.status()), (CommandId::GripPart, Status::CmdFailed));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
pub struct Reply<'a> {
    id: CommandId,
    status: Status,
    value: Option<Value<'a>>,
}

impl<'a> Reply<'a> {
    /// Creates a reply with E_SUCCESS and these values.
    #[must_use]
    pub const fn success(value: Value<'a>) -> Self {
        Self { id: value.id(), status: Status::Success, value: Some(value) }
    }

    /// Creates a reply without values: E_CMD_PENDING, an error, or E_SUCCESS for a command that returns no values.
    #[must_use]
    pub fn status_only(id: CommandId, status: Status) -> Self {
        let value = match status {
            Status::Success => Value::take(id, &mut &[][..]).ok(),
            _ => None,
        };
        Self { id, status, value }
    }

    /// Returns the id of the command that the reply refers to.
    #[must_use]
    pub const fn id(&self) -> CommandId {
        self.id
    }

    /// Returns the status code of the reply.
    #[must_use]
    pub const fn status(&self) -> Status {
        self.status
    }

    /// Returns the values, or `None` unless the status is E_SUCCESS.
    #[must_use]
    pub const fn value(&self) -> Option<Value<'a>> {
        self.value
    }

    /// Returns a reference to the values, unlike [`value`](Self::value), which copies them.
    pub(crate) const fn value_ref(&self) -> Option<&Value<'a>> {
        self.value.as_ref()
    }

    /// Decodes the reply in a frame.
    ///
    /// # Errors
    /// Returns a [`DecodeError`] if the payload violates the manual: values are missing, too long, undefined or not
    /// finite, or accompany a status other than E_SUCCESS.
    pub fn decode(frame: &Frame<'a>) -> Result<Self, DecodeError> {
        let mut input = frame.payload;
        let id = CommandId::from_code(frame.id);
        let status = Status::take(&mut input)?;
        let value = match status {
            Status::Success => Some(Value::take(id, &mut input)?),
            _ => None,
        };
        if input.is_empty() { Ok(Self { id, status, value }) } else { Err(DecodeError::TooLong) }
    }
}

impl Payload for Reply<'_> {
    fn len(&self) -> usize {
        self.value.map_or(0, |value| value.len()).saturating_add(STATUS_LEN)
    }

    fn byte(&self, index: usize) -> u8 {
        match index.checked_sub(STATUS_LEN) {
            None => Field::byte(&self.status, index),
            Some(index) => self.value.map_or(0, |value| value.byte(index)),
        }
    }
}

impl core::fmt::Display for Reply<'_> {
    /// Formats id, name, status and values with their units: `43h Get Opening Width E_SUCCESS 20.0 mm`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} {}", self.id, self.status)?;
        self.value.map_or(Ok(()), |value| value.describe(f))
    }
}

#[cfg(test)]
mod tests;
