//! Invalid and almost valid GCL lines: each is parsed exactly, or refused with a reason.

use crate::strategies::{answer, mutated, numbers, request, texts};
use proptest::prelude::*;
use std::collections::BTreeSet;
use wsg_protocol::Status;
use wsg_protocol::gcl::ParseError::{
    self, Form, Index, NoName, Range, Text, TooFew, TooLong, TooMany, UnknownName, Value,
};
use wsg_protocol::gcl::{Answer, Named, Refused, Request};

/// The words of a line: numbers by value, all others by their letters.
#[derive(Debug, PartialEq)]
enum Word {
    Number(f32),
    Mark(u8),
}

/// Splits a line into words, independently of the parser and without dropping anything.
fn words(line: &[u8]) -> Vec<Word> {
    let mut words = vec![];
    let mut rest = line;
    let mut inside_name = false;
    while let Some((byte, after)) = rest.split_first() {
        let is_number = |byte: &u8| byte.is_ascii_digit() || b"+-.eE".contains(byte);
        let number = rest.iter().position(|byte| !is_number(byte)).unwrap_or(rest.len());
        let parsed = (1..=number)
            .rev()
            .find_map(|len| Some((len, str::from_utf8(&rest[..len]).ok()?.parse::<f32>().ok()?)));
        match parsed {
            Some((len, value)) if !inside_name => {
                words.push(Word::Number(value));
                rest = &rest[len..];
            }
            _ => {
                if !byte.is_ascii_whitespace() {
                    words.push(Word::Mark(byte.to_ascii_uppercase()));
                }
                inside_name = byte.is_ascii_alphanumeric();
                rest = after;
            }
        }
    }
    words
}

