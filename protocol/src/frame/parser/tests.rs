//! Compares the parser with a naive reader of the whole recording, and tests edge cases one by one.

use super::*;
use crate::frame::FrameEncoder;
use proptest::prelude::*;
use std::vec::Vec;

/// An event by value, for comparison.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Seen {
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

/// The reference: scans the whole recording, one position after the other. Returns the events, the number of dropped
/// bytes, and the number of bytes at the end that may still become a frame.
fn reference(bytes: &[u8], limit: usize, ended: bool) -> (Vec<Seen>, usize, usize) {
    let (mut events, mut dropped, mut at) = (Vec::new(), 0, 0);
    while at < bytes.len() {
        let rest = &bytes[at..];
        let preamble = rest.iter().take(3).take_while(|&&byte| byte == 0xAA).count();
        if preamble < rest.len().min(3) {
            (at, dropped) = (at + 1, dropped + 1);
            continue;
        }
        if rest.len() >= 6 {
            let size = u16::from_le_bytes([rest[4], rest[5]]) as usize;
            if size > limit {
                events.push(Seen::Oversize(rest[3], size as u16));
                (at, dropped) = (at + 1, dropped + 1);
                continue;
            }
            if rest.len() >= size + 8 {
                if checksum::of(&rest[..size + 6]).to_le_bytes() == rest[size + 6..size + 8] {
                    events.push(Seen::Frame(rest[3], rest[6..6 + size].to_vec()));
                    at += size + 8;
                } else {
                    events.push(Seen::BadChecksum(rest[3], size as u16));
                    (at, dropped) = (at + 1, dropped + 1);
                }
                continue;
            }
        }
        if !ended {
            break;
        }
        (at, dropped) = (at + 1, dropped + 1);
    }
    (events, dropped, bytes.len() - at)
}

fn by_byte<const N: usize>(parser: &mut FrameParser<N>, bytes: &[u8]) -> Vec<Seen> {
    let mut events = Vec::new();
    for &byte in bytes {
        events.extend(parser.push(byte).map(Seen::from));
    }
    while let Some(event) = parser.poll() {
        events.push(event.into());
    }
    events
}

fn by_slices<const N: usize>(parser: &mut FrameParser<N>, slices: &[&[u8]]) -> Vec<Seen> {
    let mut events = Vec::new();
    for slice in slices {
        let mut rest = *slice;
        loop {
            let (taken, event) = parser.push_slice(rest);
            rest = &rest[taken..];
            match event {
                Some(event) => events.push(event.into()),
                None => break,
            }
        }
        assert!(rest.is_empty(), "all bytes must be taken if there is no event");
    }
    events
}

fn expire_all<const N: usize>(parser: &mut FrameParser<N>) -> Vec<Seen> {
    let mut events = Vec::new();
    while let Some(event) = parser.expire() {
        events.push(event.into());
    }
    events
}

fn frame(id: u8, payload: &[u8]) -> Vec<u8> {
    FrameEncoder::new(id, payload).collect()
}

