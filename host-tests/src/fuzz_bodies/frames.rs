//! The frame parser against a naive reader.

use wsg_protocol::{Event, FrameParser, checksum};

use super::input::Input;

/// Parser capacity for a payload; small, so that it is often full.
const LIMIT: usize = 16;

/// Events by value, for comparison.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Seen {
    Frame(u8, Vec<u8>),
    BadChecksum(u8, u16),
    Oversize(u8, u16),
}

impl From<Event<'_>> for Seen {
    fn from(event: Event<'_>) -> Self {
        match event {
            Event::Frame(frame) => Self::Frame(frame.id, frame.payload.to_vec()),
            Event::BadChecksum { id, size } => Self::BadChecksum(id, size),
            Event::Oversize { id, size } => Self::Oversize(id, size),
        }
    }
}

/// The first byte selects repaired checksums for frequent intact frames (bit 0) and the length of slices (other
/// bits). The rest is the stream.
pub fn frames(data: &[u8]) {
    let mut input = Input::new(data);
    let choice = input.byte();
    let mut stream = input.bytes(usize::MAX).to_vec();
    if choice & 1 != 0 {
        repair_checksums(&mut stream);
    }
    let (expected, dropped) = read_all(&stream, false);
    let (to_the_end, all_dropped) = read_all(&stream, true);

    let mut by_byte = FrameParser::<LIMIT>::new();
    let mut events: Vec<Seen> = Vec::new();
    for &byte in &stream {
        events.extend(by_byte.push(byte).map(Seen::from));
    }
    while let Some(event) = by_byte.poll() {
        events.push(event.into());
    }
    assert_eq!(events, expected, "byte by byte");
    assert_eq!(usize::from(by_byte.counters().dropped), dropped.min(usize::from(u16::MAX)));

    let mut by_slice = FrameParser::<LIMIT>::new();
    let mut events: Vec<Seen> = Vec::new();
    for slice in stream.chunks(usize::from(choice >> 1).max(1)) {
        let mut rest = slice;
        while let (taken, Some(event)) = by_slice.push_slice(rest) {
            events.push(event.into());
            rest = &rest[taken..];
        }
    }
    assert_eq!(events, expected, "in slices");
    assert_eq!(by_slice.counters(), by_byte.counters());

    for mut parser in [by_byte, by_slice] {
        let mut events = expected.clone();
        while let Some(event) = parser.expire() {
            events.push(event.into());
        }
        assert_eq!(events, to_the_end, "after a time-out");
        assert_eq!(usize::from(parser.counters().dropped), all_dropped.min(usize::from(u16::MAX)));
        assert!(!parser.is_mid_frame());
    }
}

/// Parses the whole capture naively: a frame at the first byte, or from the next byte on. With `ended` no more bytes
/// follow. Also returns the number of dropped bytes.
fn read_all(stream: &[u8], ended: bool) -> (Vec<Seen>, usize) {
    let (mut seen, mut dropped, mut at) = (Vec::new(), 0, 0);
    while let Some(rest) = stream.get(at..).filter(|rest| !rest.is_empty()) {
        let preamble = rest.iter().take(3).all(|byte| *byte == 0xAA);
        let size =
            preamble.then(|| Some(usize::from(u16::from_le_bytes([*rest.get(4)?, *rest.get(5)?])))).flatten();
        match size {
            Some(size) if size > LIMIT => seen.push(Seen::Oversize(rest[3], size as u16)),
            Some(size) if rest.len() >= size + 8 => {
                let (summed, behind) = rest.split_at(size + 6);
                if checksum::of(summed).to_le_bytes() == behind[..2] {
                    seen.push(Seen::Frame(rest[3], summed[6..].to_vec()));
                    at += size + 8;
                    continue;
                }
                seen.push(Seen::BadChecksum(rest[3], size as u16));
            }
            _ if preamble && !ended => break,
            _ => {}
        }
        at += 1;
        dropped += 1;
    }
    (seen, dropped)
}

/// Corrects the checksum of every complete frame in the stream.
pub(super) fn repair_checksums(stream: &mut [u8]) {
    let mut at = 0;
    while at + 8 <= stream.len() {
        let rest = &mut stream[at..];
        let size = usize::from(u16::from_le_bytes([rest[4], rest[5]]));
        if rest[..3] == [0xAA; 3] && rest.len() >= size + 8 {
            let sum = checksum::of(&rest[..size + 6]).to_le_bytes();
            rest[size + 6..size + 8].copy_from_slice(&sum);
            at += size + 8;
        } else {
            at += 1;
        }
    }
}
