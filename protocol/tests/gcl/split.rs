//! The events are independent of how the stream of bytes is split.

use proptest::prelude::*;
use wsg_protocol::gcl::{LineCounters, LineEvent, LineReader};

/// An owned copy of an event.
#[derive(Clone, Debug, PartialEq)]
enum Found {
    Line(Vec<u8>),
    TooLong(Vec<u8>),
}

const LEN: usize = 12;

fn keep(event: LineEvent<'_>) -> Found {
    match event {
        LineEvent::Line(line) => Found::Line(line.to_vec()),
        LineEvent::TooLong(line) => Found::TooLong(line.to_vec()),
    }
}

/// Reads the pieces in order, each as a slice.
fn in_slices<'a>(pieces: impl IntoIterator<Item = &'a [u8]>) -> (Vec<Found>, LineCounters) {
    let mut reader = LineReader::<LEN>::new();
    let mut found = vec![];
    for piece in pieces {
        let mut rest = piece;
        while !rest.is_empty() {
            let (taken, event) = reader.push_slice(rest);
            found.extend(event.map(keep));
            rest = &rest[taken..];
        }
    }
    (found, reader.counters())
}

fn in_bytes(stream: &[u8]) -> (Vec<Found>, LineCounters) {
    let mut reader = LineReader::<LEN>::new();
    let found = stream.iter().filter_map(|byte| reader.push(*byte).map(keep)).collect();
    (found, reader.counters())
}

/// Splits the complete stream, as a reference.
fn reference(stream: &[u8]) -> Vec<Found> {
    let is_end = |byte: &u8| matches!(byte, b'\n' | b'\r');
    let mut found = vec![];
    let mut lines = stream.split(is_end).peekable();
    while let Some(line) = lines.next() {
        let is_whole = lines.peek().is_some();
        let is_before = |byte: &u8| matches!(byte, b' ' | 0..0x20 | 0x7F);
        let line = &line[line.iter().take_while(|byte| is_before(byte)).count()..];
        if line.len() > LEN {
            found.push(Found::TooLong(line[..LEN].to_vec()));
        } else if is_whole && !line.is_empty() {
            let is_after = |byte: &u8| is_before(byte) && !matches!(byte, b' ' | b'\t');
            let after = line.iter().rev().take_while(|byte| is_after(byte)).count();
            found.push(Found::Line(line[..line.len() - after].to_vec()));
        }
    }
    found
}

fn stream() -> impl Strategy<Value = Vec<u8>> {
    proptest::collection::vec(
        prop_oneof![4 => proptest::sample::select(b"ab \t\0".to_vec()), 1 => Just(b'\n'), 1 => Just(b'\r'), 1 => any::<u8>()],
        0..200,
    )
}

proptest! {
    #[test]
    fn every_split_gives_the_same_events(
        stream in stream(),
        cuts in proptest::collection::vec(any::<proptest::sample::Index>(), 0..12),
    ) {
        let mut at: Vec<usize> = cuts.iter().map(|cut| cut.index(stream.len() + 1)).collect();
        at.extend([0, stream.len()]);
        at.sort_unstable();
        let pieces = at.windows(2).map(|pair| &stream[pair[0]..pair[1]]);
        let expected = in_bytes(&stream);
        prop_assert_eq!(&in_slices(pieces), &expected);
        prop_assert_eq!(&reference(&stream), &expected.0);
    }
}
