use super::*;
use std::vec;
use std::vec::Vec;

fn lines(reader: &mut LineReader<8>, bytes: &[u8]) -> Vec<(bool, Vec<u8>)> {
    let mut found = vec![];
    for byte in bytes {
        match reader.push(*byte) {
            Some(LineEvent::Line(line)) => found.push((true, line.to_vec())),
            Some(LineEvent::TooLong(line)) => found.push((false, line.to_vec())),
            None => {}
        }
    }
    found
}

fn whole(lines: &[&str]) -> Vec<(bool, Vec<u8>)> {
    lines.iter().map(|line| (true, line.as_bytes().to_vec())).collect()
}

#[test]
fn lf_cr_and_both_end_a_line_in_any_mix() {
    let mut reader = LineReader::new();
    assert_eq!(lines(&mut reader, b"a\nb\rc\r\nd\n\re\n"), whole(&["a", "b", "c", "d", "e"]));
}

#[test]
fn empty_and_blank_lines_are_ignored() {
    let mut reader = LineReader::new();
    assert_eq!(lines(&mut reader, b"\n\r\r\n   \n\t\n a \n"), whole(&["a "]));
    assert_eq!(reader.counters(), LineCounters::default());
}

#[test]
fn control_characters_between_lines_are_ignored() {
    for (stream, expected) in [
        // Telnet ends a line with CR NUL, or with CR LF.
        (&b"home()\r\0pos?\r\0"[..], &["home()", "pos?"][..]),
        // C: send(s, "pos?\n", sizeof("pos?\n"), 0).
        (b"pos?\n\0home()\n\0", &["pos?", "home()"]),
        // The NUL is sent before the line end.
        (b"pos?\0\nhome()\0\r\n", &["pos?", "home()"]),
        (b"\0\0\n\x7F\0 \x01pos?\n\x1B\r", &["pos?"]),
        // DEL and BEL of a terminal.
        (b"bye()\n\x07\x7Fpos?\n", &["bye()", "pos?"]),
    ] {
        assert_eq!(lines(&mut LineReader::new(), stream), whole(expected), "{}", stream.escape_ascii());
    }
}

#[test]
fn control_characters_inside_a_line_remain() {
    let mut reader = LineReader::new();
    assert_eq!(lines(&mut reader, b"po\0s?\n a\x1B b\0 \n"), whole(&["po\0s?", "a\x1B b\0 "]));
}

#[test]
fn line_of_maximum_length_is_delivered() {
    let mut reader = LineReader::new();
    assert_eq!(lines(&mut reader, b"12345678\n"), whole(&["12345678"]));
}

#[test]
fn line_too_long_is_reported_once_and_the_next_one_is_found() {
    let mut reader = LineReader::new();
    let found = lines(&mut reader, b"123456789 and more\rok\n");
    assert_eq!(found, [(false, b"12345678".to_vec()), (true, b"ok".to_vec())]);
    assert_eq!(reader.counters(), LineCounters { too_long: 1, dropped: 18 });
}

#[test]
fn counters_stop_at_their_end() {
    let mut reader = LineReader::new();
    for _ in 0..70_000 {
        lines(&mut reader, b"123456789\n");
    }
    assert_eq!(reader.counters(), LineCounters { too_long: u16::MAX, dropped: u16::MAX });
}

#[test]
fn reset_discards_an_incomplete_line_and_ends_skipping() {
    let mut reader = LineReader::new();
    lines(&mut reader, b"123");
    reader.reset();
    assert_eq!(lines(&mut reader, b"a\n"), whole(&["a"]));
    lines(&mut reader, b"123456789");
    reader.reset();
    assert_eq!(lines(&mut reader, b"b\n"), whole(&["b"]));
}

#[test]
fn end_of_a_datagram_ends_the_line() {
    let mut reader = LineReader::<8>::new();
    assert_eq!(reader.push_slice(b"pos?"), (4, None));
    assert_eq!(reader.finish(), Some(LineEvent::Line(b"pos?")));
    assert_eq!(reader.finish(), None);
    assert_eq!(reader.push_slice(b"123456789").1, Some(LineEvent::TooLong(b"12345678")));
    assert_eq!(reader.finish(), None);
    assert_eq!(reader.push_slice(b"a\n").1, Some(LineEvent::Line(b"a")));
}

#[test]
fn string_terminator_at_the_end_of_a_datagram_is_ignored() {
    let mut reader = LineReader::<8>::new();
    reader.push_slice(b"pos?\0");
    assert_eq!(reader.finish(), Some(LineEvent::Line(b"pos?")));
    reader.push_slice(b"\0");
    assert_eq!(reader.finish(), None);
}

#[test]
fn reader_without_capacity_reports_every_line_as_too_long() {
    let mut reader = LineReader::<0>::new();
    assert_eq!(reader.push(b'a'), Some(LineEvent::TooLong(b"")));
    assert_eq!(reader.push(b'\n'), None);
}
