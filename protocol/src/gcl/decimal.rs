//! Decimal numbers to `f32`.
//!
//! Not by `core`: its reader takes 20 KB of flash beside the rest, most of it tables, and keeps a path to a panic. Here a
//! number of up to 12 decimals and 19 digits becomes the nearest `f32`, a tie the even one. Where there are more, the error
//! before rounding is below 2^-56 of the value, so that at worst the neighbour is taken, for one number in 2^30.

/// The most digits that are taken in; what comes behind only says that there is more.
const MOST_DIGITS: u64 = 1_000_000_000_000_000_000;

/// Past these powers of ten, 19 digits or one, a number is infinite or zero.
const LARGEST_EXPONENT: i32 = 39;
const SMALLEST_EXPONENT: i32 = -65;

/// The number that this word is: a sign, digits with a point or without, an exponent. Infinite past the largest.
pub(super) fn read(word: &[u8]) -> Option<f32> {
    let (is_negative, word) = sign(word);
    let end = word.iter().position(|byte| matches!(byte, b'e' | b'E')).unwrap_or(word.len());
    let (number, rest) = word.split_at_checked(end)?;
    let exponent = match rest.split_first() {
        Some((_, power)) => read_exponent(power)?,
        None => 0,
    };
    let magnitude = Digits::read(number, exponent)?.nearest();
    Some(if is_negative { -magnitude } else { magnitude })
}

fn sign(word: &[u8]) -> (bool, &[u8]) {
    match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, word),
    }
}

fn read_exponent(word: &[u8]) -> Option<i32> {
    let (is_negative, word) = sign(word);
    if word.is_empty() {
        return None;
    }
    let magnitude = word.iter().try_fold(0i32, |value, byte| {
        let digit = byte.is_ascii_digit().then(|| i32::from(byte & 0x0F))?;
        Some(value.saturating_mul(10).saturating_add(digit))
    })?;
    Some(if is_negative { magnitude.saturating_neg() } else { magnitude })
}

/// `value` times ten to the power of `exponent`, and perhaps a little more.
struct Digits {
    value: u64,
    exponent: i32,
    has_more: bool,
}

impl Digits {
    fn read(number: &[u8], exponent: i32) -> Option<Self> {
        let mut digits = Self { value: 0, exponent, has_more: false };
        let (mut has_digit, mut behind_point) = (false, false);
        for byte in number {
            match byte {
                b'.' if !behind_point => behind_point = true,
                b'0'..=b'9' => {
                    has_digit = true;
                    digits.push(u64::from(byte & 0x0F), behind_point);
                }
                _ => return None,
            }
        }
        has_digit.then_some(digits)
    }

    fn push(&mut self, digit: u64, behind_point: bool) {
        if self.value < MOST_DIGITS {
            self.value = self.value.wrapping_mul(10).wrapping_add(digit);
            self.exponent = self.exponent.saturating_sub(i32::from(behind_point));
        } else {
            self.has_more |= digit != 0;
            self.exponent = self.exponent.saturating_add(i32::from(!behind_point));
        }
    }

    fn nearest(&self) -> f32 {
        if self.value == 0 || self.exponent < SMALLEST_EXPONENT {
            return 0.0;
        }
        if self.exponent > LARGEST_EXPONENT {
            return f32::INFINITY;
        }
        let mut binary = Binary { mantissa: self.value, exponent: 0, has_more: self.has_more };
        binary.normalize();
        for _ in 0..self.exponent.unsigned_abs() {
            if self.exponent < 0 {
                binary.divide_by_ten();
            } else {
                binary.multiply_by_ten();
            }
        }
        binary.round()
    }
}

/// `mantissa` times two to the power of `exponent`, and perhaps a little more. The mantissa's highest bit is set.
struct Binary {
    mantissa: u64,
    exponent: i32,
    has_more: bool,
}

impl Binary {
    fn normalize(&mut self) {
        let zeros = self.mantissa.leading_zeros();
        self.mantissa = self.mantissa.unbounded_shl(zeros);
        self.exponent = self.exponent.wrapping_sub(zeros as i32);
    }

