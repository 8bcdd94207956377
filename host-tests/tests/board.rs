//! The board in isolation: wiring, start-up, and no motion without a command.
#![cfg(unix)]

use std::io::Write;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use host_tests::emulator::{Emulator, Extras};
use wsg_b_l475e_iot01a::INPUTS;
use wsg_bridge_fw::io::{Inputs, Outputs};

/// Several hundred turns of the firmware's main loop, in milliseconds of board time.
const A_WHILE_MS: u32 = 500;

/// Time to wait for bytes on the line before the board's clock is read again.
const LOOK_AROUND: Duration = Duration::from_millis(10);

/// Commands that move the fingers: Homing, Pre-position, Grip Part and Release Part.
const MOTION_COMMANDS: [u8; 4] = [0x20, 0x21, 0x25, 0x26];
const PREAMBLE: [u8; 3] = [0xAA; 3];

/// Base address of GPIO port A, spacing of the ports, and offset of the input data register (RM0351, 2.2.2 and 8.4.5).
const GPIOA: u32 = 0x4800_0000;
const PORT_SPACING: u32 = 0x400;
const IDR: u32 = 0x10;

fn image() -> PathBuf {
    std::env::var_os("WSG_FIRMWARE_ELF")
        .expect("WSG_FIRMWARE_ELF must hold the path of the firmware image")
        .into()
}

fn board() -> Emulator {
    Emulator::start(&image()).unwrap()
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn outputs_promise_nothing_while_no_gripper_answers() {
    let board = board();
    let start = board.now_ms().unwrap();
    while board.now_ms().unwrap().wrapping_sub(start) <= A_WHILE_MS {}

    for change in board.output_changes().try_iter() {
        let promised = change.outputs & !(Outputs::ERROR | Outputs::PART_FAULT);
        assert_eq!(promised, Outputs::empty());
    }
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn each_input_wire_reaches_its_pin_and_is_low_when_broken() {
    let board = board();
    let levels = || -> Inputs {
        let is_high = |port: char, pin: u8| {
            let register = GPIOA + (port as u32 - 'A' as u32) * PORT_SPACING + IDR;
            board.readl(register).unwrap() & (1 << pin) != 0
        };
        INPUTS.iter().filter(|wire| is_high(wire.port.letter(), wire.pin)).map(|wire| wire.signal).collect()
    };

    assert_eq!(levels(), Inputs::empty());
    for wire in Inputs::all().iter() {
        board.set_inputs(wire).unwrap();
        assert_eq!(levels(), wire);
    }
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn no_motion_command_is_sent_without_a_request() {
    let mut board = board();
    let gripper_line = board.take_gripper_line().unwrap();
    // Request neither a FAST STOP nor a motion.
    board.set_inputs(Inputs::FAST_STOP_OK).unwrap();

    let sent = received_within(&board, &gripper_line, A_WHILE_MS);

    let moves = |frame: &[u8]| frame.starts_with(&PREAMBLE) && MOTION_COMMANDS.contains(&frame[3]);
    assert!(!sent.windows(4).any(moves), "{sent:02X?}");
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn board_survives_noise_on_the_gripper_line() {
    let mut board = board();
    let mut gripper_line = board.take_gripper_line().unwrap();
    // The byte values of a simple generator, preambles among them.
    let noise: Vec<u8> =
        (0..4096_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8 | (n as u8 & 0xAA)).collect();

    gripper_line.write_all(&noise).unwrap();
    let _ = received_within(&board, &gripper_line, A_WHILE_MS);

    board.set_inputs(Inputs::FAST_STOP_OK).unwrap();
    assert!(!board.outputs().intersects(Outputs::LINK_OK | Outputs::READY | Outputs::BUSY));
}

/// Environment variable that enables [`harness_that_waits_to_be_killed`].
const HARNESS_VARIABLE: &str = "WSG_HARNESS_THAT_WAITS";

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn harness_that_is_killed_leaves_no_emulator() {
    let (ours, output) = UnixStream::pair().unwrap();
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["--exact", "harness_that_waits_to_be_killed", "--include-ignored", "--nocapture"])
        .env(HARNESS_VARIABLE, "1")
        .stdout(OwnedFd::from(output));
    let mut harness = command.spawn().unwrap();
    // The command holds a copy of the output.
    drop(command);
    let mut said = String::new();
    while !said.contains("it runs") {
        said += &next_said(&ours).expect("the harness starts");
    }

    harness.kill().unwrap();
    harness.wait().unwrap();

    // The output ends after all its holders have ended: the harness and its QEMU.
    while next_said(&ours).is_some() {}
}

/// Returns the next output of a harness within 60 s, or `None` at its end.
fn next_said(output: &UnixStream) -> Option<String> {
    let mut chunk = [0; 256];
    let count = uninterrupted::read_within(output, &mut chunk, Duration::from_secs(60)).unwrap();
    let count = count.expect("no output and no end within 60 s");
    (count > 0).then(|| String::from_utf8_lossy(&chunk[..count]).into_owned())
}

#[test]
#[ignore = "another test runs it in its own process"]
fn harness_that_waits_to_be_killed() {
    if std::env::var_os(HARNESS_VARIABLE).is_none() {
        return;
    }
    // QEMU holds the output too, so the output does not end before QEMU.
    let output = std::io::stdout().as_fd().try_clone_to_owned().unwrap();
    let extras = Extras { semihosting: Some(output.into()), ..Extras::default() };
    let _board = Emulator::start_with(&image(), extras).unwrap();
    println!("it runs");
    loop {
        std::thread::park();
    }
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn missing_image_is_refused_in_one_line() {
    let refusal = format!("{:#}", Emulator::start("Cargo.toml.missing".as_ref()).unwrap_err());
    assert!(refusal.contains("Cargo.toml.missing") && !refusal.contains('\n'), "{refusal}");
}

/// Returns the bytes sent on `line` within `ms` milliseconds of board time.
fn received_within(board: &Emulator, line: &UnixStream, ms: u32) -> Vec<u8> {
    let mut received = Vec::new();
    let mut chunk = [0; 256];
    let start = board.now_ms().unwrap();
    loop {
        let is_over = board.now_ms().unwrap().wrapping_sub(start) > ms;
        match uninterrupted::read_within(line, &mut chunk, LOOK_AROUND).unwrap() {
            Some(0) => panic!("the board closed the line"),
            Some(count) => received.extend_from_slice(&chunk[..count]),
            None if is_over => return received,
            None => {}
        }
    }
}
