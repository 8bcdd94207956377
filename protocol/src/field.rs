//! How one value stands in a payload: little endian, exact, checked (command set, chapter 1).

use core::fmt::{Display, Formatter};

/// Why a payload was refused.
///
/// The checksum alone lets about one random corruption in 14 800 through, so every payload is checked for its exact
/// length, its enumerated values, its reserved bits and finite numbers before anything acts on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum DecodeError {
    /// The payload is shorter than the parameters need.
    TooShort,
    /// The payload is longer than the parameters need, or than the manual allows.
    TooLong,
    /// An enumeration has a value that the manual does not list.
    UndefinedValue,
    /// A bit is set that the manual reserves.
    ReservedBits,
    /// A floating point number is infinite or not a number.
    NotFinite,
    /// The acknowledge key is not `ack`.
    AckKey,
    /// A device tag has more than 64 characters.
    TagTooLong,
    /// A text holds a control character, or one that is not ASCII.
    Character,
}

impl Display for DecodeError {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooShort => "payload too short",
            Self::TooLong => "payload too long",
            Self::UndefinedValue => "undefined value",
            Self::ReservedBits => "reserved bits set",
            Self::NotFinite => "number not finite",
            Self::AckKey => "acknowledge key is not \"ack\"",
            Self::TagTooLong => "tag longer than 64 characters",
            Self::Character => "control or non-ASCII character",
        })
    }
}

impl core::error::Error for DecodeError {}

/// A value that stands in a payload.
pub(crate) trait Field<'a>: Sized + Display {
    /// Bytes it takes.
    fn len(&self) -> usize;

    /// Its byte at `index`; 0 at or past the end.
    fn byte(&self, index: usize) -> u8;

    /// Takes it from the front of `input`.
    fn take(input: &mut &'a [u8]) -> Result<Self, DecodeError>;

    /// Whether a receiver may accept it: what [`take`](Self::take) checks beside the length.
    fn check(&self) -> Result<(), DecodeError> {
        Ok(())
    }

    /// Its value as a person reads it.
    fn describe(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        self.fmt(f)
    }
}

/// Takes `N` bytes from the front of `input`.
pub(crate) fn take_bytes<const N: usize>(input: &mut &[u8]) -> Result<[u8; N], DecodeError> {
    let (bytes, rest) = input.split_first_chunk::<N>().ok_or(DecodeError::TooShort)?;
    *input = rest;
    Ok(*bytes)
}

/// Implements [`Field`] for types that are a fixed run of bytes, given how to get to bytes and back.
macro_rules! fixed_field {
    ($type:ty, $len:literal, |$value:ident| $to:expr, |$bytes:ident| $from:expr $(, check |$checked:ident| $check:expr)?) => {
        impl $crate::field::Field<'_> for $type {
            fn len(&self) -> usize {
                $len
            }

            fn byte(&self, index: usize) -> u8 {
                let $value = self;
                let bytes: [u8; $len] = $to;
                bytes.get(index).copied().unwrap_or(0)
            }

            fn take(input: &mut &[u8]) -> Result<Self, $crate::field::DecodeError> {
                let $bytes: [u8; $len] = $crate::field::take_bytes(input)?;
                $from
            }

            $(fn check(&self) -> Result<(), $crate::field::DecodeError> {
                let $checked = self;
                $check
            })?
        }
    };
}
pub(crate) use fixed_field;

/// Refuses what is infinite or not a number.
pub(crate) const fn finite(value: f32) -> Result<f32, DecodeError> {
    if value.is_finite() { Ok(value) } else { Err(DecodeError::NotFinite) }
}

impl Field<'_> for f32 {
    fn len(&self) -> usize {
        4
    }

    fn byte(&self, index: usize) -> u8 {
        self.to_le_bytes().get(index).copied().unwrap_or(0)
    }

    fn take(input: &mut &[u8]) -> Result<Self, DecodeError> {
        finite(Self::from_le_bytes(take_bytes(input)?))
    }

    fn check(&self) -> Result<(), DecodeError> {
        finite(*self).map(|_| ())
    }

    fn describe(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        write!(f, "{self:.1}")
    }
}

/// A switch: one bit, the seven others reserved.
impl Field<'_> for bool {
    fn len(&self) -> usize {
        1
    }

    fn byte(&self, index: usize) -> u8 {
        if index == 0 { u8::from(*self) } else { 0 }
    }

    fn take(input: &mut &[u8]) -> Result<Self, DecodeError> {
        match take_bytes(input)? {
            [0] => Ok(false),
            [1] => Ok(true),
            _ => Err(DecodeError::ReservedBits),
        }
    }

    fn describe(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        f.write_str(if *self { "on" } else { "off" })
    }
}