/// Generates streams with frequent false preambles, damaged frames and intact frames.
fn stream() -> impl Strategy<Value = Vec<u8>> {
    let bytes = prop_oneof![
        3 => proptest::collection::vec(prop_oneof![Just(0xAAu8), Just(0u8), Just(1), Just(8), any::<u8>()], 0..12),
        2 => (any::<u8>(), proptest::collection::vec(prop_oneof![Just(0xAAu8), any::<u8>()], 0..20))
            .prop_map(|(id, payload)| frame(id, &payload)),
        1 => (any::<u8>(), proptest::collection::vec(any::<u8>(), 0..16), any::<prop::sample::Index>(), 1..=255u8)
            .prop_map(|(id, payload, at, flip)| {
                let mut bytes = frame(id, &payload);
                let at = at.index(bytes.len());
                bytes[at] ^= flip;
                bytes
            }),
        1 => (0..40u16).prop_map(|size| {
            let [low, high] = size.to_le_bytes();
            std::vec![0xAA, 0xAA, 0xAA, 0x25, low, high]
        }),
        // A complete frame inside the payload of a frame with a wrong checksum.
        1 => (any::<u8>(), proptest::collection::vec(any::<u8>(), 0..6)).prop_map(|(id, payload)| {
            let mut bytes = frame(id, &frame(id, &payload));
            if let Some(last) = bytes.last_mut() { *last ^= 0x40 }
            bytes
        }),
    ];
    proptest::collection::vec(bytes, 0..10).prop_map(|parts| parts.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn bytes_and_slices_and_the_reference_agree(bytes in stream(), cuts in proptest::collection::vec(0..200usize, 0..6)) {
        let (expected, dropped, held) = reference(&bytes, 16, false);
        let mut parser = FrameParser::<16>::new();
        prop_assert_eq!(&by_byte(&mut parser, &bytes), &expected);
        prop_assert_eq!(parser.counters().dropped as usize, dropped);

        let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(bytes.len())).collect();
        cuts.extend([0, bytes.len()]);
        cuts.sort_unstable();
        let slices: Vec<&[u8]> = cuts.windows(2).map(|pair| &bytes[pair[0]..pair[1]]).collect();
        let mut sliced = FrameParser::<16>::new();
        prop_assert_eq!(&by_slices(&mut sliced, &slices), &expected);
        prop_assert_eq!(sliced.counters(), parser.counters());

        // Every byte is part of a frame, dropped or still held.
        let framed: usize = expected.iter().map(|seen| if let Seen::Frame(_, p) = seen { p.len() + 8 } else { 0 }).sum();
        prop_assert_eq!(framed + dropped + held, bytes.len());
        prop_assert_eq!(parser.is_mid_frame(), held > 0);
    }

    #[test]
    fn every_single_cut_gives_the_same_events(bytes in stream()) {
        let (expected, ..) = reference(&bytes, 16, false);
        for cut in 0..=bytes.len() {
            let (first, second) = bytes.split_at(cut);
            prop_assert_eq!(&by_slices(&mut FrameParser::<16>::new(), &[first, second]), &expected);
        }
    }

    #[test]
    fn expiry_yields_the_reference_events_of_an_ended_recording(bytes in stream()) {
        let (expected, dropped, _) = reference(&bytes, 16, true);
        let mut parser = FrameParser::<16>::new();
        let mut events = by_byte(&mut parser, &bytes);
        events.extend(expire_all(&mut parser));
        prop_assert_eq!(events, expected);
        prop_assert_eq!(parser.counters().dropped as usize, dropped);
        prop_assert!(!parser.is_mid_frame());
    }

    #[test]
    fn an_intact_frame_after_any_noise_is_delivered(noise in proptest::collection::vec(prop_oneof![Just(0xAAu8), any::<u8>()], 0..60)) {
        // The noise may open a frame that swallows the intact one. A time-out then discards it, and the scan finds the
        // intact frame. (The reference covers noise that forms a valid frame by chance.)
        let intact = frame(0x25, &[0x00, 0x00]);
        let bytes = [noise, intact].concat();
        let (expected, ..) = reference(&bytes, 16, true);
        prop_assume!(expected.last() == Some(&Seen::Frame(0x25, std::vec![0, 0])));
        let mut parser = FrameParser::<16>::new();
        let mut events = by_byte(&mut parser, &bytes);
        events.extend(expire_all(&mut parser));
        prop_assert_eq!(events.last(), expected.last());
    }
}

#[test]
fn frames_of_the_manual_are_delivered() {
    for (bytes, id, payload) in [
        (&[0xAA, 0xAA, 0xAA, 0x01, 0x00, 0x00, 0xE8, 0x10][..], 0x01, &[][..]),
        (&[0xAA, 0xAA, 0xAA, 0x01, 0x02, 0x00, 0x12, 0x34, 0x6D, 0x66], 0x01, &[0x12, 0x34]),
        (&[0xAA, 0xAA, 0xAA, 0x20, 0x02, 0x00, 0x00, 0x00, 0xB3, 0xFD], 0x20, &[0, 0]),
        (&[0xAA, 0xAA, 0xAA, 0x90, 0x02, 0x00, 0x0E, 0x00, 0xFD, 0x02], 0x90, &[0x0E, 0]),
        (
            &[0xAA, 0xAA, 0xAA, 0x30, 0x06, 0x00, 0x00, 0x00, 0x00, 0x00, 0x16, 0x43, 0xDC, 0xCB],
            0x30,
            &[0, 0, 0, 0, 0x16, 0x43],
        ),
        (&[0xAA, 0xAA, 0xAA, 0x21, 0x02, 0x00, 0x1A, 0x00, 0x67, 0xCB], 0x21, &[0x1A, 0]),
        (&[0xAA, 0xAA, 0xAA, 0x21, 0x02, 0x00, 0x00, 0x00, 0x28, 0x04], 0x21, &[0, 0]),
    ] {
        assert_eq!(by_byte(&mut FrameParser::<16>::new(), bytes), [Seen::Frame(id, payload.to_vec())]);
        assert_eq!(frame(id, payload), bytes, "the encoder must write the same bytes");
    }
}

