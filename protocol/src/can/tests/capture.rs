//! Compares the reassembler with a reader of the whole capture.

use super::*;

/// The reference: tries each position in turn on the whole capture. Returns the events and the number of frames that
/// belong to no message.
fn reference(capture: &[CanFrame], limit: usize) -> (Vec<Seen>, u16) {
    let (mut seen, mut dropped, mut at) = (Vec::new(), 0, 0);
    while at < capture.len() {
        let found = found_at(&capture[at..], limit);
        if let Some(Seen::Message(message)) = &found {
            at += message.frames().len();
        } else {
            (at, dropped) = (at + 1, dropped + 1);
        }
        seen.extend(found);
    }
    (seen, dropped)
}

fn found_at(rest: &[CanFrame], limit: usize) -> Option<Seen> {
    let first = &rest[0].data;
    if first.len() != 8 || !first.starts_with(&[0xAA; 3]) {
        return None;
    }
    let (id, size) = (first[3], u16::from_le_bytes([first[4], first[5]]));
    let message = Message::new(id, &vec![0; size.into()]);
    let cut: Vec<usize> = message.frames().iter().map(|frame| frame.data.len()).collect();
    if cut.len() > limit {
        return Some(Seen::Oversize(id, size));
    }
    if !rest.iter().map(|frame| frame.data.len()).take(cut.len()).eq(cut.iter().copied()) {
        return None;
    }
    let bytes: Vec<u8> = rest[..cut.len()].iter().flat_map(|frame| frame.data.clone()).collect();
    let (covered, received) = bytes.split_at(bytes.len() - 2);
    if checksum::of(covered).to_le_bytes() != received {
        return Some(Seen::BadChecksum(id, size));
    }
    Some(Seen::Message(Message::new(id, &covered[6..])))
}

/// Generates frames of the received identifier: intact, truncated, duplicated or reordered messages, and noise.
fn recordings() -> impl Strategy<Value = Vec<CanFrame>> {
    let preamble_like = prop_oneof![Just(0xAAu8), Just(0xAA), Just(0), Just(1), Just(8), any::<u8>()];
    let payload = prop::collection::vec(preamble_like.clone(), 0..40);
    let message = (any::<u8>(), payload).prop_map(|(id, payload)| Message::new(id, &payload).frames());
    let damaged =
        (message.clone(), any::<prop::sample::Index>(), 0..3).prop_map(|(mut frames, index, fate)| {
            let at = index.index(frames.len());
            match fate {
                0 => drop(frames.remove(at)),
                1 => frames.insert(at, frames[at].clone()),
                _ => frames[at].data.truncate(3),
            }
            frames
        });
    let beginning = (0u8..60).prop_map(|size| vec![CanFrame::ours(&[0xAA, 0xAA, 0xAA, 6, size, 0, 1, 2])]);
    let noise = prop::collection::vec(preamble_like, 1..=8).prop_map(|data| vec![CanFrame::ours(&data)]);
    let piece = prop_oneof![3 => message, 3 => damaged, 1 => beginning, 1 => noise];
    prop::collection::vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4_000, ..ProptestConfig::default() })]

    #[test]
    fn any_recording_gives_what_the_reference_finds_in_it(capture in recordings()) {
        // Capacity of five frames: longer messages of the recordings are oversize.
        let mut wire = Wire::<5>::new();

        wire.receive(&capture);
        wire.pass(HALF_MS);

        let (seen, dropped) = reference(&capture, 5);
        prop_assert_eq!(&wire.seen, &seen);
        let counters = wire.reassembler.counters();
        prop_assert_eq!(counters.dropped, dropped);
        let count = |wanted: fn(&Seen) -> bool| seen.iter().filter(|seen| wanted(seen)).count() as u16;
        prop_assert_eq!(counters.bad_checksum, count(|seen| matches!(seen, Seen::BadChecksum(..))));
        prop_assert_eq!(counters.oversize, count(|seen| matches!(seen, Seen::Oversize(..))));
    }

    #[test]
    fn messages_cut_by_the_segmenter_are_put_together_again(
        messages in prop::collection::vec((any::<u8>(), prop::collection::vec(any::<u8>(), 0..120)), 0..8)
    ) {
        let messages: Vec<Message> = messages.iter().map(|(id, payload)| Message::new(*id, payload)).collect();
        let line: Vec<u8> = messages.iter().flat_map(Message::bytes).collect();

        let frames: Vec<CanFrame> =
            Segments::new(line.into_iter()).map(|segment| segment.frame(RECEIVED).unwrap()).collect();
        let mut wire = Wire::<16>::new();
        wire.receive(&frames);

        prop_assert_eq!(frames, messages.iter().flat_map(Message::frames).collect::<Vec<_>>());
        prop_assert_eq!(wire.messages(), messages);
        prop_assert_eq!(wire.reassembler.counters(), ReassemblerCounters::default());
    }
}
