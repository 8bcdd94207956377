//! The values in answers and updates.

use super::form::{Form, Word, notation};
use super::number::{read_float, write_float};
use super::parameters::{check_index, read_index, write_index};
use super::scanner::Scanner;
use super::table::for_each_gcl_command;
use super::{CommandName, ParseError, Text, Topic};
use crate::decimal;
use crate::types::{DeviceTag, FingerFlags, GripperState, GrippingStatistics, SystemFlags};
use core::fmt::{Formatter, Result as Written, Write};

macro_rules! define_values {
    ($(
        $(#[$doc:meta])*
        $name:ident $text:literal $section:literal $kind:ident
            $(unit $unit:ident)? $(with ($parameters:ty))?
            answers [$($answer:ident),*] value ($($value:ty)?);
    )*) => { define_values!(@rows [] $([$(#[$doc])* $name $text $section ($($value)?)])*); };
    // Skips rows without a value.
    (@rows [$($kept:tt)*] [$(#[$doc:meta])* $name:ident $text:literal $section:literal ()] $($rest:tt)*) => {
        define_values!(@rows [$($kept)*] $($rest)*);
    };
    (@rows [$($kept:tt)*] [$(#[$doc:meta])* $name:ident $text:literal $section:literal ($value:ty)] $($rest:tt)*) => {
        define_values!(@rows [$($kept)* ($(#[$doc])* $name $text $section $value)] $($rest)*);
    };
    (@rows [$(($(#[$doc:meta])* $name:ident $text:literal $section:literal $value:ty))*]) => {
        /// A value in an answer or an automatic update.
        #[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
        pub enum Value<'a> {
            $(
                $(#[$doc])*
                #[doc = ""]
                #[doc = concat!("`", $text, "`, ", $section, ".")]
                $name($value),
            )*
        }

        impl<'a> Value<'a> {
            /// Returns the name of the command that queries the value.
            #[must_use]
            pub const fn name(&self) -> CommandName {
                match self {
                    $(Self::$name(_) => CommandName::$name,)*
                }
            }

            fn forms(name: CommandName) -> &'static [&'static str] {
                match name {
                    $(CommandName::$name => <$value as Form<'a>>::FORMS,)*
                    _ => &[],
                }
            }

            /// Parses the text after the name.
            pub(super) fn read(name: CommandName, input: &mut Scanner<'a>) -> Result<Self, ParseError> {
                match name {
                    $(CommandName::$name => <$value as Form>::read(input).map(Self::$name),)*
                    _ => Err(ParseError::Form),
                }
            }

            /// Writes the text after the name.
            pub(super) fn write(&self, to: &mut impl Write) -> Written {
                match self {
                    $(Self::$name(value) => <$value as Form>::write(value, to),)*
                }
            }

            /// Checks that a controller can parse the value: finite numbers and valid indices.
            ///
            /// # Errors
            /// Returns the error that parsing it would find.
            pub fn check(&self) -> Result<(), ParseError> {
                match self {
                    $(Self::$name(value) => <$value as Form>::check(value),)*
                }
            }
        }
    };
}

for_each_gcl_command!(define_values);

impl Value<'_> {
    /// Returns whether an update may carry it: a complete value that supports AUTOSEND.
    pub(super) fn is_of_an_update(&self) -> bool {
        Topic::of(self.name()).is_some() && !matches!(self, Self::Sysflags(Selected::One(..)))
    }
}

impl CommandName {
    /// Returns the forms that may follow the name in the answer, in the manual's notation. Empty for a command that is only
    /// acknowledged.
    #[must_use]
    pub fn value_forms(self) -> &'static [&'static str] {
        Value::forms(self)
    }
}

impl core::fmt::Display for Value<'_> {
    /// Writes name and value: `POS=20.0`.
    fn fmt(&self, f: &mut Formatter<'_>) -> Written {
        f.write_str(self.name().text())?;
        self.write(f)
    }
}

/// A vector of `LEN` elements, or one element.
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
pub enum Selected<Whole, Element, const LEN: u8> {
    /// The complete vector.
    All(Whole),
    /// The element with this index, counted from 0.
    One(u8, Element),
}

impl<'a, Whole: Word<'a>, Element: Word<'a>, const LEN: u8> Form<'a> for Selected<Whole, Element, LEN> {
    const FORMS: &'static [&'static str] = &[Whole::ASSIGNED, Element::INDEXED];

    fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
        if input.take(b'[') {
            let index = read_index::<LEN>(input)?;
            input.expect(b'=')?;
            Element::read(input).map(|element| Self::One(index, element))
        } else {
            input.expect(b'=')?;
            Whole::read(input).map(Self::All)
        }
    }

    fn write(&self, to: &mut impl Write) -> Written {
        match self {
            Self::All(whole) => {
                to.write_char('=')?;
                whole.write(to)
            }
            Self::One(index, element) => {
                write_index(*index, to)?;
                to.write_char('=')?;
                element.write(to)
            }
        }
    }

    fn check(&self) -> Result<(), ParseError> {
        match self {
            Self::All(whole) => whole.check(),
            Self::One(index, element) => {
                check_index::<LEN>(*index)?;
                element.check()
            }
        }
    }
}

/// The measurement of a finger (GCL, 3.4.1). Its form depends on the type of finger.
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
pub enum FingerReading<'a> {
    /// The force in N of a WSG-FMF.
    Number(f32),
    /// The tactile data of a WSG-DSA. The manual does not define the order.
    Vector(Vector<'a>),
}

/// A vector of any depth, in its text form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct Vector<'a>(&'a str);

impl<'a> Vector<'a> {
    /// The empty vector: a finger without data.
    pub const EMPTY: Vector<'static> = Vector("");

    /// Returns the vector with these elements, given as the text between its brackets.
    ///
    /// ```
    /// use wsg_protocol::gcl::{ParseError, Vector};
    ///
    /// let tactile = Vector::new("[0,12],[3,0.5]").unwrap();
    /// assert_eq!(tactile.numbers().collect::<Vec<_>>(), [0.0, 12.0, 3.0, 0.5]);
    /// assert_eq!(Vector::new("1]"), Err(ParseError::Form));
    /// ```
    ///
    /// # Errors
    /// [`ParseError::Form`] for anything but numbers, commas, blanks and pairs of brackets.
    pub fn new(elements: &'a str) -> Result<Self, ParseError> {
        let mut input = Scanner::new(elements.as_bytes());
        let inside = input.inside_brackets();
        input.end()?;
        if inside.len() == elements.len() { Ok(Self(elements)) } else { Err(ParseError::Form) }
    }

    /// Returns the text between the brackets.
    #[must_use]
    pub const fn as_str(self) -> &'a str {
        self.0
    }

    /// Returns the numbers from left to right, at any depth. Other words are skipped.
    pub fn numbers(self) -> impl Iterator<Item = f32> + 'a {
        let words = self.0.split(|c: char| !matches!(c, '0'..='9' | '+' | '-' | '.' | 'e' | 'E'));
        words.filter_map(|word| decimal::read(word.as_bytes())).filter(|number| number.is_finite())
    }
}

impl<'a> Word<'a> for FingerReading<'a> {
    notation!("<data>");

    fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
        if !input.take(b'[') {
            return read_float(input).map(Self::Number);
        }
        let inside = input.inside_brackets();
        input.expect(b']')?;
        let inside = core::str::from_utf8(inside).map_err(|_| ParseError::Form)?;
        Ok(Self::Vector(Vector(inside)))
    }

    fn write(&self, to: &mut impl Write) -> Written {
        match self {
            Self::Number(number) => write_float(*number, to),
            Self::Vector(vector) => {
                to.write_char('[')?;
                to.write_str(vector.0)?;
                to.write_char(']')
            }
        }
    }

    fn check(&self) -> Result<(), ParseError> {
        match self {
            Self::Number(number) => Word::check(number),
            Self::Vector(_) => Ok(()),
        }
    }
}

/// Parses a vector of flags, starting with bit 0. The manual defines the maximum number of flags; missing ones are 0.
fn read_flags(input: &mut Scanner<'_>, most: u32) -> Result<u32, ParseError> {
    let mut bits = 0;
    input.expect(b'[')?;
    for index in 0..most {
        if index > 0 && !input.take(b',') {
            break;
        }
        let flag: bool = Word::read(input)?;
        bits |= u32::from(flag).wrapping_shl(index);
    }
    input.expect(b']')?;
    Ok(bits)
}

fn write_flags(bits: u32, count: u32, to: &mut impl Write) -> Written {
    to.write_char('[')?;
    for index in 0..count {
        if index > 0 {
            to.write_char(',')?;
        }
        Word::write(&(bits.wrapping_shr(index) & 1 == 1), to)?;
    }
    to.write_char(']')
}

impl Word<'_> for SystemFlags {
    notation!("[<bool>,...,<bool>]");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        read_flags(input, u32::BITS).map(Self::from_bits_retain)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_flags(self.bits(), u32::BITS, to)
    }
}

impl Word<'_> for FingerFlags {
    notation!("[<bool>,...,<bool>]");

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let bits = u16::try_from(read_flags(input, u16::BITS)?).map_err(|_| ParseError::Range)?;
        Ok(Self::from_bits_retain(bits))
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_flags(self.bits().into(), u16::BITS, to)
    }
}

/// Implements `Word` for a pair of values, one for each finger.
macro_rules! of_both_fingers {
    ($($type:ty = $notation:literal),*) => {
        $(impl<'a> Word<'a> for [$type; 2] {
            notation!($notation);

            fn read(input: &mut Scanner<'a>) -> Result<Self, ParseError> {
                input.expect(b'[')?;
                let first = Word::read(input)?;
                input.expect(b',')?;
                let second = Word::read(input)?;
                input.expect(b']')?;
                Ok([first, second])
            }

            fn write(&self, to: &mut impl Write) -> Written {
                let [first, second] = self;
                to.write_char('[')?;
                Word::write(first, to)?;
                to.write_char(',')?;
                Word::write(second, to)?;
                to.write_char(']')
            }

            fn check(&self) -> Result<(), ParseError> {
                self.iter().try_for_each(Word::check)
            }
        })*
    };
}

of_both_fingers!(
    FingerReading<'a> = "[<data>,<data>]",
    Text<'a> = "[<string>,<string>]",
    FingerFlags = "[[<bool>,...,<bool>],[<bool>,...,<bool>]]"
);
