//! TCP frames as defined in the implementation guide, and invalid streams.

use super::*;
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

/// An event that owns its data.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Seen {
    Request(u16, u8, Vec<u8>),
    Foreign(u16),
    Lost,
}

fn seen(event: Event<'_>) -> Seen {
    match event {
        Event::Request(Request { transaction, unit, pdu }) => Seen::Request(transaction, unit, pdu.to_vec()),
        Event::Foreign { len } => Seen::Foreign(len),
        Event::Lost => Seen::Lost,
    }
}

fn whole(stream: &[u8]) -> Vec<Seen> {
    let (mut receiver, mut rest, mut all) = (Receiver::new(), stream, vec![]);
    while !rest.is_empty() {
        let (taken, event) = receiver.push_slice(rest);
        all.extend(event.map(seen));
        rest = &rest[taken..];
    }
    all
}

fn frame(transaction: u16, protocol: u16, unit: u8, pdu: &[u8]) -> Vec<u8> {
    let mut bytes = vec![];
    bytes.extend(transaction.to_be_bytes());
    bytes.extend(protocol.to_be_bytes());
    bytes.extend((pdu.len() as u16 + 1).to_be_bytes());
    bytes.push(unit);
    bytes.extend(pdu);
    bytes
}

#[test]
fn frame_of_another_protocol_is_discarded_and_the_next_found() {
    let stream = [frame(1, 0x0100, 1, &[6, 0, 0, 1, 0x20]), frame(2, 0, 1, &[7])].concat();
    assert_eq!(whole(&stream), [Seen::Foreign(12), Seen::Request(2, 1, vec![7])]);
}

#[test]
fn length_that_no_frame_has_loses_the_stream_for_good() {
    for length in [0, 1, 255, 256, u16::MAX] {
        for protocol in [0, 1] {
            let mut stream = frame(1, protocol, 1, &[7]);
            stream[4..6].copy_from_slice(&u16::to_be_bytes(length));
            stream.extend(frame(2, 0, 1, &[6, 0, 0, 1, 0x20]));
            assert_eq!(whole(&stream), [Seen::Lost], "{length}");
        }
    }
}

#[test]
fn lengths_from_2_to_254_are_accepted() {
    for len in 1..=MAX_PDU_LEN {
        let pdu = vec![9; len];
        assert_eq!(whole(&frame(1, 0, 1, &pdu)), [Seen::Request(1, 1, pdu)]);
    }
}

#[test]
fn partial_frame_waits_for_its_rest() {
    let bytes = frame(5, 0, 1, &[6, 0, 0, 1, 0x20]);
    let (last, head) = bytes.split_last().unwrap();
    let mut receiver = Receiver::new();
    assert_eq!(receiver.push_slice(head), (head.len(), None));
    assert_eq!(receiver.push(*last).map(seen), Some(Seen::Request(5, 1, vec![6, 0, 0, 1, 0x20])));
}

proptest! {
    #[test]
        fn any_stream_gives_the_same_events_however_it_is_cut(
        pieces in prop::collection::vec(
            prop_oneof![
                (any::<u16>(), 0u16..2, any::<u8>(), prop::collection::vec(any::<u8>(), 1..300))
                    .prop_map(|(transaction, protocol, unit, pdu)| frame(transaction, protocol, unit, &pdu)),
                prop::collection::vec(prop_oneof![Just(0), 0u8..8, any::<u8>()], 0..20),
            ],
            0..8,
        ),
    ) {
        let stream = pieces.concat();
        let mut receiver = Receiver::new();
        let bytewise: Vec<Seen> = stream.iter().filter_map(|byte| receiver.push(*byte).map(seen)).collect();
        prop_assert_eq!(&bytewise, &whole(&stream));
                // Reference implementation over the complete stream.
        let (mut rest, mut expected) = (&stream[..], vec![]);
        while rest.len() >= LENGTH_END {
            let length = usize::from(rest[4]) << 8 | usize::from(rest[5]);
            if !(2..=254).contains(&length) {
                expected.push(Seen::Lost);
                break;
            }
            if rest.len() < LENGTH_END + length {
                break;
            }
            let transaction = u16::from(rest[0]) << 8 | u16::from(rest[1]);
            expected.push(match rest[2..4] {
                [0, 0] => Seen::Request(transaction, rest[6], rest[7..LENGTH_END + length].to_vec()),
                _ => Seen::Foreign((LENGTH_END + length) as u16),
            });
            rest = &rest[LENGTH_END + length..];
        }
        prop_assert_eq!(bytewise, expected);
    }
}

#[test]
fn stream_is_lost_from_an_invalid_length_on() {
    let mut receiver = Receiver::new();
    assert!(!receiver.is_lost());
    receiver.push_slice(&frame(1, 0, 1, &[3, 0, 0, 0, 1]));
    assert!(!receiver.is_lost(), "after a valid frame");
    assert_eq!(receiver.push_slice(&[0, 2, 0, 0, 0xFF, 0xFF]).1, Some(Event::Lost));
    assert!(receiver.is_lost());
    receiver.push_slice(&frame(3, 0, 1, &[3, 0, 0, 0, 1]));
    assert!(receiver.is_lost(), "a frame does not resynchronize");
}

#[test]
fn answers_of_every_pdu_length_are_framed_except_0() {
    let request = Request { transaction: 0xABCD, unit: 17, pdu: &[0x2B] };
    let longer_than_a_pdu = [MAX_PDU_LEN + 1, usize::MAX];
    for len in (0..=MAX_PDU_LEN).chain(longer_than_a_pdu) {
        let mut buffer = [0; MAX_FRAME_LEN];
        let answer = request.answer(&mut buffer, |_, place| {
            place.fill(9);
            len
        });
        let is_framed = len != 0 && !longer_than_a_pdu.contains(&len);
        let expected = if is_framed { frame(0xABCD, 0, 17, &vec![9; len]) } else { vec![] };
        assert_eq!(answer, expected, "{len}");
    }
}