#[test]
fn two_frames_in_one_slice_are_both_delivered() {
    let bytes = [frame(0x21, &[0x1A, 0]), frame(0x21, &[0, 0])].concat();
    let events = by_slices(&mut FrameParser::<16>::new(), &[&bytes]);
    assert_eq!(events, [Seen::Frame(0x21, std::vec![0x1A, 0]), Seen::Frame(0x21, std::vec![0, 0])]);
}

#[test]
fn preamble_inside_a_payload_is_payload() {
    let payload = [0xAA; 9];
    assert_eq!(
        by_byte(&mut FrameParser::<16>::new(), &frame(6, &payload)),
        [Seen::Frame(6, payload.to_vec())]
    );
}

#[test]
fn size_over_the_limit_is_an_event_and_costs_no_frame() {
    let bytes = [&[0xAA, 0xAA, 0xAA, 0x06, 0x11, 0x00][..], &frame(1, &[])].concat();
    let events = by_byte(&mut FrameParser::<16>::new(), &bytes);
    assert_eq!(events, [Seen::Oversize(6, 17), Seen::Frame(1, std::vec![])]);
}

#[test]
fn loop_reply_of_258_bytes_fits_a_parser_that_size() {
    let payload: Vec<u8> = (0..258u32).map(|n| n as u8).collect();
    let bytes = frame(6, &payload);
    assert_eq!(by_slices(&mut FrameParser::<258>::new(), &[&bytes]), [Seen::Frame(6, payload)]);
}

#[test]
fn full_store_still_accepts_a_byte_during_a_rescan() {
    // A false frame of maximum size whose payload is a run of frames, so every held byte is needed.
    let inner = [frame(1, &[]), frame(2, &[])].concat();
    let mut bytes = frame(0xAA, &inner);
    if let Some(last) = bytes.last_mut() {
        *last ^= 0xFF;
    }
    bytes.extend(frame(3, &[9]));
    let (expected, ..) = reference(&bytes, 16, false);
    assert_eq!(by_byte(&mut FrameParser::<16>::new(), &bytes), expected);
    assert_eq!(expected.iter().filter(|seen| matches!(seen, Seen::Frame(..))).count(), 3);
}

#[test]
fn reset_counts_what_it_forgets() {
    let mut parser = FrameParser::<16>::new();
    assert!(by_byte(&mut parser, &[0xAA, 0xAA, 0xAA, 0x25, 0x08]).is_empty());
    parser.reset();
    assert_eq!(parser.counters().dropped, 5);
    assert!(!parser.is_mid_frame());
    assert_eq!(by_byte(&mut parser, &frame(1, &[])), [Seen::Frame(1, std::vec![])]);
}

#[test]
fn wrong_checksum_is_taken_when_evaluation_is_off() {
    let mut bytes = frame(0x20, &[0]);
    let length = bytes.len();
    bytes[length - 2..].copy_from_slice(&[0, 0]);
    assert_eq!(by_byte(&mut FrameParser::<16>::new(), &bytes), [Seen::BadChecksum(0x20, 1)]);
    assert_eq!(
        by_byte(&mut FrameParser::<16>::ignoring_checksums(), &bytes),
        [Seen::Frame(0x20, std::vec![0])]
    );
}

#[test]
fn counters_stop_at_their_end() {
    let mut parser = FrameParser::<0>::new();
    for _ in 0..70_000 {
        assert!(parser.push(0x00).is_none());
    }
    assert_eq!(parser.counters().dropped, u16::MAX);
}

#[test]
fn reset_state_is_all_zero_so_a_static_parser_lies_in_bss() {
    let parser = FrameParser::<16>::new();
    let Store { head, body, tail } = parser.store;
    assert_eq!((head, body, tail), ([0; 3], [0; 16], [0; 2]));
    assert_eq!((parser.flags, parser.held, parser.checksum_or_next), (0, 0, 0));
    assert_eq!(parser.counters, FrameCounters::default());
}

#[test]
fn checksum_that_only_leads_to_zero_is_refused() {
    let good = frame(0x21, &[0x1A, 0]);
    let mut accepted = 0;
    for wrong in 0..=u16::MAX {
        let mut bytes = good.clone();
        bytes[8..].copy_from_slice(&wrong.to_le_bytes());
        let leads_to_zero = checksum::of(&bytes) == 0;
        accepted += usize::from(leads_to_zero);
        let is_frame = matches!(by_byte(&mut FrameParser::<16>::new(), &bytes)[..], [Seen::Frame(..)]);
        assert_eq!(is_frame, bytes == good, "{wrong:04X}h");
    }
    assert_eq!(accepted, 4, "a test for 0 would accept four");
}
