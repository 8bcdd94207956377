//! Written lines parse to the same value.

use crate::strategies::{answer, number, numbers, request, texts};
use proptest::prelude::*;
use wsg_protocol::gcl::{
    Answer, Autosend, Filter, FingerReading, Grip, LineError, Move, ParseError, Release, Request, Select,
    Selected, Setting, Tare, Topic, Value,
};

proptest! {
    #[test]
    fn every_request_survives_the_round_trip(request in request()) {
        let mut buffer = [0; Request::MAX_LEN + 1];
        let length = request.write_line_into(&mut buffer).unwrap();
        let (end, line) = buffer[..length].split_last().unwrap();
        prop_assert_eq!(*end, b'\n');
        prop_assert_eq!(Request::parse(line), Ok(request));
        prop_assert!(request.to_string().as_bytes() == line);
    }

    #[test]
    fn every_answer_survives_the_round_trip(texts in texts(), kind in any::<u8>(), numbers in numbers()) {
        let answer = answer(&texts, kind, numbers);
        let mut buffer = [0; 512];
        let length = answer.write_line_into(&mut buffer).unwrap();
        let (end, line) = buffer[..length].split_last().unwrap();
        prop_assert_eq!(*end, b'\n');
        prop_assert_eq!(Answer::parse(line), Ok(answer));
        prop_assert!(answer.to_string().as_bytes() == line);
    }

    #[test]
    fn every_number_is_read_back_as_the_same_bits(number in number()) {
        let line = Answer::Value(Value::Pos(number)).to_string();
        let Ok(Answer::Value(Value::Pos(read))) = Answer::parse(line.as_bytes()) else { panic!("{line}") };
        prop_assert_eq!(read.to_bits(), number.to_bits());
        let digits = line.strip_prefix("POS=").unwrap().trim_start_matches('-');
        prop_assert!(digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.'), "{}", line);
    }

    #[test]
    fn case_and_blanks_do_not_matter(request in request(), seed in any::<u64>()) {
        let mut bits = seed;
        let mut typed = String::new();
        let mut inside_word = false;
        for c in request.to_string().chars() {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let is_word = c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '"');
            if !(inside_word && is_word) && bits >> 62 == 0 {
                typed.push_str(if bits >> 61 & 1 == 0 { " " } else { "\t" });
            }
            inside_word = is_word;
            typed.push(if bits >> 60 & 1 == 0 { c.to_ascii_lowercase() } else { c });
        }
        prop_assert_eq!(Request::parse(typed.as_bytes()), Ok(request), "{}", typed);
    }

    #[test]
    fn line_that_does_not_fit_is_not_written(request in request()) {
        let mut buffer = [0; Request::MAX_LEN + 1];
        let length = request.write_line_into(&mut buffer).unwrap();
        let refused = request.write_line_into(&mut buffer[..length - 1]);
        prop_assert_eq!(refused, Err(LineError::BufferTooSmall));
    }
}

#[test]
fn longest_request_has_the_announced_length_at_most() {
    let longest = -1.234_567_9e-38;
    let grip = Grip::PartAtSpeed { force: longest, width: longest, speed: longest };
    let length = Request::Grip(grip).to_string().len();
    assert!((140..=Request::MAX_LEN).contains(&length), "{length}");
}

#[test]
fn values_that_the_recipient_would_refuse_are_not_written() {
    let mut buffer = [0; 256];
    for (request, mistake) in [
        (Request::Move(Move { width: f32::NAN, speed: None }), ParseError::Range),
        (Request::Move(Move { width: 1.0, speed: Some(f32::INFINITY) }), ParseError::Range),
        (Request::Grip(Grip::Force { force: f32::NAN }), ParseError::Range),
        (Request::Release(Release::ByAtSpeed { distance: 1.0, speed: f32::INFINITY }), ParseError::Range),
        (Request::Clt(Setting::Set(f32::NAN)), ParseError::Range),
        (Request::Sysflags(Select::One(32)), ParseError::Index),
        (Request::Fdata(Select::One(2)), ParseError::Index),
        (Request::Tare(Tare::Finger(2)), ParseError::Index),
        (Request::Autosend(Autosend::by(Topic::Sysflags, 10, 1.0)), ParseError::Value),
        (Request::Autosend(Autosend::by(Topic::Pos, 10, -1.0)), ParseError::Value),
        (
            Request::Autosend(Autosend {
                topic: Topic::Pos,
                interval_ms: 10,
                filter: Filter::Unchanged(true),
            }),
            ParseError::Value,
        ),
    ] {
        assert_eq!(request.check(), Err(mistake), "{request}");
        assert_eq!(request.write_line_into(&mut buffer), Err(LineError::Invalid(mistake)), "{request}");
    }
    let ack = Answer::Ack(wsg_protocol::gcl::CommandName::Pos);
    assert_eq!(ack.write_line_into(&mut buffer), Err(LineError::Invalid(ParseError::Form)));
    let fin = Answer::Fin(wsg_protocol::gcl::CommandName::Stop);
    assert_eq!(fin.write_line_into(&mut buffer), Err(LineError::Invalid(ParseError::Form)));
    let update = Answer::Update(Value::Sn(1));
    assert_eq!(update.write_line_into(&mut buffer), Err(LineError::Invalid(ParseError::Value)));
    for value in [f32::NAN, f32::NEG_INFINITY] {
        for answer in [Value::Pos(value), Value::Fdata(Selected::One(0, FingerReading::Number(value)))] {
            let refused = Answer::Value(answer).write_line_into(&mut buffer);
            assert_eq!(refused, Err(LineError::Invalid(ParseError::Range)), "{answer}");
        }
    }
    let third = Answer::Value(Value::Fdata(Selected::One(2, FingerReading::Number(1.0))));
    assert_eq!(third.write_line_into(&mut buffer), Err(LineError::Invalid(ParseError::Index)));
}
