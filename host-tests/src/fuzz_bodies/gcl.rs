//! The text protocol: lines from bytes, requests and answers from lines.

use wsg_protocol::gcl::session::{Config, Session};
use wsg_protocol::gcl::{Answer, LineEvent, LineReader, Request};
use wsg_protocol::{Instant, Kind};

use super::input::Input;

/// Capacity of the line reader; small, so that lines are often too long.
const LIMIT: usize = 40;

/// Events by value, for comparison.
#[derive(Clone, Debug, PartialEq)]
enum Seen {
    Line(Vec<u8>),
    TooLong(Vec<u8>),
}

impl From<LineEvent<'_>> for Seen {
    fn from(event: LineEvent<'_>) -> Self {
        match event {
            LineEvent::Line(line) => Self::Line(line.to_vec()),
            LineEvent::TooLong(start) => Self::TooLong(start.to_vec()),
        }
    }
}

/// The first byte is the length of slices. The rest is the stream.
pub fn gcl(data: &[u8]) {
    let mut input = Input::new(data);
    let slice = usize::from(input.byte()).max(1);
    let stream = input.bytes(usize::MAX);
    let expected = read_all(stream);

    let mut by_byte = LineReader::<LIMIT>::new();
    let mut events: Vec<Seen> =
        stream.iter().filter_map(|byte| by_byte.push(*byte).map(Seen::from)).collect();
    events.extend(by_byte.finish().map(Seen::from));
    assert_eq!(events, expected, "byte by byte");

    let mut by_slice = LineReader::<LIMIT>::new();
    let mut events: Vec<Seen> = Vec::new();
    for mut rest in stream.chunks(slice) {
        while let (taken, Some(event)) = by_slice.push_slice(rest) {
            events.push(event.into());
            rest = &rest[taken..];
        }
    }
    events.extend(by_slice.finish().map(Seen::from));
    assert_eq!(events, expected, "in slices");
    assert_eq!(by_slice.counters(), by_byte.counters());

    for event in &expected {
        if let Seen::Line(line) = event {
            request(line);
            answer(line);
        }
    }
    listen(&expected);
}

/// Parses the whole capture naively, including its end.
fn read_all(stream: &[u8]) -> Vec<Seen> {
    let lines = stream.split(|byte| matches!(byte, b'\r' | b'\n'));
    let is_control = |byte: u8| byte.is_ascii_control() && byte != b'\t';
    let begun = lines.map(|line| {
        let skipped = line.iter().take_while(|byte| matches!(byte, b' ' | b'\t') || is_control(**byte));
        &line[skipped.count()..]
    });
    let found = begun.filter(|line| !line.is_empty()).map(|line| match line.get(..LIMIT) {
        Some(start) if line.len() > LIMIT => Seen::TooLong(start.to_vec()),
        _ => {
            let after = line.iter().rev().take_while(|byte| is_control(**byte)).count();
            Seen::Line(line[..line.len() - after].to_vec())
        }
    });
    found.collect()
}

/// Checks that a parsed request is written identically, and that an invalid one has a parseable answer.
fn request(line: &[u8]) {
    let mut buffer = [0; Request::MAX_LEN + 1];
    match Request::parse(line) {
        Ok(request) => {
            assert_eq!(request.check(), Ok(()), "a parsed request is valid");
            let length = request.write_line_into(&mut buffer).expect("the longest request fits");
            let (end, written) = buffer[..length].split_last().expect("a line has an end");
            assert_eq!((*end, Request::parse(written)), (b'\n', Ok(request)), "{}", line.escape_ascii());
        }
        Err(refused) => {
            for verbose in [false, true] {
                let mut text = String::new();
                refused.answer(verbose).write(&mut text).expect("writing to a string cannot fail");
                let status = Answer::parse(text.as_bytes()).map(|answer| answer.status());
                assert_eq!(status, Ok(refused.mistake.status()), "{text}");
            }
        }
    }
}

/// Checks that a parsed answer is written identically, except for description bytes that are not UTF-8.
fn answer(line: &[u8]) {
    let Ok(answer) = Answer::parse(line) else { return };
    assert_eq!(answer.check(), Ok(()), "{}", line.escape_ascii());
    let mut text = String::new();
    answer.write(&mut text).expect("writing to a string cannot fail");
    let again = Answer::parse(text.as_bytes()).expect("a written answer can be parsed");
    assert_eq!((again.name(), again.status()), (answer.name(), answer.status()), "{text}");
    match answer {
        Answer::Err { description: Some(described), .. }
            if std::str::from_utf8(described.bytes()).is_err() =>
        {
            let mut same = String::new();
            again.write(&mut same).expect("writing to a string cannot fail");
            assert_eq!(same, text);
        }
        _ => assert_eq!(again, answer, "{text}"),
    }
}

/// Checks that a session without requests sends queries only, for any received lines.
fn listen(lines: &[Seen]) {
    let mut session = Session::new(Config::DEFAULT);
    for (at, event) in lines.iter().enumerate() {
        let now = Instant::from_millis(at as u32 * 100);
        let mut notices = 0;
        while session.tick(now).is_some() {
            notices += 1;
            assert!(notices < 64, "the number of notices is bounded");
        }
        let mut requests = 0;
        while let Some(request) = session.poll_transmit(now) {
            requests += 1;
            assert!(requests < 64, "the number of requests is bounded");
            assert_eq!(request.check(), Ok(()));
            assert!(
                !matches!(request.kind(), Kind::Motion | Kind::Stop | Kind::Acknowledge),
                "{request:?} without a request"
            );
        }
        let event = match event {
            Seen::Line(line) => LineEvent::Line(line),
            Seen::TooLong(start) => LineEvent::TooLong(start),
        };
        session.handle(now, &event);
        assert_eq!(session.motion(), None, "no motion was requested");
    }
}
