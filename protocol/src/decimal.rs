//! Converts decimal digits to the nearest `f32`, with little code and no panic path.
//!
//! The libraries tried (`core`, `fast-float2`, `lexical-parse-float`, `minimal-lexical`) keep panics after optimization and
//! need several times the flash. Their tables buy speed, which one number per line does not need. This module computes the
//! number digit by digit in fixed point, from the largest `f32` to below the smallest, and rounds once. The tests compare it
//! with `core`.

/// Words of the integer part: 128 bits hold every `f32`.
const WHOLE_WORDS: usize = 4;
/// Words of the fraction: below the last bit of the smallest `f32`, 2^-149, with room to round.
const FRACTION_WORDS: usize = 5;
const FRACTION_BITS: u32 = 160;
const _: () = assert!(FRACTION_BITS as usize == 32 * FRACTION_WORDS && FRACTION_BITS > 149 + 2);

/// Maximum number of integer digits: `f32::MAX` has 39.
const MOST_WHOLE_DIGITS: i32 = 39;
/// Maximum number of zeros after the point. Half of the smallest `f32` is 7.0e-46, so smaller numbers round to 0.
const MOST_LEADING_ZEROS: i32 = 46;

/// Bits of a significand, including the leading one.
const SIGNIFICAND_BITS: u32 = 24;
/// The lowest significant bit: 2^-149.
const LOWEST_BIT: u32 = FRACTION_BITS - 149;

/// Returns the nearest `f32`, with ties to even, or infinity if the number is too large. Returns `None` for an invalid number.
/// Accepts a sign, digits with an optional point, and an exponent.
pub(crate) fn read(text: &[u8]) -> Option<f32> {
    let (negative, unsigned) = sign(text);
    let mantissa_len = unsigned.iter().position(|byte| matches!(byte, b'e' | b'E')).unwrap_or(unsigned.len());
    let (mantissa, exponent) = unsigned.split_at_checked(mantissa_len)?;
    let exponent = match exponent.split_first() {
        Some((_, digits)) => integer(digits)?,
        None => 0,
    };
    let point = mantissa.iter().position(|&byte| byte == b'.');
    let digits = Digits {
        whole: mantissa.get(..point.unwrap_or(mantissa.len()))?,
        fraction: point.map_or(Some(&[][..]), |point| mantissa.get(point.wrapping_add(1)..))?,
    };
    let magnitude = if digits.are_a_number() { digits.times_ten_to_the(exponent) } else { return None };
    Some(if negative { -magnitude } else { magnitude })
}

/// Returns whether the text starts with a minus, and the text after the sign.
fn sign(text: &[u8]) -> (bool, &[u8]) {
    match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        rest => (false, rest),
    }
}

/// Parses an exponent. The value saturates.
fn integer(text: &[u8]) -> Option<i32> {
    let (negative, digits) = sign(text);
    if digits.is_empty() || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let magnitude = digits.iter().fold(0i32, |value, digit| {
        value.saturating_mul(10).saturating_add(i32::from(digit.wrapping_sub(b'0')))
    });
    Some(if negative { magnitude.wrapping_neg() } else { magnitude })
}

/// The digits before and after the point.
struct Digits<'a> {
    whole: &'a [u8],
    fraction: &'a [u8],
}

impl Digits<'_> {
    fn are_a_number(&self) -> bool {
        let mut all = self.whole.iter().chain(self.fraction);
        self.len() > 0 && all.all(u8::is_ascii_digit)
    }

    const fn len(&self) -> usize {
        self.whole.len().saturating_add(self.fraction.len())
    }

    /// Returns the digit at this index, or 0 past the last one.
    fn at(&self, index: usize) -> u32 {
        let behind = || self.fraction.get(index.wrapping_sub(self.whole.len()));
        self.whole.get(index).or_else(behind).map_or(0, |digit| u32::from(digit.wrapping_sub(b'0')))
    }

    fn times_ten_to_the(&self, exponent: i32) -> f32 {
        let zeros = self.whole.iter().chain(self.fraction).take_while(|&&digit| digit == b'0').count();
        if zeros == self.len() {
            return 0.0;
        }
        // Digits from the first non-zero one to the point. If negative, zeros from the point to that digit.
        let distance = (self.whole.len() as i32).wrapping_sub(zeros as i32).saturating_add(exponent);
        if distance > MOST_WHOLE_DIGITS {
            return f32::INFINITY;
        }
        if distance < -MOST_LEADING_ZEROS {
            return 0.0;
        }
        let mut value = Fixed::ZERO;
        let point = zeros.saturating_add(distance.max(0) as usize);
        // Shift the fraction in from its last digit to the first.
        for index in (point..self.len()).rev() {
            value.push_fraction_digit(self.at(index));
        }
        for _ in distance..0 {
            value.push_fraction_digit(0);
        }
        for index in zeros..point {
            if value.append_before_the_point(self.at(index)).is_none() {
                return f32::INFINITY;
            }
        }
        value.rounded()
    }
}