    /// The remainder is taken in as three more bits.
    fn divide_by_ten(&mut self) {
        let remainder = (self.mantissa % 10).wrapping_mul(8);
        self.mantissa = (self.mantissa / 10).wrapping_mul(8).wrapping_add(remainder / 10);
        self.has_more |= !remainder.is_multiple_of(10);
        self.exponent = self.exponent.wrapping_sub(3);
        self.normalize();
    }

    /// As ten sixteenths, which is five eighths.
    fn multiply_by_ten(&mut self) {
        let eighths = (self.mantissa % 8).wrapping_mul(5);
        self.mantissa = (self.mantissa / 8).wrapping_mul(5).wrapping_add(eighths / 8);
        self.has_more |= !eighths.is_multiple_of(8);
        self.exponent = self.exponent.wrapping_add(4);
        self.normalize();
    }

    fn round(&self) -> f32 {
        const FRACTION_BITS: u32 = f32::MANTISSA_DIGITS - 1;
        let exponent = self.exponent.wrapping_add(63);
        let below_normal = f32::MIN_EXP.wrapping_sub(1).saturating_sub(exponent);
        // The bits below those of the result; more where it has no leading one.
        let dropped = 40u32.wrapping_add(below_normal.max(0) as u32);
        let kept = self.mantissa.unbounded_shr(dropped);
        let rest = self.mantissa ^ kept.unbounded_shl(dropped);
        let half = 1u64.unbounded_shl(dropped.wrapping_sub(1));
        let is_odd = kept & 1 == 1;
        let up = half != 0 && (rest > half || rest == half && (self.has_more || is_odd));
        let significand = kept.wrapping_add(u64::from(up));
        // The leading one counts one up in the exponent, and so does a carry.
        let biased = exponent.wrapping_add(f32::MAX_EXP).wrapping_sub(2).max(0) as u64;
        let bits = biased.unbounded_shl(FRACTION_BITS).wrapping_add(significand);
        f32::from_bits((bits as u32).min(f32::INFINITY.to_bits()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::String;

    #[test]
    fn what_lies_between_two_numbers_goes_to_the_even_one_and_a_little_more_goes_up() {
        for (text, value) in [
            ("16777217", 16_777_216.0),
            ("16777219", 16_777_220.0),
            ("16777217.0000000001", 16_777_218.0),
            ("16777217.00000000000000000000000001", 16_777_218.0),
            ("0.000000059604644775390625", 5.960_464_5e-8),
            ("340282346638528859811704183484516925440", f32::MAX),
            ("340282356779733661000000000000000000000", f32::MAX),
            ("340282356779733662000000000000000000000", f32::INFINITY),
            ("1e-46", 0.0),
            ("1e99999999999", f32::INFINITY),
            ("1e-99999999999", 0.0),
            ("0e99999999999", 0.0),
        ] {
            assert_eq!(read(text.as_bytes()), Some(value), "{text}");
        }
    }

    #[test]
    fn half_of_the_least_number_is_none_and_more_than_half_is_it() {
        // 2^-150 is 7.006492321624085e-46.
        for (text, bits) in [("7.0064923216240853e-46", 0), ("7.0064923216240854e-46", 1), ("1.4e-45", 1)] {
            assert_eq!(read(text.as_bytes()).map(f32::to_bits), Some(bits), "{text}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn numbers_are_those_that_core_reads(
            sign in "[-+]?",
            whole in "[0-9]{0,9}",
            decimals in "[0-9]{1,12}",
            exponent in prop::option::of(-60i32..45),
        ) {
            let exponent = exponent.map_or(String::new(), |exponent| std::format!("e{exponent}"));
            let text = std::format!("{sign}{whole}.{decimals}{exponent}");
            let expected: f32 = text.parse().unwrap();
            prop_assert_eq!(read(text.as_bytes()).map(f32::to_bits), Some(expected.to_bits()), "{}", text);
        }

        #[test]
        fn words_are_numbers_where_core_says_so(word in "[-+.eE0-9]{0,12}") {
            prop_assert_eq!(read(word.as_bytes()).map(f32::to_bits), word.parse().ok().map(f32::to_bits));
        }
    }
}
