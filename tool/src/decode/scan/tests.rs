use proptest::prelude::*;
use wsg_protocol::{Event, FrameEncoder, FrameParser};

use super::*;

fn frame(id: u8, payload: &[u8]) -> Vec<u8> {
    FrameEncoder::new(id, payload).collect()
}

fn kinds(bytes: &[u8]) -> Vec<(usize, Kind)> {
    scan(bytes).into_iter().map(|run| (run.range.len(), run.kind)).collect()
}

#[test]
fn noise_frames_and_damage_are_distinguished_with_positions() {
    let stop = frame(0x22, &[]);
    let mut damaged = frame(0x25, &[0, 0, 0xA0, 0x41, 0, 0, 0x48, 0x42]);
    let sum = [damaged[14], damaged[15]];
    damaged[14] ^= 1;
    let recording = [&[1, 2, 0xAA][..], &stop, &damaged, &stop[..7]].concat();
    // The third byte could also start a preamble, of a frame with id AAh and 34 bytes of payload.
    let expected = [
        (2, Kind::Noise),
        (1, Kind::Incomplete(10)),
        (8, Kind::Frame),
        (16, Kind::BadChecksum(sum)),
        (7, Kind::Incomplete(1)),
    ];
    assert_eq!(kinds(&recording), expected);
}

#[test]
fn frame_inside_a_false_one_ends_it() {
    let stop = frame(0x22, &[]);
    let recording = [&[0xAA, 0xAA, 0xAA, 0x25, 16, 0, 7][..], &stop, &[0; 30]].concat();
    let found = kinds(&recording);
    assert!(matches!(found[0], (7, Kind::BadChecksum(_))), "{found:?}");
    assert_eq!(found[1..], [(8, Kind::Frame), (30, Kind::Noise)]);
}

#[test]
fn endless_preamble_is_one_run() {
    assert_eq!(kinds(&[0xAA; 500]), [(500, Kind::TooLong(0xAAAA))]);
}

/// Generates recordings of intact, damaged and truncated frames and noise.
fn recording() -> impl Strategy<Value = Vec<u8>> {
    let payload = prop::collection::vec(prop_oneof![Just(0xAA), any::<u8>()], 0..24);
    let whole = (any::<u8>(), payload).prop_map(|(id, payload)| frame(id, &payload));
    let damaged =
        (whole.clone(), any::<prop::sample::Index>(), 1..=255u8).prop_map(|(mut frame, at, bits)| {
            let at = at.index(frame.len());
            frame[at] ^= bits;
            frame
        });
    let piece = (whole.clone(), any::<prop::sample::Index>()).prop_map(|(mut frame, at)| {
        frame.truncate(at.index(frame.len()));
        frame
    });
    let noise = prop::collection::vec(prop_oneof![Just(0xAA), Just(0), any::<u8>()], 0..12);
    prop::collection::vec(prop_oneof![3 => whole, 1 => damaged, 1 => piece, 1 => noise], 0..8)
        .prop_map(|parts| parts.concat())
}

proptest! {
    #[test]
    fn scan_finds_the_frames_of_the_parser_and_every_byte_once(bytes in recording()) {
        let mut parser = FrameParser::<MAX_PAYLOAD_LEN>::new();
        let mut parsed = Vec::new();
        let mut take = |event: Option<Event<'_>>| {
            if let Some(Event::Frame(frame)) = event {
                parsed.push((frame.id, frame.payload.to_vec()));
            }
            event.is_some()
        };
        for byte in &bytes {
            let mut more = take(parser.push(*byte));
            while more {
                more = take(parser.poll());
            }
        }
        while take(parser.expire()) {}

        let runs = scan(&bytes);
        let mut end = 0;
        for run in &runs {
            prop_assert_eq!(run.range.start, end);
            prop_assert!(!run.range.is_empty());
            end = run.range.end;
        }
        prop_assert_eq!(end, bytes.len());
        let found: Vec<_> = runs
            .iter()
            .filter(|run| run.kind == Kind::Frame)
            .map(|run| (bytes[run.range.start + 3], bytes[run.range.start + 6..run.range.end - 2].to_vec()))
            .collect();
        prop_assert_eq!(found, parsed);
        let dropped: usize = runs.iter().filter(|run| run.kind != Kind::Frame).map(|run| run.range.len()).sum();
        prop_assert_eq!(dropped, usize::from(parser.counters().dropped));
    }
}
