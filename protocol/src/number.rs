//! Numbers in texts, with little code and no panic path: `core` formats them with 20 KB of code and tables.

use core::fmt::{Display, Formatter};
use core::num::NonZeroU64;

/// Greatest number of decimals. The smallest number without an exponent has 9 digits after 4 zeros.
const MOST_DECIMALS: usize = 13;
const TEN: NonZeroU64 = NonZeroU64::MIN.saturating_add(9);
/// From here on, a number has the digits of the power of ten that it is the nearest `f32` of.
const NEARLY_ONE: f64 = 1.0 - f32::EPSILON as f64 / 2.0;

/// A number that is formatted with the fewest decimals that read as the same number, or with a precision, such as `{:.1}`.
///
/// ```
/// use wsg_protocol::Number;
///
/// assert_eq!(format!("{} {} {:.1}", Number(0.1), Number(-1.5e-7), Number(20.0)), "0.1 -1.5e-7 20.0");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number(pub f32);

impl Display for Number {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        let Self(number) = *self;
        if number.is_nan() {
            return f.write_str("NaN");
        }
        f.write_str(if number.is_sign_negative() { "-" } else { "" })?;
        if number.is_infinite() {
            return f.write_str("inf");
        }
        let (mut mantissa, mut unit, mut exponent) = (f64::from(number.abs()), 1.0, 0i32);
        if number.abs() >= 1e15 {
            while mantissa >= 10.0 * NEARLY_ONE {
                (mantissa, unit, exponent) = (mantissa / 10.0, unit * 10.0, exponent.saturating_add(1));
            }
        } else if mantissa > 0.0 && number.abs() < 1e-4 && f.precision().is_none() {
            while mantissa < NEARLY_ONE {
                (mantissa, unit, exponent) = (mantissa * 10.0, unit / 10.0, exponent.saturating_sub(1));
            }
        }
        let (mut decimals, mut scale) = (0usize, NonZeroU64::MIN);
        let digits = loop {
            let digits = rounded(mantissa * scale.get() as f64, f.precision().is_some());
            let read = (digits as f64 / scale.get() as f64 * unit) as f32;
            let is_enough = f.precision().map_or(read == number.abs(), |wanted| decimals >= wanted);
            if is_enough || decimals >= MOST_DECIMALS {
                break digits;
            }
            (decimals, scale) = (decimals.saturating_add(1), scale.saturating_mul(TEN));
        };
        write!(f, "{}", digits / scale)?;
        if decimals > 0 {
            write!(f, ".{:0decimals$}", digits % scale)?;
        }
        if exponent != 0 { write!(f, "e{exponent}") } else { Ok(()) }
    }
}

/// Returns the nearest whole number. `core` rounds ties to even with a precision, and up without.
fn rounded(number: f64, ties_to_even: bool) -> u64 {
    let below = number as u64;
    let rest = number - below as f64;
    let is_tie_up = rest == 0.5 && !(ties_to_even && below.is_multiple_of(2));
    below.saturating_add((rest > 0.5 || is_tie_up).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::format;

    #[test]
    fn numbers_without_digits_and_at_the_ends_of_the_ranges() {
        for (number, text) in [
            (0.0, "0"),
            (-0.0, "-0"),
            (f32::NAN, "NaN"),
            (f32::INFINITY, "inf"),
            (f32::NEG_INFINITY, "-inf"),
            (1e-4, "0.0001"),
            (9.999999e-5, "9.999999e-5"),
            (1e15, "1e15"),
            (1e-5, "1e-5"),
            (1e23, "1e23"),
            (f32::MAX, "3.4028235e38"),
            (f32::MIN_POSITIVE, "1.1754944e-38"),
            (1e-45, "1e-45"),
        ] {
            assert_eq!(format!("{}", Number(number)), text);
        }
        for number in [0.05, 0.25, 0.35, 0.75, -0.04, 99.95, 1e-9] {
            assert_eq!(format!("{:.1}", Number(number)), format!("{number:.1}"));
        }
    }

    proptest! {
        #[test]
        fn text_reads_as_the_same_number(bits: u32) {
            let number = f32::from_bits(bits);
            prop_assume!(number.is_finite());
            prop_assert_eq!(format!("{}", Number(number)).parse::<f32>().map(f32::to_bits), Ok(bits));
        }

        #[test]
        fn text_is_the_text_of_core(number in -1e6f32..1e6) {
            prop_assert_eq!(format!("{:.1}", Number(number)), format!("{number:.1}"));
            prop_assume!(number.abs() >= 1e-4);
            prop_assert_eq!(format!("{}", Number(number)), format!("{number}"));
        }
    }
}
