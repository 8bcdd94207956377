//! From decimal digits to the nearest `f32`, in little code and with no path to a panic.
//!
//! Not by a library: each that was tried (`core`, `fast-float2`, `lexical-parse-float`, `minimal-lexical`) has panics
//! that the compiler keeps, and several times the flash. They are made to be fast with tables, which one number in a line
//! does not need. Here the number is worked out digit by digit as a fixed-point number that holds everything from
//! the largest `f32` down to below the smallest, and rounded once; `core` is the oracle of the tests.

/// Words of the part before the point: 128 bits hold every `f32`.
const WHOLE_WORDS: usize = 4;
/// Words behind it: below the last bit of the smallest `f32`, 2^-149, there is room to round.
const FRACTION_WORDS: usize = 5;
const FRACTION_BITS: u32 = 160;
const _: () = assert!(FRACTION_BITS as usize == 32 * FRACTION_WORDS && FRACTION_BITS > 149 + 2);

/// The point stands so far right of the first digit at the most: `f32::MAX` has 39 digits.
const MOST_WHOLE_DIGITS: i32 = 39;
/// Half of the smallest `f32` is 7.0e-46, so what begins further behind the point is 0.
const MOST_LEADING_ZEROS: i32 = 46;

/// Bits of a significand, the leading one included.
const SIGNIFICAND_BITS: u32 = 24;
/// The lowest bit that counts: 2^-149.
const LOWEST_BIT: u32 = FRACTION_BITS - 149;

/// The `f32` that is nearest to this number, the even one of two that are as near; infinite when it is too large. `None`
/// for what is no number. Takes digits with a point among them or not, a sign, an exponent.
pub(super) fn read(text: &[u8]) -> Option<f32> {
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

/// Whether a minus stands there, and what is behind the sign.
fn sign(text: &[u8]) -> (bool, &[u8]) {
    match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        rest => (false, rest),
    }
}

/// An exponent; far too large a one stays far too large.
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

/// What stands before and behind the point.
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

    /// The digit at this place, 0 behind the last.
    fn at(&self, index: usize) -> u32 {
        let behind = || self.fraction.get(index.wrapping_sub(self.whole.len()));
        self.whole.get(index).or_else(behind).map_or(0, |digit| u32::from(digit.wrapping_sub(b'0')))
    }

    fn times_ten_to_the(&self, exponent: i32) -> f32 {
        let zeros = self.whole.iter().chain(self.fraction).take_while(|&&digit| digit == b'0').count();
        if zeros == self.len() {
            return 0.0;
        }
        // Digits from the first that is not 0 to the point; negative: zeros from the point to that digit.
        let distance = (self.whole.len() as i32).wrapping_sub(zeros as i32).saturating_add(exponent);
        if distance > MOST_WHOLE_DIGITS {
            return f32::INFINITY;
        }
        if distance < -MOST_LEADING_ZEROS {
            return 0.0;
        }
        let mut value = Fixed::ZERO;
        let point = zeros.saturating_add(distance.max(0) as usize);
        // From the last digit to the point: each goes before what is behind it.
        for index in (point..self.len()).rev() {
            value.put_behind_the_point(self.at(index));
        }
        for _ in distance..0 {
            value.put_behind_the_point(0);
        }
        for index in zeros..point {
            if value.append_before_the_point(self.at(index)).is_none() {
                return f32::INFINITY;
            }
        }
        value.rounded()
    }
}

/// A number that is not negative, with bits enough before and behind the point.
struct Fixed {
    /// The lowest word first.
    words: [u32; WHOLE_WORDS + FRACTION_WORDS],
    /// Something below the last bit is left out.
    inexact: bool,
}

impl Fixed {
    const ZERO: Self = Self { words: [0; WHOLE_WORDS + FRACTION_WORDS], inexact: false };

    /// A fraction becomes (digit + fraction) / 10. The part before the point is 0 still.
    ///
    /// What a division leaves out cannot change a later quotient, so only that it was not 0 is kept.
    fn put_behind_the_point(&mut self, digit: u32) {
        let mut remainder = u64::from(digit);
        for word in self.words.iter_mut().take(FRACTION_WORDS).rev() {
            let dividend = (remainder << 32) | u64::from(*word);
            *word = (dividend / 10) as u32;
            remainder = dividend % 10;
        }
        self.inexact |= remainder != 0;
    }

    /// The part before the point becomes ten times itself and this digit; none when it has no room for that.
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
        // Without a leading one (a subnormal number) the exponent field is 0, with it 1 from 2^-149 on; a carry out of the
        // significand goes into the field, up to the one that means infinite.
        let exponent = lowest.wrapping_sub(LOWEST_BIT);
        let bits = (exponent << (SIGNIFICAND_BITS - 1)).wrapping_add(significand).wrapping_add(up.into());
        f32::from_bits(bits.min(f32::INFINITY.to_bits()))
    }

    fn highest_bit(&self) -> Option<u32> {
        let index = self.words.iter().rposition(|&word| word != 0)?;
        let word = self.words.get(index)?;
        Some((index as u32).wrapping_mul(32).wrapping_add(31u32.wrapping_sub(word.leading_zeros())))
    }

    /// 32 bits from this one on.
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
