use super::*;
use std::string::String;

fn written(value: f32) -> String {
    let mut text = String::new();
    write_float(value, &mut text).unwrap();
    text
}

fn read(text: &str) -> Result<f32, ParseError> {
    let mut input = Scanner::new(text.as_bytes());
    let value = read_float(&mut input)?;
    input.end()?;
    Ok(value)
}

#[test]
fn numbers_are_written_as_the_manual_shows_them() {
    for (value, text) in [(20.0, "20.0"), (142.0, "142.0"), (34.2, "34.2"), (0.0, "0.0"), (-1.5, "-1.5")] {
        assert_eq!(written(value), text);
    }
}

#[test]
fn exponents_are_spelled_out() {
    for (value, text) in [
        (1e-7, "0.0000001"),
        (-1.25e-9, "-0.00000000125"),
        (1.192_092_9e-7, "0.00000011920929"),
        (1e20, "100000000000000000000.0"),
        (-1.5e15, "-1500000000000000.0"),
        (f32::MAX, "340282350000000000000000000000000000000.0"),
    ] {
        assert_eq!(written(value), text);
    }
}

#[test]
fn every_kind_of_number_survives_the_round_trip() {
    // Every exponent, with the smallest and largest mantissa and some between.
    for sign_and_exponent in 0..1u32 << 9 {
        for mantissa in [0, 1, 2, 0x2A_AAAA, 0x40_0000, 0x55_5555, 0x7F_FFFE, 0x7F_FFFF] {
            let value = f32::from_bits(sign_and_exponent << 23 | mantissa);
            if !value.is_finite() {
                continue;
            }
            let text = written(value);
            assert_eq!(read(&text).map(f32::to_bits), Ok(value.to_bits()), "{text}");
            assert!(text.len() <= MAX_FLOAT_LEN, "{text}");
            assert!(text.contains('.') && !text.contains('e'), "{text}");
        }
    }
}

#[test]
fn numbers_are_read_as_people_type_them() {
    for (text, value) in [
        ("50", 50.0),
        ("+5", 5.0),
        ("-0.5", -0.5),
        (".5", 0.5),
        ("5.", 5.0),
        ("007", 7.0),
        ("1e2", 100.0),
        ("2.5E-1", 0.25),
        ("16777217", 16_777_216.0),
        ("0.000000000000000000000000000000000000000000000000001", 0.0),
    ] {
        assert_eq!(read(text), Ok(value), "{text}");
    }
}

#[test]
fn invalid_numbers_are_rejected() {
    for text in ["", "-", ".", "e5", "1e", "1.2.3", "--1", "inf", "nan", "0x10", "1,5", "5mm"] {
        assert_eq!(read(text), Err(ParseError::Form), "{text}");
    }
    assert_eq!(read("1e39"), Err(ParseError::Range));
    assert_eq!(read("-1e999"), Err(ParseError::Range));
}

#[test]
fn integers_are_written_and_read() {
    for (value, text) in [(0, "0"), (7, "7"), (10, "10"), (12_345_678, "12345678"), (u32::MAX, "4294967295")]
    {
        let mut line = String::new();
        write_integer(value, &mut line).unwrap();
        assert_eq!(line, text);
        assert_eq!(read_integer(&mut Scanner::new(text.as_bytes())), Ok(value));
    }
    assert_eq!(read_integer(&mut Scanner::new(b"4294967296")), Err(ParseError::Range));
    assert_eq!(read_integer(&mut Scanner::new(b"-1")), Err(ParseError::Form));
}
