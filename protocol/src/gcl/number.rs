//! Numbers as text.
//!
//! [`decimal`] parses a decimal number to the nearest `f32`. `zmij` writes the fewest digits that parse to the same `f32`, so
//! a value survives the transfer. Exponents are accepted but never written: the manual shows none, and a PLC may parse only
//! digits and a point. They are replaced by zeros. Compared with `core::fmt`, `zmij` needs a third of the flash and has no
//! panic path.

use super::ParseError;
use super::scanner::Scanner;
use crate::decimal;
use core::fmt::{Result as Written, Write};

/// Maximum length of a written number: `-0.`, 37 zeros and 9 digits, rounded up.
pub(super) const MAX_FLOAT_LEN: usize = 52;

pub(super) fn read_float(input: &mut Scanner<'_>) -> Result<f32, ParseError> {
    let word = input.word(|byte| matches!(byte, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E'));
    finite(decimal::read(word).ok_or(ParseError::Form)?)
}

/// Rejects infinity and NaN.
pub(super) const fn finite(value: f32) -> Result<f32, ParseError> {
    if value.is_finite() { Ok(value) } else { Err(ParseError::Range) }
}

pub(super) fn read_integer(input: &mut Scanner<'_>) -> Result<u32, ParseError> {
    let word = input.word(|byte| byte.is_ascii_digit());
    if word.is_empty() {
        return Err(ParseError::Form);
    }
    word.iter().try_fold(0u32, |value, digit| {
        let digit = u32::from(digit.wrapping_sub(b'0'));
        value.checked_mul(10).and_then(|tens| tens.checked_add(digit)).ok_or(ParseError::Range)
    })
}

pub(super) fn write_float(value: f32, to: &mut impl Write) -> Written {
    let mut buffer = zmij::Buffer::new();
    let text = buffer.format(value);
    match split_once(text, b'e') {
        None => to.write_str(text),
        Some((digits, exponent)) => write_without_exponent(digits, exponent.parse().unwrap_or(0), to),
    }
}

/// Writes `digits` times ten to the power of `exponent` without an exponent.
fn write_without_exponent(digits: &str, exponent: i8, to: &mut impl Write) -> Written {
    let digits = match digits.strip_prefix('-') {
        Some(digits) => {
            to.write_char('-')?;
            digits
        }
        None => digits,
    };
    let (whole, fraction) = split_once(digits, b'.').unwrap_or((digits, ""));
    let shift = usize::from(exponent.unsigned_abs());
    if exponent < 0 {
        // The point moves left of `whole`, which is a single digit.
        to.write_str("0.")?;
        write_zeros(shift.saturating_sub(1), to)?;
        to.write_str(whole)?;
        to.write_str(fraction)
    } else {
        // `zmij` writes an exponent from 10^13, with 9 digits at most, so the point moves past all of them.
        to.write_str(whole)?;
        to.write_str(fraction)?;
        write_zeros(shift.saturating_sub(fraction.len()), to)?;
        to.write_str(".0")
    }
}

/// Like `str::split_once`, without its panic path.
fn split_once(text: &str, letter: u8) -> Option<(&str, &str)> {
    let at = text.bytes().position(|byte| byte == letter)?;
    Some((text.get(..at)?, text.get(at.wrapping_add(1)..)?))
}

fn write_zeros(count: usize, to: &mut impl Write) -> Written {
    (0..count).try_for_each(|_| to.write_char('0'))
}

pub(super) fn write_integer(value: u32, to: &mut impl Write) -> Written {
    let mut unit = 1_000_000_000u32;
    while unit > value && unit > 1 {
        unit /= 10;
    }
    while unit > 0 {
        let digit = value.checked_div(unit).unwrap_or(0) % 10;
        to.write_char(char::from_digit(digit, 10).unwrap_or('0'))?;
        unit /= 10;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
