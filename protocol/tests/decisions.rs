//! The crate's decisions where the manuals err, contradict each other or are ambiguous.
//!
//! `docs/decisions.md` lists every decision with its test. This file holds the tests that belong to no single module.

use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD};
use wsg_protocol::{
    Command, CommandId, DecodeError, Event, FingerFlags, Frame, FrameEncoder, FrameParser, LoopData,
    PrePositionFlags, Reply, Status, Value, checksum,
};

/// Checks the parser's only event for a complete frame.
fn parsed(line: &[u8], check: impl FnOnce(Event<'_>)) {
    let mut parser = FrameParser::<{ MAX_MESSAGE_LEN - OVERHEAD }>::new();
    let (taken, event) = parser.push_slice(line);
    assert_eq!(taken, line.len());
    check(event.expect("an event at the frame's last byte"));
}

#[test]
fn second_example_of_the_manual_carries_id_1() {
    let line = [0xAA, 0xAA, 0xAA, 0x01, 0x02, 0x00, 0x12, 0x34, 0x6D, 0x66];
    parsed(&line, |event| assert_eq!(event, Event::Frame(Frame { id: 1, payload: &[0x12, 0x34] })));
}

#[test]
fn third_manual_example_is_intact_but_does_not_answer_its_id() {
    // The manual prints it as the answer to Get Acceleration (31h), but with the ID of Set Acceleration (30h), which returns
    // no value.
    let line = [0xAA, 0xAA, 0xAA, 0x30, 0x06, 0x00, 0x00, 0x00, 0x00, 0x00, 0x16, 0x43, 0xDC, 0xCB];
    parsed(&line, |event| {
        let Event::Frame(frame) = event else { panic!("{event:?}") };
        assert_eq!(Reply::decode(&frame), Err(DecodeError::TooLong));
        let as_meant = Frame { id: 0x31, ..frame };
        assert_eq!(Reply::decode(&as_meant).unwrap().value(), Some(Value::GetAcceleration(150.0)));
    });
}

#[test]
fn ids_that_the_manual_misprints_are_those_of_its_own_sections() {
    for (id, code, section) in [
        (CommandId::GetGrippingStatistics, 0x42, "3.4.3"),
        (CommandId::ReleasePart, 0x26, "3.2.7"),
        (CommandId::GetFinger1Data, 0x63, "3.6.4"),
        (CommandId::GetFinger2Data, 0x73, "3.6.8"),
    ] {
        assert_eq!((id.code(), id.section()), (code, section), "{id}");
    }
}

#[test]
fn finger_flags_have_bit_10_from_the_gcl_manual() {
    assert_eq!(FingerFlags::INIT_FAULT.bits(), 1 << 10);
}

/// Command set, 3.4.7: with the 0.1 °C steps of the other examples, FFF5h is -1.1 °C and not the printed -1.0 °C.
#[test]
fn temperature_fff5h_is_minus_1_1_degrees() {
    for (raw, text) in [
        (0xFFF5, "-1.1 °C"),
        (0xFFF6, "-1.0 °C"),
        (0xFFFF, "-0.1 °C"),
        (0, "0.0 °C"),
        (0x0A, "1.0 °C"),
        (0xC8, "20.0 °C"),
        (0x1F4, "50.0 °C"),
    ] {
        let [low, high] = u16::to_le_bytes(raw);
        let payload = [0, 0, low, high];
        let reply = Reply::decode(&Frame { id: 0x46, payload: &payload }).unwrap();
        let Some(Value::GetTemperature(temperature)) = reply.value() else { panic!("{reply}") };
        assert_eq!(temperature.to_string(), text);
    }
}

/// The lists "Possible Status Codes" and "Mögliche Statuscodes" of chapter 3, for the commands where the English and the
/// German manual differ or this project adds to both: (ID, in English, in German too, added).
#[test]
fn status_codes_match_both_manuals_plus_the_listed_additions() {
    use Status::{
        AccessDenied, AlreadyRunning, CmdFailed, CmdFormatError, CmdPending, IndexOutOfBounds,
        InsufficientResources, InvalidParameter, IoError, NoParamExpected, NotAvailable, NotInitialized,
        Overrun, RangeError, Success,
    };
    type List = &'static [Status];
    const MOTION: List = &[AccessDenied, AlreadyRunning, CmdFormatError, RangeError, CmdPending];
    const QUERY: List = &[Success, NoParamExpected];
    const FINGER: List = &[Success, CmdFormatError];
    let lists: [(u8, List, List, List); 16] = [
        (0x06, &[CmdFormatError, InvalidParameter, CmdPending], &[], &[Success]),
        (0x25, MOTION, &[], &[NotInitialized]),
        (0x26, MOTION, &[], &[NotInitialized]),
        (0x46, QUERY, &[InsufficientResources], &[]),
        (0x50, QUERY, &[InsufficientResources], &[]),
        (0x51, &[Success, Overrun, InvalidParameter], &[InsufficientResources], &[]),
        (0x52, &[Success, NoParamExpected, NotAvailable, InsufficientResources], &[], &[]),
        (0x53, QUERY, &[InsufficientResources], &[]),
        (0x60, FINGER, &[InsufficientResources], &[]),
        (0x61, FINGER, &[IndexOutOfBounds, InsufficientResources], &[]),
        (0x62, &[Success, CmdFormatError, CmdFailed, CmdPending], &[], &[]),
        (0x63, &[Success, CmdFormatError, IoError, NotAvailable], &[], &[]),
        (0x70, FINGER, &[InsufficientResources], &[]),
        (0x71, FINGER, &[InsufficientResources], &[]),
        (0x72, &[Success, CmdFormatError, CmdFailed, CmdPending], &[], &[]),
        (0x73, &[Success, CmdFormatError, IoError, NotAvailable], &[], &[]),
    ];
    for (id, english, german, added) in lists {
        let mut expected = [english, german, added].concat();
        let mut listed = CommandId::from_code(id).immediate_statuses().to_vec();
        expected.sort_by_key(|status| status.code());
        listed.sort_by_key(|status| status.code());
        assert_eq!(listed, expected, "{id:02X}h");
    }
}

#[test]
fn status_19_is_e_cmd_aborted() {
    assert_eq!(Status::from_code(19).symbol(), "E_CMD_ABORTED");
}

#[test]
fn pre_position_turned_into_fast_stop_by_two_bits_is_refused() {
    let pre_position = Command::PrePosition { flags: PrePositionFlags::empty(), width: 80.0, speed: 200.0 };
    let line: Vec<u8> = FrameEncoder::new(0x21, pre_position).collect();
    let overlooked = (8 * 6..8 * (line.len() - 2)).filter(|bit| {
        let mut damaged = line.clone();
        damaged[3] = 0x23;
        damaged[bit / 8] ^= 1 << (bit % 8);
        if checksum::of(&damaged) != 0 {
            return false;
        }
        parsed(&damaged, |event| {
            let Event::Frame(frame) = event else { panic!("{event:?}") };
            assert_eq!(Command::decode(&frame), Err(DecodeError::TooLong));
        });
        true
    });
    assert!(overlooked.count() > 0, "no such error passes the checksum");
}

#[test]
fn message_of_maximum_length_is_delivered() {
    let payload = [0x55; MAX_MESSAGE_LEN - OVERHEAD];
    let line: Vec<u8> = FrameEncoder::new(0xA0, &payload[..]).collect();
    assert_eq!(line.len(), 1024);
    parsed(&line, |event| assert_eq!(event, Event::Frame(Frame { id: 0xA0, payload: &payload })));
}

#[test]
fn handshake_of_eight_ff_bytes_is_a_valid_loop_command() {
    let data = [0xFF; 8];
    let handshake = Command::Loop { data: LoopData::new(&data).unwrap() };
    let line: Vec<u8> = FrameEncoder::new(0x06, handshake).collect();
    parsed(&line, |event| {
        let Event::Frame(frame) = event else { panic!("{event:?}") };
        assert_eq!(Command::decode(&frame), Ok(handshake));
    });
}