fn understood_exactly_or_refused(line: &[u8]) -> Result<(), TestCaseError> {
    match Request::parse(line) {
        Ok(request) => {
            prop_assert!(request.check().is_ok());
            let written = request.to_string();
            prop_assert_eq!(words(line), words(written.as_bytes()), "{}", written);
            prop_assert_eq!(Request::parse(written.as_bytes()), Ok(request));
        }
        Err(refused) => {
            prop_assert_ne!(refused.mistake.status(), Status::Success);
            let answer = refused.answer(true);
            prop_assert!(answer.check().is_ok());
            let written = answer.to_string();
            prop_assert_eq!(Answer::parse(written.as_bytes()), Ok(answer), "{}", written);
        }
    }
    if let Ok(answer) = Answer::parse(line) {
        prop_assert!(answer.check().is_ok());
        let written = answer.to_string();
        if let Answer::Err { description: Some(description), .. } = answer
            && str::from_utf8(description.bytes()).is_err()
        {
            return Ok(()); // Written with a `?` in the place of each of the other bytes.
        }
        prop_assert_eq!(Answer::parse(written.as_bytes()), Ok(answer), "{}", written);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn random_bytes_are_refused_with_a_reason(line in proptest::collection::vec(any::<u8>(), 0..80)) {
        understood_exactly_or_refused(&line)?;
    }

    #[test]
    fn random_words_are_understood_exactly_or_refused(
        line in "(MOVE|grip|AUTOSEND|SYSFLAGS|PWT|TARE|ERR|ACK|@POS|FDATA| |\\(|\\)|\\[|\\]|,|=|\\?|\"POS\"|-|1|2\\.5|99999999999){0,9}",
    ) {
        understood_exactly_or_refused(line.as_bytes())?;
    }

    #[test]
    fn mutated_requests_are_understood_exactly_or_refused(
        line in request().prop_flat_map(|request| mutated(request.to_string())),
    ) {
        understood_exactly_or_refused(&line)?;
    }

    #[test]
    fn mutated_answers_are_understood_exactly_or_refused(
        line in (texts(), any::<u8>(), numbers())
            .prop_flat_map(|(texts, kind, numbers)| mutated(answer(&texts, kind, numbers).to_string())),
    ) {
        understood_exactly_or_refused(&line)?;
    }
}

#[test]
fn invalid_line_is_answered_with_its_name_and_the_right_code() {
    for (line, mistake, answer) in [
        ("dance(3)", UnknownName, "ERR DANCE 14"),
        ("hello", UnknownName, "ERR HELLO 14"),
        ("a_name_of_more_than_16_letters()", UnknownName, "ERR A_NAME_OF_MORE_T 14"),
        ("%&!", NoName, "ERR ? 15"),
        ("42", NoName, "ERR ? 15"),
        ("(", NoName, "ERR ? 15"),
        ("stop", Form, "ERR STOP 15"),
        ("stop(", Form, "ERR STOP 15"),
        ("stop)", Form, "ERR STOP 15"),
        ("stop()x", Form, "ERR STOP 15"),
        ("stop() stop()", Form, "ERR STOP 15"),
        ("stop(1)", TooMany, "ERR STOP 12"),
        ("home(1,1)", TooMany, "ERR HOME 12"),
        ("home(2)", Value, "ERR HOME 24"),
        ("move()", TooFew, "ERR MOVE 13"),
        ("move 50", Form, "ERR MOVE 15"),
        ("move?", Form, "ERR MOVE 15"),
        ("move=5", Form, "ERR MOVE 15"),
        ("move(50,)", Form, "ERR MOVE 15"),
        ("move(,50)", Form, "ERR MOVE 15"),
        ("move(fast)", Form, "ERR MOVE 15"),
        ("move(50 100)", Form, "ERR MOVE 15"),
        ("move(nan)", Form, "ERR MOVE 15"),
        ("move(1e99)", Range, "ERR MOVE 28"),
        ("move(1,2,3)", TooMany, "ERR MOVE 12"),
        ("move(50,5 6)", Form, "ERR MOVE 15"),
        ("stop(,)", TooMany, "ERR STOP 12"),
        ("grip(1,2,3,4)", TooMany, "ERR GRIP 12"),
        ("pos", Form, "ERR POS 15"),
        ("pos()", Form, "ERR POS 15"),
        ("pos=5", Form, "ERR POS 15"),
        ("pos?5", Form, "ERR POS 15"),
        ("pos[0]?", Form, "ERR POS 15"),
        ("verbose?", Form, "ERR VERBOSE 15"),
        ("verbose=2", Value, "ERR VERBOSE 24"),
        ("pwt=", Form, "ERR PWT 15"),
        ("sysflags[32]?", Index, "ERR SYSFLAGS 25"),
        ("sysflags[99999999999]?", Index, "ERR SYSFLAGS 25"),
        ("sysflags[]?", Form, "ERR SYSFLAGS 15"),
        ("sysflags[-1]?", Form, "ERR SYSFLAGS 15"),
        ("gripstats[3]?", Index, "ERR GRIPSTATS 25"),
        ("tare(2)", Index, "ERR TARE 25"),
        ("tare(1000)", Index, "ERR TARE 25"),
        ("autosend()", TooFew, "ERR AUTOSEND 13"),
        ("autosend(\"pos\")", TooFew, "ERR AUTOSEND 13"),
        ("autosend(pos,10)", Form, "ERR AUTOSEND 15"),
        ("autosend(\"pos,10)", Form, "ERR AUTOSEND 15"),
        ("autosend(\"tag\",10)", Value, "ERR AUTOSEND 24"),
        ("autosend(\"pos\",-10)", Form, "ERR AUTOSEND 15"),
        ("autosend(\"pos\",10.5)", Form, "ERR AUTOSEND 15"),
        ("autosend(\"pos\",10,-1)", Value, "ERR AUTOSEND 24"),
        ("autosend(\"sysflags\",10,2)", Value, "ERR AUTOSEND 24"),
        ("autosend(\"pos\",10,1,1)", TooMany, "ERR AUTOSEND 12"),
    ] {
        let refused = Request::parse(line.as_bytes()).expect_err(line);
        assert_eq!(refused.mistake, mistake, "{line}");
        assert_eq!(refused.answer(false).to_string(), answer, "{line}");
    }
}

#[test]
fn line_too_long_is_answered_by_the_name_that_it_began_with() {
    assert_eq!(Refused::too_long(b"  grip(0000").answer(false).to_string(), "ERR GRIP 27");
    assert_eq!(Refused::too_long(b"((((").answer(false).to_string(), "ERR ? 27");
}

#[test]
fn refusal_names_the_request_and_the_error() {
    let refused = Request::parse(b"move()").unwrap_err();
    let text = refused.to_string();
    assert!(text.contains("MOVE") && text.contains(&ParseError::TooFew.to_string()), "{text}");
    let all = [NoName, UnknownName, Form, TooFew, TooMany, Range, Value, Index, TooLong, Text];
    let texts: BTreeSet<String> = all.iter().map(ToString::to_string).collect();
    assert!(texts.len() == all.len() && !texts.contains(""), "{texts:?}");
}

#[test]
fn verbose_mode_adds_the_meaning_of_the_code() {
    let refused = Request::parse(b"move()").unwrap_err();
    assert_eq!(refused.answer(true).to_string(), "ERR MOVE 13 too few parameters");
    assert_eq!(refused.name, Named::at_start_of(b"MOVE"));
}

#[test]
fn invalid_answer_is_refused_with_its_reason() {
    for (line, mistake) in [
        ("", ParseError::NoName),
        ("20.0", ParseError::NoName),
        ("HELLO=1", ParseError::UnknownName),
        ("ACK", ParseError::Form),
        ("ACKMOVE", ParseError::UnknownName),
        ("ACK DANCE", ParseError::UnknownName),
        ("ACK POS", ParseError::Form),
        ("FIN STOP", ParseError::Form),
        ("ACK MOVE now", ParseError::Form),
        ("ERR 19", ParseError::Form),
        ("ERR MOVE", ParseError::Form),
        ("ERR MOVE x", ParseError::Form),
        ("ERR MOVE 18x", ParseError::Form),
        ("ERR MOVE 70000", ParseError::Range),
        ("MOVE(50.0)", ParseError::Form),
        ("POS?", ParseError::Form),
        ("POS=", ParseError::Form),
        ("POS=20.0 mm", ParseError::Form),
        ("SN=4294967296", ParseError::Range),
        ("TAG=left", ParseError::Form),
        ("TAG=\"", ParseError::Form),
        ("TAG=\"\u{1}\"", ParseError::Text),
        ("VERSION=\"\u{7f}\"", ParseError::Text),
        ("SYSFLAGS=[2]", ParseError::Value),
        ("SYSFLAGS[32]=1", ParseError::Index),
        ("GRIPSTATS=[1,2]", ParseError::Form),
        ("GRIPSTATS=[1,65536,0]", ParseError::Range),
        ("FDATA=[1.0]", ParseError::Form),
        ("FDATA[0]=[1,[2]", ParseError::Form),
        ("@SN=5", ParseError::Value),
    ] {
        assert_eq!(Answer::parse(line.as_bytes()), Err(mistake), "{line}");
    }
}
