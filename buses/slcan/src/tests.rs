//! Lines of adapters and hosts: valid, malformed and noisy.

use super::*;
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

fn lines(bytes: &[u8]) -> Vec<Line<ClassicFrame>> {
    let mut decoder = Decoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
}

fn frame(id: impl Into<Id>, data: &[u8]) -> ClassicFrame {
    ClassicFrame::new(id, data).unwrap()
}

#[test]
fn frames_of_both_lengths_and_kinds_are_decoded() {
    let n = StandardId::new(0x120).unwrap();
    let extended = ExtendedId::new(0x1ABC_DEF0).unwrap();
    for (text, expected) in [
        (&b"t1200\r"[..], frame(n, &[])),
        (b"t120801020304050607FF\r", frame(n, &[1, 2, 3, 4, 5, 6, 7, 0xFF])),
        (b"t1202abCd\r", frame(n, &[0xAB, 0xCD])),
        (b"t1202ABCD1F3A\r", frame(n, &[0xAB, 0xCD])),
        (b"T1ABCDEF015A\r", frame(extended, &[0x5A])),
        (b"r1203\r", ClassicFrame::new_remote(n, 3).unwrap()),
        (b"R1ABCDEF00\r", ClassicFrame::new_remote(extended, 0).unwrap()),
    ] {
        assert_eq!(lines(text), [Line::Frame(expected)], "{}", core::str::from_utf8(text).unwrap());
    }
}

#[test]
fn invalid_frames_are_malformed() {
    for text in [
        "t8000",
        "t12",
        "t",
        "t120",
        "t1209112233445566778899",
        "t1202AB",
        "t1202ABC",
        "t1202ABCDEF",
        "t120 0",
        "t12G0",
        "t1201G0",
        "T1ABCDEF",
        "T200000000",
        "r1209",
        "r12021122334",
        "t1200 ",
        "t1201+1",
        "t12000000000",
    ] {
        let line: Vec<u8> = text.bytes().chain([b'\r']).collect();
        assert_eq!(lines(&line), [Line::Malformed], "{text}");
    }
}

#[test]
fn line_after_noise_of_any_length_is_decoded() {
    for noise in 0..3 * MAX_LINE_LEN {
        let mut bytes = vec![b'#'; noise];
        bytes.extend(b"\rt1200\r");
        let read = lines(&bytes);
        assert_eq!(read.last(), Some(&Line::Frame(frame(StandardId::new(0x120).unwrap(), &[]))), "{noise}");
        assert_eq!(read[0] == Line::Malformed, noise > MAX_LINE_LEN, "{noise}");
    }
}

#[test]
fn nul_is_ignored_before_a_line_but_invalidates_a_frame_inside() {
    let expected = Line::Frame(frame(StandardId::new(0x120).unwrap(), &[]));
    for line in [&b"\0t1200\r"[..], b"\0\0\0t1200\r", b"\n\0\nt1200\r"] {
        assert_eq!(lines(line), [expected], "{}", line.escape_ascii());
    }
    assert_eq!(lines(b"O\r\0t1200\r\0"), [Line::Command(b'O', None), expected]);
    for line in [&b"t12\x0000\r"[..], b"t1200\0\r", b"\xFFt1200\r\0"] {
        assert_ne!(lines(line), [expected], "{}", line.escape_ascii());
    }
}

#[test]
fn responses_and_commands_are_distinguished() {
    let expected = [
        Line::Done,
        Line::Refused,
        Line::Taken(b'z'),
        Line::Command(b'O', None),
        Line::Command(b'S', Some(b'6')),
    ];
    assert_eq!(lines(b"\r\x07z\rO\r\nS6\r"), expected);
    // BEL in the middle of a line discards the start of the line.
    assert_eq!(lines(b"t12\x07\r"), [Line::Refused, Line::Done]);
}

#[test]
fn adapter_responds_to_its_host_but_not_to_responses() {
    let mut adapter = Adapter::new();
    let script: [(&[u8], &[u8]); 22] = [
        (b"t1200\r", b"\x07"),
        (b"S0\r", b"\r"),
        (b"S8\r", b"\r"),
        (b"S9\r", b"\x07"),
        (b"S\r", b"\x07"),
        (b"s031C\r", b"\r"),
        (b"s\r", b"\x07"),
        (b"Z0\r", b"\r"),
        (b"Z1\r", b"\x07"),
        (b"L\r", b"\x07"),
        (b"O\r", b"\r"),
        (b"t1200\r", b"z\r"),
        (b"T000001200\r", b"Z\r"),
        (b"t12\r", b"\x07"),
        (b"F\r", b"F00\r"),
        (b"V\r", b"V0101\r"),
        (b"N\r", b"N0001\r"),
        (b"\r", b""),
        (b"z\rZ\r\x07", b""),
        (b"?\r", b"\x07"),
        (b"C\r", b"\r"),
        (b"t1200\r", b"\x07"),
    ];
    for (asked, answer) in script {
        let given: Vec<u8> = lines(asked).iter().flat_map(|line| adapter.answer(line)).copied().collect();
        assert_eq!(given, answer, "{}", core::str::from_utf8(asked).unwrap());
    }
}

#[test]
fn channel_is_open_between_its_open_and_close_commands() {
    let mut adapter = Adapter::new();
    let opens = |adapter: &mut Adapter, line: &[u8]| {
        for line in lines(line) {
            adapter.answer(&line);
        }
        adapter.is_open()
    };
    assert!(!adapter.is_open());
    assert!(!opens(&mut adapter, b"S6\r"));
    assert!(opens(&mut adapter, b"O\r"));
    assert!(opens(&mut adapter, b"t1200\r"));
    assert!(!opens(&mut adapter, b"C\r"));
}

proptest! {
    #[test]
        fn every_frame_is_decoded_as_encoded(
        number in 0u32..=0x1FFF_FFFF,
        is_standard: bool,
        is_remote: bool,
        data in prop::collection::vec(any::<u8>(), 0..=8),
    ) {
        let id = if is_standard {
            Id::Standard(StandardId::new(number as u16 & 0x7FF).unwrap())
        } else {
            Id::Extended(ExtendedId::new(number).unwrap())
        };
        let frame =
            if is_remote { ClassicFrame::new_remote(id, data.len()) } else { ClassicFrame::new(id, &data) }.unwrap();
        prop_assert_eq!(lines(encode(&frame).as_bytes()), [Line::Frame(frame)]);
        prop_assert_eq!((frame.dlc(), frame.data().is_empty()), (data.len(), is_remote || data.is_empty()));
    }
}

#[test]
fn longest_line_fits() {
    let longest = frame(ExtendedId::MAX, &[0xFF; 8]);
    assert_eq!(encode(&longest).as_bytes(), b"T1FFFFFFF8FFFFFFFFFFFFFFFF\r");
    let stamped = b"T1FFFFFFF8FFFFFFFFFFFFFFFF1234\r";
    assert_eq!(stamped.len(), MAX_LINE_LEN + 1);
    assert_eq!(lines(stamped), [Line::Frame(longest)]);
}
