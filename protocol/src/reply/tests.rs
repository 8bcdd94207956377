//! Round trip of every reply, and replies that the manual forbids.

use super::*;
use crate::types::{DeviceType, FingerType, FirmwareVersion};
use crate::{Event, FrameEncoder, FrameParser};
use proptest::prelude::*;
use std::string::ToString;
use std::vec::Vec;

fn payload(reply: &Reply<'_>) -> Vec<u8> {
    (0..reply.len()).map(|index| reply.byte(index)).collect()
}

/// Returns the number of bytes after the status code of a successful reply, from the manual; `None` for variable
/// lengths.
fn value_len(id: CommandId) -> Option<usize> {
    Some(match id.code() {
        0x31 | 0x33 | 0x40 | 0x43..=0x45 => 4,
        0x35 | 0x42 | 0x50 => 8,
        0x41 => 1,
        0x46 | 0x61 | 0x71 => 2,
        0x53 => 32,
        0x60 | 0x70 => 3,
        0x06 | 0x52 | 0x63 | 0x73 => return None,
        _ => 0,
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn success_needs_the_exact_length_and_survives_a_round_trip(
        id in proptest::sample::select(CommandId::ALL.to_vec()),
        values in proptest::collection::vec(prop_oneof![Just(0u8), 0x20..0x7Fu8], 0..40),
    ) {
        let bytes = [&[0, 0][..], &values].concat();
        let decoded = Reply::decode(&Frame { id: id.code(), payload: &bytes });
        if let Some(len) = value_len(id)
            && values.len() != len {
                prop_assert!(decoded.is_err());
                return Ok(());
            }
        if let Ok(reply) = decoded {
            let line: Vec<u8> = FrameEncoder::new(id.code(), reply).collect();
            let mut parser = FrameParser::<512>::new();
            let (_, event) = parser.push_slice(&line);
            let Some(Event::Frame(frame)) = event else { return Err(TestCaseError::fail("no frame")) };
            prop_assert_eq!(Reply::decode(&frame), Ok(reply));
        }
    }

    #[test]
    fn errors_carry_no_values(id in proptest::sample::select(CommandId::ALL.to_vec()), code in 1..=u16::MAX, extra in 0..3usize) {
        let mut bytes = code.to_le_bytes().to_vec();
        bytes.extend(std::vec![0; extra]);
        let decoded = Reply::decode(&Frame { id: id.code(), payload: &bytes });
        if extra == 0 {
            let reply = decoded.unwrap();
            prop_assert_eq!((reply.status().code(), reply.value()), (code, None));
            prop_assert_eq!(payload(&reply), bytes);
        } else {
            prop_assert_eq!(decoded, Err(DecodeError::TooLong));
        }
    }
}

#[test]
fn values_stand_in_the_reply_as_the_manual_says() {
    let info = SystemInfo {
        device: DeviceType::Wsg50,
        hardware_revision: 6,
        firmware: FirmwareVersion::new(4, 0, 0, 0),
        serial_number: 0x0102_0304,
    };
    let limits = SystemLimits {
        stroke: 110.0,
        min_speed: 5.0,
        max_speed: 420.0,
        min_acceleration: 100.0,
        max_acceleration: 5000.0,
        min_force: 5.0,
        nominal_force: 80.0,
        overdrive_force: 120.0,
    };
    let limit_bytes: Vec<u8> = [110.0f32, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0]
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    let cases: Vec<(Value<'_>, Vec<u8>)> = std::vec![
        (Value::GetSystemInfo(info), std::vec![1, 6, 0x00, 0x40, 4, 3, 2, 1]),
        (Value::GetSystemLimits(limits), limit_bytes),
        (Value::GetTemperature(Temperature(-10)), std::vec![0xF6, 0xFF]),
        (Value::GetGripperState(GripperState::Holding), std::vec![4]),
        (Value::GetSystemState(SystemFlags::REFERENCED | SystemFlags::FAST_STOP), std::vec![1, 0x10, 0, 0]),
        (Value::GetFinger1Flags(FingerFlags::INIT_FAULT), std::vec![0, 4]),
        (Value::GetFinger2Info(FingerInfo { finger: FingerType::Fmf, data_len: 4 }), std::vec![1, 4, 0]),
        (
            Value::GetGrippingStatistics(GrippingStatistics { total: 258, no_part: 3, part_lost: 1 }),
            std::vec![2, 1, 0, 0, 3, 0, 1, 0],
        ),
    ];
    for (value, bytes) in cases {
        let reply = Reply::success(value);
        assert_eq!(payload(&reply)[2..], bytes, "{reply}");
        let whole = payload(&reply);
        assert_eq!(Reply::decode(&Frame { id: value.id().code(), payload: &whole }), Ok(reply));
    }
}

#[test]
fn undefined_gripper_state_and_non_finite_number_are_refused() {
    assert_eq!(Reply::decode(&Frame { id: 0x41, payload: &[0, 0, 8] }), Err(DecodeError::UndefinedValue));
    assert_eq!(
        Reply::decode(&Frame { id: 0x43, payload: &[0, 0, 0, 0, 0x80, 0x7F] }),
        Err(DecodeError::NotFinite)
    );
}

#[test]
fn reserved_system_flags_are_kept_for_later_firmware() {
    let reply = Reply::decode(&Frame { id: 0x40, payload: &[0, 0, 0, 0, 0, 0x80] }).unwrap();
    assert_eq!(reply.value(), Some(Value::GetSystemState(SystemFlags::from_bits_retain(0x8000_0000))));
    assert_eq!(payload(&reply), [0, 0, 0, 0, 0, 0x80]);
}

#[test]
fn replies_read_as_a_person_would_write_them() {
    for (reply, text) in [
        (Reply::status_only(CommandId::GripPart, Status::CmdPending), "25h Grip Part E_CMD_PENDING"),
        (Reply::success(Value::GetOpeningWidth(20.0)), "43h Get Opening Width E_SUCCESS 20.0 mm"),
        (
            Reply::success(Value::GetGripperState(GripperState::NoPart)),
            "41h Get Gripper State E_SUCCESS NO PART",
        ),
        (
            Reply::success(Value::GetSystemState(SystemFlags::REFERENCED | SystemFlags::MOVING)),
            "40h Get System State E_SUCCESS REFERENCED | MOVING",
        ),
        (
            Reply::success(Value::GetSystemInfo(SystemInfo {
                device: DeviceType::Wsg50,
                hardware_revision: 2,
                firmware: FirmwareVersion::new(4, 1, 2, 0),
                serial_number: 7,
            })),
            "50h Get System Information E_SUCCESS WSG 50, revision 2, firmware 4.1.2, serial number 7",
        ),
        (
            Reply::success(Value::GetGrippingStatistics(GrippingStatistics {
                total: 9,
                no_part: 2,
                part_lost: 1,
            })),
            "42h Get Gripping Statistics E_SUCCESS 9 grips, 2 without part, 1 lost",
        ),
        (Reply::success(Value::GetTemperature(Temperature(-5))), "46h Get Temperature E_SUCCESS -0.5 °C"),
        (
            Reply::success(Value::GetFinger1Info(FingerInfo { finger: FingerType::Fmf, data_len: 4 })),
            "60h Get Finger 1 Info E_SUCCESS WSG-FMF, 4 bytes of data",
        ),
        (
            Reply::status_only(CommandId::Unknown(0x90), Status::CmdUnknown),
            "90h unknown command E_CMD_UNKNOWN",
        ),
    ] {
        assert_eq!(reply.to_string(), text);
    }
}

#[test]
fn version_is_reported_in_its_parts() {
    let version = FirmwareVersion::new(1, 2, 3, 4);
    assert_eq!(version.bits(), 0x1234);
    assert_eq!(version.parts(), (1, 2, 3, 4));
    assert_eq!(version.to_string(), "1.2.3-rc4");
    assert_eq!(FirmwareVersion::from_bits(0xFEDC).parts(), (15, 14, 13, 12));
    assert_eq!(FirmwareVersion::new(4, 0, 0, 0).to_string(), "4.0.0");
}
