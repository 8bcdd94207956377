//! The notation of values in a line (GCL, appendix E), and the forms composed of them.

use super::ParseError;
use super::number::{finite, read_float, read_integer, write_float, write_integer};
use super::scanner::Scanner;
use crate::types::{GripperState, GrippingStatistics};
use core::fmt::{Result as Written, Write};

/// The text after a command name: parameters, a question mark or a value.
pub(super) trait Form<'a>: Sized {
    /// The forms in the manual's notation.
    const FORMS: &'static [&'static str];

    /// Parses the form from the line.
    fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError>;

    fn write(&self, to: &mut impl Write) -> Written;

    /// Checks that the written form parses to the same value.
    fn check(&self) -> Result<(), ParseError> {
        Ok(())
    }
}

/// `()`: no parameters.
pub(super) struct Call;

impl Form<'_> for Call {
    const FORMS: &'static [&'static str] = &["()"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        Parameters::open(input)?.close()?;
        Ok(Self)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_str("()")
    }
}

/// `?`: a query.
pub(super) struct Ask;

impl Form<'_> for Ask {
    const FORMS: &'static [&'static str] = &["?"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        input.expect(b'?')?;
        Ok(Self)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char('?')
    }
}

/// A single value.
pub(super) trait Word<'a>: Sized {
    /// The notation after an equals sign, as in the manual.
    const ASSIGNED: &'static str;
    /// The notation of one element of a vector.
    const INDEXED: &'static str;

    fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError>;

    fn write(&self, to: &mut impl Write) -> Written;

    fn check(&self) -> Result<(), ParseError> {
        Ok(())
    }
}

/// Defines the notation of a word.
macro_rules! notation {
    ($text:literal) => {
        const ASSIGNED: &'static str = concat!("=", $text);
        const INDEXED: &'static str = concat!("[<integer>]=", $text);
    };
}
pub(super) use notation;

/// Implements `Form` for words that follow an equals sign.
macro_rules! assigned {
    ($($type:ty),*) => {
        $(impl<'a> $crate::gcl::form::Form<'a> for $type {
            const FORMS: &'static [&'static str] = &[<Self as $crate::gcl::form::Word<'a>>::ASSIGNED];

            fn read(input: &mut $crate::gcl::scanner::Scanner<'a>) -> Result<Self, $crate::gcl::ParseError> {
                input.expect(b'=')?;
                $crate::gcl::form::Word::read(input)
            }

            fn write(&self, to: &mut impl core::fmt::Write) -> core::fmt::Result {
                to.write_char('=')?;
                $crate::gcl::form::Word::write(self, to)
            }

            fn check(&self) -> Result<(), $crate::gcl::ParseError> {
                $crate::gcl::form::Word::check(self)
            }
        })*
    };
}
pub(super) use assigned;

assigned!(f32, bool, u32, GripperState);

impl Word<'_> for f32 {
    notation!("<float>");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        read_float(input)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_float(*self, to)
    }

    fn check(&self) -> Result<(), ParseError> {
        finite(*self).map(|_| ())
    }
}

impl Word<'_> for u32 {
    notation!("<integer>");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        read_integer(input)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_integer(*self, to)
    }
}

impl Word<'_> for bool {
    notation!("<bool>");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        match read_integer(input)? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(ParseError::Value),
        }
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char(if *self { '1' } else { '0' })
    }
}

impl Word<'_> for GripperState {
    notation!("<integer>");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let code = u8::try_from(read_integer(input)?).map_err(|_| ParseError::Value)?;
        Self::from_code(code).ok_or(ParseError::Value)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_integer(self.code().into(), to)
    }
}

/// `[total, no part, part lost]`.
impl Word<'_> for GrippingStatistics {
    notation!("[<integer>,<integer>,<integer>]");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let short = |count| u16::try_from(count).map_err(|_| ParseError::Range);
        input.expect(b'[')?;
        let total = read_integer(input)?;
        input.expect(b',')?;
        let no_part = short(read_integer(input)?)?;
        input.expect(b',')?;
        let part_lost = short(read_integer(input)?)?;
        input.expect(b']')?;
        Ok(Self { total, no_part, part_lost })
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char('[')?;
        write_integer(self.total, to)?;
        to.write_char(',')?;
        write_integer(self.no_part.into(), to)?;
        to.write_char(',')?;
        write_integer(self.part_lost.into(), to)?;
        to.write_char(']')
    }
}

/// Parses the parameters between parentheses in order.
pub(super) struct Parameters<'s, 'a> {
    input: &'s mut Scanner<'a>,
    taken: bool,
}

impl<'s, 'a> Parameters<'s, 'a> {
    pub(super) fn open(input: &'s mut Scanner<'a>) -> Result<Self, ParseError> {
        input.expect(b'(')?;
        Ok(Self { input, taken: false })
    }

    /// Returns the next parameter, or `None` at the closing parenthesis.
    pub(super) fn optional<T: Word<'a>>(&mut self) -> Result<Option<T>, ParseError> {
        if self.input.peek() == Some(b')') {
            return Ok(None);
        }
        if self.taken {
            self.input.expect(b',')?;
        }
        self.taken = true;
        T::read(self.input).map(Some)
    }

    /// Returns the next parameter, or [`ParseError::TooFew`].
    pub(super) fn required<T: Word<'a>>(&mut self) -> Result<T, ParseError> {
        self.optional()?.ok_or(ParseError::TooFew)
    }

    pub(super) fn close(self) -> Result<(), ParseError> {
        match self.input.peek() {
            Some(b')') => self.input.expect(b')'),
            Some(b',') => Err(ParseError::TooMany),
            // At the position of a first parameter, any text counts as a parameter.
            Some(_) if !self.taken => Err(ParseError::TooMany),
            _ => Err(ParseError::Form),
        }
    }
}

/// Writes parameters between parentheses, up to the first `None`.
pub(super) fn write_parameters(parameters: &[Option<f32>], to: &mut impl Write) -> Written {
    to.write_char('(')?;
    let mut separator = "";
    for value in parameters.iter().map_while(|parameter| *parameter) {
        to.write_str(separator)?;
        write_float(value, to)?;
        separator = ",";
    }
    to.write_char(')')
}