/// A non-negative fixed-point number with enough bits before and after the point.
struct Fixed {
    /// The lowest word is first.
    words: [u32; WHOLE_WORDS + FRACTION_WORDS],
    /// Non-zero bits below the last one were dropped.
    inexact: bool,
}

impl Fixed {
    const ZERO: Self = Self { words: [0; WHOLE_WORDS + FRACTION_WORDS], inexact: false };

    /// Replaces the fraction by (digit + fraction) / 10, while the integer part is 0.
    ///
    /// The remainder of a division cannot change a later quotient, so only its being non-zero is recorded.
    fn push_fraction_digit(&mut self, digit: u32) {
        let mut remainder = u64::from(digit);
        for word in self.words.iter_mut().take(FRACTION_WORDS).rev() {
            let dividend = (remainder << 32) | u64::from(*word);
            *word = (dividend / 10) as u32;
            remainder = dividend % 10;
        }
        self.inexact |= remainder != 0;
    }

    /// Multiplies the integer part by ten and adds the digit. Returns `None` on overflow.
    fn append_before_the_point(&mut self, digit: u32) -> Option<()> {
        let mut carry = u64::from(digit);
        for word in self.words.iter_mut().skip(FRACTION_WORDS) {
            let product = u64::from(*word).wrapping_mul(10).wrapping_add(carry);
            *word = product as u32;
            carry = product >> 32;
        }
        (carry == 0).then_some(())
    }

    fn rounded(&self) -> f32 {
        let Some(highest) = self.highest_bit() else { return 0.0 };
        let lowest = highest.saturating_sub(SIGNIFICAND_BITS - 1).max(LOWEST_BIT);
        let significand = self.bits_from(lowest) & ((1 << SIGNIFICAND_BITS) - 1);
        let half = self.bits_from(lowest.wrapping_sub(1)) & 1 != 0;
        let more = self.inexact || self.has_bits_below(lowest.wrapping_sub(1));
        let up = half && (more || significand & 1 != 0);
        // Without a leading one (a subnormal number) the exponent field is 0; with it, the field is 1 from 2^-149. A carry
        // from the significand increments the field, up to infinity.
        let exponent = lowest.wrapping_sub(LOWEST_BIT);
        let bits = (exponent << (SIGNIFICAND_BITS - 1)).wrapping_add(significand).wrapping_add(up.into());
        f32::from_bits(bits.min(f32::INFINITY.to_bits()))
    }

    fn highest_bit(&self) -> Option<u32> {
        let index = self.words.iter().rposition(|&word| word != 0)?;
        let word = self.words.get(index)?;
        Some((index as u32).wrapping_mul(32).wrapping_add(31u32.wrapping_sub(word.leading_zeros())))
    }

    /// Returns 32 bits, starting at this one.
    fn bits_from(&self, bit: u32) -> u32 {
        let index = (bit / 32) as usize;
        let word = |index: usize| self.words.get(index).copied().map_or(0, u64::from);
        let both = word(index.wrapping_add(1)) << 32 | word(index);
        (both >> (bit % 32)) as u32
    }

    fn has_bits_below(&self, bit: u32) -> bool {
        let mut whole_words = self.words.iter().take((bit / 32) as usize);
        let rest = self.bits_from(bit & !31) & !(u32::MAX << (bit % 32));
        rest != 0 || whole_words.any(|&word| word != 0)
    }
}

#[cfg(test)]
mod tests;
