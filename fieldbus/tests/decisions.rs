//! The crate's decisions where the manuals err, contradict each other or are ambiguous.
//!
//! `docs/decisions.md` lists every decision with its test.

use wsg_fieldbus::{CommandFlags, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::{GripperState, Status, SystemFlags};

/// Returns an input image of zeros except for `change`.
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

/// Returns the numbers of the set coils or discrete inputs: number n is bit n mod 8 of byte n div 8.
fn numbers(bytes: &[u8]) -> Vec<usize> {
    (0..8 * bytes.len()).filter(|n| bytes[n / 8] & (1 << (n % 8)) != 0).collect()
}

#[test]
fn release_is_bit_2_of_the_command_flags_and_homing_bit_3() {
    assert_eq!(CommandFlags::RELEASE.bits(), 1 << 2);
    assert_eq!(CommandFlags::HOMING.bits(), 1 << 3);
}

#[test]
fn force_register_counts_0_01_n_or_0_1_n_on_a_wsg_70() {
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
fn numbers_are_big_endian_and_sysstate_is_a_bit_vector() {
    let image = OutputImage { width: -0x0102, speed: 0x0304, force_limit: 0x0506, ..OutputImage::ZERO };
    assert_eq!(image.to_bytes()[2..], [0xFE, 0xFE, 0x03, 0x04, 0x05, 0x06]);

    let image =
        input(|image| (image.width, image.force, image.status) = (0x0102, 0x0304, Status::CmdPending));
    assert_eq!(image[6..], [0x01, 0x02, 0x03, 0x04, 0x00, 26]);
    let system = input(|image| image.system = SystemFlags::from_bits_retain(0x0D0C_0B0A));
    assert_eq!(system[2..6], [0x0A, 0x0B, 0x0C, 0x0D], "byte 2 holds bits 0 to 7");
}

#[test]
fn referenced_is_01000000h_in_sysstate_read_as_big_endian() {
    let image = input(|image| image.system = SystemFlags::REFERENCED);
    assert_eq!(u32::from_be_bytes([image[2], image[3], image[4], image[5]]), 0x0100_0000);
}

#[test]
fn state_shows_as_exactly_one_bit() {
    let shown = GripperState::ALL.iter().map(|&state| GripperFlags::from(state).bits());
    assert!(shown.eq((0..8).map(|bit| 1 << bit)));
}
