//! Encoding of single values in a payload: little endian, exact length, validated (command set, chapter 1).

use crate::Number;
use core::fmt::{Display, Formatter};

/// The reason why a payload was rejected.
///
/// The checksum alone misses about one in 14 800 random corruptions. Every payload is therefore checked for its exact
/// length, enumerated values, reserved bits and finite numbers before use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
#[non_exhaustive]
pub enum DecodeError {
    /// The payload is shorter than its parameters.
    TooShort,
    /// The payload is longer than its parameters, or than the manual allows.
    TooLong,
    /// An enumerated value is not defined by the manual.
    UndefinedValue,
    /// A reserved bit is set.
    ReservedBits,
    /// A floating-point number is infinite or NaN.
    NotFinite,
    /// The acknowledge key is not `ack`.
    AckKey,
    /// A device tag has more than 64 characters.
    TagTooLong,
    /// A text contains a control character or a non-ASCII character.
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

/// A value encoded in a payload.
pub(crate) trait Field<'a>: Sized + Display {
    /// Returns the encoded length in bytes.
    fn len(&self) -> usize;

    /// Returns the encoded byte at `index`, or 0 at or past the end.
    fn byte(&self, index: usize) -> u8;

    /// Decodes the value from the front of `input` and advances it.
    fn take(input: &mut &'a [u8]) -> Result<Self, DecodeError>;

    /// Validates the value like [`take`](Self::take), apart from the length.
    fn check(&self) -> Result<(), DecodeError> {
        Ok(())
    }

    /// Formats the value as readable text.
    fn describe(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        self.fmt(f)
    }
}

/// Removes `N` bytes from the front of `input` and returns them.
pub(crate) fn take_bytes<const N: usize>(input: &mut &[u8]) -> Result<[u8; N], DecodeError> {
    let (bytes, rest) = input.split_first_chunk::<N>().ok_or(DecodeError::TooShort)?;
    *input = rest;
    Ok(*bytes)
}

/// Implements [`Field`] for types of fixed length, from a conversion to bytes and back.
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

/// Rejects infinities and NaN.
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
        write!(f, "{:.1}", Number(*self))
    }
}

/// A flag in one bit; the seven other bits are reserved.
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
