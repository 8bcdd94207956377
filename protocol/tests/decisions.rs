//! What this crate does where the manuals err, contradict each other or can be read in two ways.
//!
//! `docs/decisions.md` lists every decision with the test that holds it; those that belong to no module's own tests
//! stand here.

use wsg_protocol::fieldbus::{CommandFlags, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::frame::{MAX_MESSAGE_LEN, OVERHEAD};
use wsg_protocol::{
    Command, CommandId, DecodeError, Event, FingerFlags, Frame, FrameEncoder, FrameParser, GripperState,
    LoopData, PrePositionFlags, Reply, Status, SystemFlags, Value, checksum,
};

/// The parser's one event for a whole frame.
fn parsed(line: &[u8], check: impl FnOnce(Event<'_>)) {
    let mut parser = FrameParser::<{ MAX_MESSAGE_LEN - OVERHEAD }>::new();
    let (taken, event) = parser.push_slice(line);
    assert_eq!(taken, line.len());
    check(event.expect("an event at the frame's last byte"));
}

/// An input image in which only `change` is not 0.
fn input(change: impl FnOnce(&mut InputImage)) -> [u8; InputImage::LEN] {
    let mut image = InputImage {
        state: GripperFlags::empty(),
        user: 0,
        system: SystemFlags::empty(),
        width: 0,
        force: 0,
        status: Status::Success,
    };
    change(&mut image);
    image.to_bytes()
}

/// The numbers of the coils or discrete inputs that are set: number n is bit n mod 8 of byte n div 8.
fn numbers(bytes: &[u8]) -> Vec<usize> {
    (0..8 * bytes.len()).filter(|n| bytes[n / 8] & (1 << (n % 8)) != 0).collect()
}

#[test]
fn second_example_of_the_manual_carries_id_1() {
    let line = [0xAA, 0xAA, 0xAA, 0x01, 0x02, 0x00, 0x12, 0x34, 0x6D, 0x66];
    parsed(&line, |event| assert_eq!(event, Event::Frame(Frame { id: 1, payload: &[0x12, 0x34] })));
}

#[test]
fn third_example_of_the_manual_is_intact_and_no_answer_of_the_command_whose_id_it_carries() {
    // Printed as the answer to Get Acceleration (31h) with the id of Set Acceleration (30h), which returns no value.
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
fn release_is_bit_2_of_the_command_flags_and_homing_bit_3() {
    assert_eq!(CommandFlags::RELEASE.bits(), 1 << 2);
    assert_eq!(CommandFlags::HOMING.bits(), 1 << 3);
}

#[test]
fn force_register_counts_hundredths_of_a_newton_and_tenths_on_a_wsg_70() {
    let image = OutputImage { force_limit: 405, ..OutputImage::ZERO };
    assert_eq!(image.force_limit_n(ForceUnit::Hundredth), 4.05);
    assert_eq!(image.force_limit_n(ForceUnit::Tenth), 40.5);
}

#[test]
fn gripper_state_1_is_one_state_under_both_names() {
    assert_eq!(GripperState::from_code(1), Some(GripperState::Gripping));
    assert_eq!(GripperFlags::from(GripperState::Gripping), GripperFlags::GRIPPING);
}

#[test]
fn finger_flags_have_bit_10_from_the_gcl_manual() {
    assert_eq!(FingerFlags::INIT_FAULT.bits(), 1 << 10);
}

/// Command set, 3.4.7: in steps of 0.1 °C as the other examples have it, FFF5h is -1.1 °C and not the -1.0 °C that are printed.
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

/// The lists of chapter 3, "Possible Status Codes" and "Mögliche Statuscodes", of the commands in which the English and the
/// German manual differ or this project adds to both: (id, in English, in German as well, added).
#[test]
fn status_codes_are_those_of_both_manuals_and_the_additions_are_these() {
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
fn first_byte_of_an_image_is_the_high_byte_of_register_0() {
    let image = OutputImage { flags: CommandFlags::MOVE, user: 1 << 5, ..OutputImage::ZERO };
    let [high, low, ..] = image.to_bytes();
    assert_eq!(u16::from_be_bytes([high, low]), 288);
}

#[test]
fn coils_and_inputs_count_from_byte_0_bit_0_of_the_whole_image() {
    let output = |flags, user| numbers(&OutputImage { flags, user, ..OutputImage::ZERO }.to_bytes());
    assert_eq!(output(CommandFlags::MOVE, 0), [0], "MOVE");
    assert_eq!(output(CommandFlags::empty(), 1), [8], "IF1");
    assert_eq!(numbers(&input(|image| image.state = GripperFlags::IDLE)), [0], "IDLE");
    assert_eq!(numbers(&input(|image| image.user = 1)), [8], "OF1");
    assert_eq!(numbers(&input(|image| image.system = SystemFlags::REFERENCED)), [16], "REFERENCED");
    assert_eq!(numbers(&input(|image| image.system = SystemFlags::SCRIPT_FAILURE)), [36], "SCRIPT_FAILURE");
}

#[test]
fn numbers_stand_high_byte_first_and_sysstate_as_a_vector_of_bits() {
    let image = OutputImage { width: -0x0102, speed: 0x0304, force_limit: 0x0506, ..OutputImage::ZERO };
    assert_eq!(image.to_bytes()[2..], [0xFE, 0xFE, 0x03, 0x04, 0x05, 0x06]);

    let image =
        input(|image| (image.width, image.force, image.status) = (0x0102, 0x0304, Status::CmdPending));
    assert_eq!(image[6..], [0x01, 0x02, 0x03, 0x04, 0x00, 26]);
    let system = input(|image| image.system = SystemFlags::from_bits_retain(0x0D0C_0B0A));
    assert_eq!(system[2..6], [0x0A, 0x0B, 0x0C, 0x0D], "byte 2 holds bits 0 to 7");
}

#[test]
fn sysstate_read_as_one_big_endian_number_shows_referenced_as_01000000h() {
    let image = input(|image| image.system = SystemFlags::REFERENCED);
    assert_eq!(u32::from_be_bytes([image[2], image[3], image[4], image[5]]), 0x0100_0000);
}

#[test]
fn state_shows_as_exactly_one_bit() {
    let shown = GripperState::ALL.iter().map(|&state| GripperFlags::from(state).bits());
    assert!(shown.eq((0..8).map(|bit| 1 << bit)));
}

#[test]
fn pre_position_that_two_wrong_bits_turn_into_a_fast_stop_is_refused() {
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
fn message_of_the_greatest_length_is_delivered() {
    let payload = [0x55; MAX_MESSAGE_LEN - OVERHEAD];
    let line: Vec<u8> = FrameEncoder::new(0xA0, &payload[..]).collect();
    assert_eq!(line.len(), 1024);
    parsed(&line, |event| assert_eq!(event, Event::Frame(Frame { id: 0xA0, payload: &payload })));
}

#[test]
fn handshake_of_eight_ff_bytes_is_a_loop_that_both_sides_understand() {
    let data = [0xFF; 8];
    let handshake = Command::Loop { data: LoopData::new(&data).unwrap() };
    let line: Vec<u8> = FrameEncoder::new(0x06, handshake).collect();
    parsed(&line, |event| {
        let Event::Frame(frame) = event else { panic!("{event:?}") };
        assert_eq!(Command::decode(&frame), Ok(handshake));
    });
}
