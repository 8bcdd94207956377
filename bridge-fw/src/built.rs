//! Numbers from environment variables of the build.

/// The number that this text is: decimal digits, or hexadecimal ones behind `0x`. What is none fails the build.
pub(crate) const fn number(text: &str) -> u32 {
    let (mut digits, radix) = match text.as_bytes() {
        [b'0', b'x', digits @ ..] => (digits, 16),
        digits => (digits, 10),
    };
    assert!(!digits.is_empty() && digits.len() <= 7, "a WSG_ variable of this build must be a number");
    let mut number = 0u32;
    while let [digit, rest @ ..] = digits {
        let digit = (*digit as char).to_digit(radix);
        assert!(digit.is_some(), "a WSG_ variable of this build must be a number");
        if let Some(digit) = digit {
            number = number.wrapping_mul(radix).wrapping_add(digit);
        }
        digits = rest;
    }
    number
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_decimal_or_hexadecimal() {
        assert_eq!((number("0"), number("230400"), number("0x1F")), (0, 230_400, 0x1F));
    }

    #[test]
    #[should_panic(expected = "must be a number")]
    fn what_is_no_number_fails() {
        number("12k");
    }
}
