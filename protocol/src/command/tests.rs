//! Round trip of every command, and requests that the manual forbids.

use super::*;
use crate::frame::{FrameEncoder, FrameParser};
use crate::types::UpdateFlags;
use crate::{Event, Status};
use proptest::prelude::*;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

fn bytes(command: &Command<'_>) -> Vec<u8> {
    FrameEncoder::new(command.id().code(), *command).collect()
}

/// Encodes, parses and decodes the command.
fn there_and_back(command: &Command<'_>) -> Result<(), String> {
    let mut parser = FrameParser::<1016>::new();
    let line = bytes(command);
    match parser.push_slice(&line) {
        (taken, Some(Event::Frame(frame))) if taken == line.len() => {
            let decoded = Command::decode(&frame).map_err(|refusal| refusal.to_string())?;
            if &decoded == command { Ok(()) } else { Err(std::format!("{decoded:?} is not {command:?}")) }
        }
        other => Err(std::format!("{other:?}")),
    }
}

fn float() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |value| value.is_finite())
}

fn update() -> impl Strategy<Value = AutoUpdate> {
    (0..4u8, any::<u16>())
        .prop_map(|(flags, period_ms)| AutoUpdate { flags: UpdateFlags::from_bits_retain(flags), period_ms })
}

/// Generates any command from its parameters.
fn command() -> impl Strategy<Value = Command<'static>> {
    let simple = proptest::sample::select(CommandId::ALL.to_vec())
        .prop_filter_map("has no parameters", |id| {
            Command::decode(&Frame { id: id.code(), payload: &[] }).ok()
        });
    prop_oneof![
        8 => simple,
        1 => proptest::sample::select(HomingDirection::ALL.to_vec()).prop_map(|direction| Command::Homing { direction }),
        1 => (0..4u8, float(), float()).prop_map(|(flags, width, speed)| Command::PrePosition {
            flags: PrePositionFlags::from_bits_retain(flags), width, speed }),
        1 => (float(), float()).prop_map(|(width, speed)| Command::GripPart { width, speed }),
        1 => (float(), float()).prop_map(|(width, speed)| Command::ReleasePart { width, speed }),
        1 => Just(Command::ACKNOWLEDGE),
        1 => float().prop_map(|acceleration| Command::SetAcceleration { acceleration }),
        1 => float().prop_map(|force| Command::SetForceLimit { force }),
        1 => (float(), float()).prop_map(|(minus, plus)| Command::SetSoftLimits { limits: SoftLimits { minus, plus } }),
        1 => any::<bool>().prop_map(|enabled| Command::OverdriveMode { enabled }),
        1 => any::<bool>().prop_map(|reset| Command::GetGrippingStatistics { reset }),
        1 => any::<bool>().prop_map(|enabled| Command::Finger1Power { enabled }),
        1 => any::<bool>().prop_map(|enabled| Command::Finger2Power { enabled }),
        1 => update().prop_map(|update| Command::GetSystemState { update }),
        1 => update().prop_map(|update| Command::GetGripperState { update }),
        1 => update().prop_map(|update| Command::GetOpeningWidth { update }),
        1 => update().prop_map(|update| Command::GetSpeed { update }),
        1 => update().prop_map(|update| Command::GetForce { update }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_command_survives_the_round_trip(command in command()) {
        prop_assert_eq!(there_and_back(&command), Ok(()));
        prop_assert_eq!(command.check(), Ok(()));
    }

    #[test]
    fn loop_data_tags_and_unknown_commands_survive_a_round_trip(
        data in proptest::collection::vec(any::<u8>(), 0..=256), tag in "[ -~]{0,64}", id in 0xA0..=0xBFu8,
    ) {
        prop_assert_eq!(there_and_back(&Command::Loop { data: LoopData::new(&data).unwrap() }), Ok(()));
        prop_assert_eq!(there_and_back(&Command::SetDeviceTag { tag: DeviceTag::new(&tag).unwrap() }), Ok(()));
        prop_assert_eq!(there_and_back(&Command::Unknown { id, payload: &data }), Ok(()));
    }

    #[test]
    fn values_decoded_from_random_bytes_encode_to_the_same_bytes(
        id in proptest::sample::select(CommandId::ALL.to_vec()),
        payload in prop_oneof![
            proptest::collection::vec(any::<u8>(), 0..12),
            proptest::collection::vec(prop_oneof![Just(0u8), Just(1), Just(2), Just(3)], 0..12),
        ],
    ) {
        match Command::decode(&Frame { id: id.code(), payload: &payload }) {
            Ok(Command::SetDeviceTag { tag }) => prop_assert!(payload.starts_with(tag.as_str().as_bytes())),
            Ok(command) => {
                let line = bytes(&command);
                prop_assert_eq!(&line[6..line.len() - 2], &payload[..]);
                prop_assert_eq!(command.check(), Ok(()));
            }
            Err(refusal) => {
                let status = id.status_of(refusal);
                prop_assert!(status != Status::Success && status != Status::CmdPending);
            }
        }
    }
}

#[test]
fn grip_part_stands_in_the_frame_as_the_manual_says() {
    let grip = Command::GripPart { width: 20.0, speed: 50.0 };
    let expected = [0xAA, 0xAA, 0xAA, 0x25, 8, 0, 0x00, 0x00, 0xA0, 0x41, 0x00, 0x00, 0x48, 0x42];
    assert_eq!(bytes(&grip)[..14], expected);
}

#[test]
fn pre_position_d0_is_relative_and_d1_is_stop_on_block() {
    let flags_of = |flags: u8| {
        let payload = [flags, 0, 0, 0, 0, 0, 0, 0, 0];
        match Command::decode(&Frame { id: 0x21, payload: &payload }) {
            Ok(Command::PrePosition { flags, .. }) => Ok(flags),
            Ok(other) => panic!("{other:?}"),
            Err(refusal) => Err(refusal),
        }
    };
    assert_eq!(flags_of(1), Ok(PrePositionFlags::RELATIVE));
    assert_eq!(flags_of(2), Ok(PrePositionFlags::STOP_ON_BLOCK));
    assert_eq!(flags_of(4), Err(DecodeError::ReservedBits));
}

#[test]
fn each_refusal_names_its_reason_and_the_manuals_status_code() {
    let nan = f32::NAN.to_le_bytes();
    let grip_nan = [nan, [0; 4]].concat();
    let long_tag = [b'x'; 65];
    let long_loop = [0; 257];
    let cases: &[(u8, &[u8], DecodeError, Status)] = &[
        (0x06, &long_loop, DecodeError::TooLong, Status::CmdFormatError),
        (0x20, &[], DecodeError::TooShort, Status::CmdFormatError),
        (0x20, &[0, 0], DecodeError::TooLong, Status::CmdFormatError),
        (0x20, &[3], DecodeError::UndefinedValue, Status::InvalidParameter),
        (0x22, &[0], DecodeError::TooLong, Status::NoParamExpected),
        (0x24, b"act", DecodeError::AckKey, Status::CmdFormatError),
        (0x24, b"", DecodeError::TooShort, Status::CmdFormatError),
        (0x25, &grip_nan, DecodeError::NotFinite, Status::CmdFormatError),
        (0x31, &[0], DecodeError::TooLong, Status::NoParamExpected),
        (0x37, &[2], DecodeError::ReservedBits, Status::CmdFormatError),
        (0x40, &[4, 10, 0], DecodeError::ReservedBits, Status::CmdFormatError),
        (0x51, &long_tag, DecodeError::TagTooLong, Status::Overrun),
        (0x51, b"a\tb", DecodeError::Character, Status::InvalidParameter),
        (0x51, &[0xC4], DecodeError::Character, Status::InvalidParameter),
        (0x60, &[0], DecodeError::TooLong, Status::CmdFormatError),
    ];
    for &(id, payload, refusal, status) in cases {
        assert_eq!(Command::decode(&Frame { id, payload }), Err(refusal), "{id:02X}h {payload:?}");
        assert_eq!(CommandId::from_code(id).status_of(refusal), status, "{id:02X}h {refusal}");
    }
}

#[test]
fn trailing_nul_of_a_tag_is_stripped() {
    let decoded = Command::decode(&Frame { id: 0x51, payload: b"cell 4\0\0" });
    assert_eq!(decoded, Ok(Command::SetDeviceTag { tag: DeviceTag::new("cell 4").unwrap() }));
}

#[test]
fn number_that_is_not_finite_is_caught_before_it_is_sent() {
    assert_eq!(Command::SetForceLimit { force: f32::INFINITY }.check(), Err(DecodeError::NotFinite));
    let limits = SoftLimits { minus: 0.0, plus: f32::NAN };
    assert_eq!(Command::SetSoftLimits { limits }.check(), Err(DecodeError::NotFinite));
}

#[test]
fn the_table_holds_the_commands_of_the_manual() {
    let ids: Vec<u8> = CommandId::ALL.iter().map(|id| id.code()).collect();
    let expected: Vec<u8> =
        [0x06..=0x07, 0x20..=0x26, 0x30..=0x38, 0x40..=0x46, 0x50..=0x53, 0x60..=0x63, 0x70..=0x73]
            .into_iter()
            .flatten()
            .collect();
    assert_eq!(ids, expected);
    for id in CommandId::ALL {
        assert_eq!(CommandId::from_code(id.code()), *id);
        let motion = id.kind() == Kind::Motion;
        assert!(
            !(motion && id.immediate_statuses().contains(&Status::Success)),
            "{id}: a motion must have two replies"
        );
        assert_eq!(
            id.immediate_statuses().contains(&Status::CmdPending) && *id != CommandId::Loop,
            !id.completion_statuses().is_empty(),
            "{id}: E_CMD_PENDING, and nothing else, must imply a second reply",
        );
    }
}

#[test]
fn commands_read_as_a_person_would_write_them() {
    for (command, text) in [
        (Command::GripPart { width: 20.0, speed: 50.0 }, "25h Grip Part 20.0 mm 50.0 mm/s"),
        (Command::Stop, "22h Stop"),
        (Command::Homing { direction: HomingDirection::Positive }, "20h Homing positive direction"),
        (Command::ACKNOWLEDGE, "24h Acknowledge FAST STOP \"ack\""),
        (
            Command::GetSystemState { update: AutoUpdate::on_change(10) },
            "40h Get System State on change, 10 ms apart",
        ),
        (Command::GetForce { update: AutoUpdate::every(20) }, "45h Get Force every 20 ms"),
        (Command::GetSpeed { update: AutoUpdate::once() }, "44h Get Speed once"),
        (Command::OverdriveMode { enabled: true }, "37h Overdrive Mode on"),
        (Command::SetDeviceTag { tag: DeviceTag::new("cell 4").unwrap() }, "51h Set Device Tag \"cell 4\""),
        (Command::Unknown { id: 0x9F, payload: &[] }, "9Fh unknown command 0 bytes"),
        (Command::Unknown { id: 0xA0, payload: &[1, 2] }, "A0h script command 2 bytes"),
        (Command::Unknown { id: 0xBF, payload: &[1, 2] }, "BFh script command 2 bytes"),
        (Command::Unknown { id: 0xC0, payload: &[1, 2] }, "C0h unknown command 2 bytes"),
    ] {
        assert_eq!(command.to_string(), text);
    }
}

#[test]
fn longest_fixed_request_is_as_long_as_stated() {
    let longest = CommandId::ALL
        .iter()
        .filter_map(|id| {
            (0..=64)
                .rev()
                .find(|&n| Command::decode(&Frame { id: id.code(), payload: &[0; 64][..n] }).is_ok())
        })
        .filter(|&n| n < 60)
        .max();
    assert_eq!(longest, Some(Command::MAX_FIXED_LEN));
}

#[test]
fn status_of_either_answer_may_come_and_no_other() {
    let id = CommandId::Homing;
    assert!(id.immediate_statuses().contains(&Status::CmdPending));
    assert!(!id.immediate_statuses().contains(&Status::AxisBlocked));
    assert!(id.may_answer(Status::CmdPending), "first");
    assert!(id.may_answer(Status::AxisBlocked), "second");
    assert!(!id.may_answer(Status::ChecksumError));
}

#[test]
fn each_refusal_says_something_else() {
    use DecodeError::{
        AckKey, Character, NotFinite, ReservedBits, TagTooLong, TooLong, TooShort, UndefinedValue,
    };
    let all = [TooShort, TooLong, UndefinedValue, ReservedBits, NotFinite, AckKey, TagTooLong, Character];
    let mut texts: Vec<String> = all.iter().map(ToString::to_string).collect();
    texts.sort();
    texts.dedup();
    assert_eq!(texts.len(), all.len());
    assert!(!texts.contains(&String::new()));
}

#[test]
fn every_status_but_pending_is_the_last_word() {
    for status in Status::ALL {
        assert_eq!(status.is_final(), *status != Status::CmdPending, "{status}");
    }
}
