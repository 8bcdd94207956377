//! Compares the parser with `core`'s.

use super::*;
use proptest::prelude::*;
use std::format;
use std::string::String;

/// Asserts that both parsers agree to the bit.
fn agree(text: &str) {
    let ours = read(text.as_bytes()).map(f32::to_bits);
    assert_eq!(ours, text.parse::<f32>().ok().map(f32::to_bits), "{text}");
}

/// Returns the midpoint between a float and the next larger one, written exactly by `core`.
fn middle_above(value: f32) -> String {
    let above = f32::from_bits(value.to_bits().wrapping_add(1));
    let above = if above.is_finite() { above.into() } else { 2f64.powi(128) };
    format!("{:.160}", (f64::from(value) + above) / 2.0)
}

#[test]
fn limits_of_the_range_and_values_beyond() {
    for text in [
        "0",
        "-0",
        "0.0e99",
        "1",
        "1e0",
        "340282346638528859811704183484516925440",
        "340282356779733661637539395458142568447",
        "340282356779733661637539395458142568448",
        "3.5e38",
        "1e39",
        "1e40",
        "-1e400",
        "1e99999999999999",
        "1e-99999999999999",
        "1.401298464324817e-45",
        "7.006492321624085e-46",
        "7.006492321624086e-46",
        "7.0e-46",
        "9e-47",
        "1e-46",
        "1e-47",
        "1.17549435e-38",
        "1.1754942e-38",
        "1.17549429e-38",
        "16777217",
        "16777219",
        "16777217.00000000000000000000000000000001",
    ] {
        agree(text);
    }
}

#[test]
fn leading_and_trailing_zeros_do_not_matter() {
    for text in [
        "0000000000000000000000000000000000000000000000000000000001.5",
        "000.000000000000000000000000000000000000000000000000000000015e55",
    ] {
        agree(text);
    }
    agree(&format!("1.5{}", "0".repeat(400)));
    agree(&format!("15{}e-400", "0".repeat(400)));
    agree(&format!("0.{}15e400", "0".repeat(400)));
}

#[test]
fn ties_round_to_the_even_float_and_others_to_the_nearest() {
    for exponent in 0..255u32 {
        for mantissa in [0, 1, 2, 0x12_3456, 0x55_5555, 0x7F_FFFE, 0x7F_FFFF] {
            let middle = middle_above(f32::from_bits(exponent << 23 | mantissa));
            agree(&middle);
            agree(&format!("{middle}1"));
            agree(&format!("-{middle}e0"));
            let below =
                middle.trim_end_matches('0').strip_suffix('5').map(|start| format!("{start}4999999999"));
            below.iter().for_each(|below| agree(below));
        }
    }
}

#[test]
fn invalid_numbers_are_none() {
    for text in [
        "", "+", "-", ".", "-.", "e", "1e", "1e+", "e1", ".e1", "1.2.3", "1e1.5", "1e1e1", "+-1", "1-",
        "1+1", "--1",
    ] {
        agree(text);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    #[test]
    fn every_number_is_read_as_core_reads_it(text in "[+-]?[0-9]{0,45}(\\.[0-9]{0,60})?([eE][+-]?[0-9]{1,3})?") {
        agree(&text);
    }

    #[test]
    fn numbers_near_the_ends_are_read_as_core_reads_them(text in "[0-9]{1,12}(\\.[0-9]{0,12})?e(-[3-5][0-9]|[23][0-9])") {
        agree(&text);
    }

    #[test]
    fn every_run_of_their_characters_is_read_as_core_reads_it(text in "[0-9+.eE-]{0,12}") {
        agree(&text);
    }

    #[test]
    fn float_with_any_number_of_digits_is_read_as_core_reads_it(bits in any::<u32>(), places in 0..60usize) {
        let value = f32::from_bits(bits);
        if value.is_finite() {
            agree(&format!("{value:.places$}"));
            agree(&format!("{value:.places$e}"));
        }
    }
}
