//! The board in isolation: wiring, start-up, and no motion without a command.
#![cfg(unix)]

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
    let mut printed = String::new();
    while !printed.contains("it runs") {
        printed += &next_printed(&ours).expect("the harness starts");
    }

    harness.kill().unwrap();
    harness.wait().unwrap();

    // The output ends after all its holders have ended: the harness and its QEMU.
    while next_printed(&ours).is_some() {}
}

/// Returns the next output of a harness within 60 s, or `None` at its end.
fn next_printed(output: &UnixStream) -> Option<String> {
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
