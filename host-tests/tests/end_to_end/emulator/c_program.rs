//! `bindings/c/examples/bare_metal.c` on the emulated default board, with a virtual gripper on its UART.

use std::path::{Path, PathBuf};
use std::process::Command;

use host_tests::emulator::{Emulator, Extras};
use host_tests::gripper_end::GripperEnd;
use host_tests::rig::{MOTION_PATIENCE, PATIENCE, motions};
use host_tests::trace::Trace;
use wsg_bridge_fw::io::Outputs;
use wsg_protocol::{CommandId, SystemFlags};
use wsg_sim::{Config, Part};

/// Compiles the example as its first comment says, with the library that this variable names.
fn compile() -> PathBuf {
    let library = std::env::var_os("WSG_C_LIBRARY")
        .expect("WSG_C_LIBRARY names no static library: run `cargo xtask test`");
    // A reachable panic in any function would call an undefined function; see the library's panic handler.
    let nm = Command::new("arm-none-eabi-nm").arg("--undefined-only").arg(&library).output().unwrap();
    let undefined = String::from_utf8_lossy(&nm.stdout);
    assert!(undefined.contains(" U __aeabi_memcpy") && !undefined.contains("a_panic_can_be_reached"));
    let c = Path::new(env!("CARGO_MANIFEST_DIR")).join("../bindings/c");
    let elf = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bare_metal.elf");
    let mut gcc = Command::new("arm-none-eabi-gcc");
    gcc.args([
        "-std=gnu99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-Os",
        "-ffreestanding",
        "-nostdlib",
        "-z",
        "noexecstack",
    ]);
    gcc.args(["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-Wl,--gc-sections"]);
    gcc.arg("-I").arg(c.join("include")).arg(c.join("examples/bare_metal.c")).arg(library);
    gcc.arg("-T").arg(c.join("examples/bare_metal.ld")).arg("-o").arg(&elf);
    assert!(gcc.status().unwrap().success(), "{gcc:?}");
    elf
}

#[test]
#[ignore = "needs QEMU, arm-none-eabi-gcc and the library: run `cargo xtask test`"]
fn arm_none_eabi_gcc_program_grips_loses_the_part_releases_and_stops() {
    // The pins are the wires between bridge and PLC. READY shows the end of the program.
    let mut board = Emulator::start_with(&compile(), Extras::default()).unwrap();
    let trace = Trace::new(vec![]);
    let config = Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() };
    let gripper =
        GripperEnd::start(board.take_gripper_line().unwrap(), board.clock(), config, &trace).unwrap();

    board.wait_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
    board.wait_outputs(MOTION_PATIENCE, |outputs| outputs.contains(Outputs::HOLDING)).unwrap();
    assert_eq!(motions(&trace.since(0)), [CommandId::Homing, CommandId::GripPart]);
    gripper.set_part(None);
    let end = board
        .wait_outputs(MOTION_PATIENCE, |outputs| outputs.contains(Outputs::READY | Outputs::ERROR))
        .unwrap();

    assert!(end.contains(Outputs::LINK_OK | Outputs::REFERENCED), "{end:?}");
    assert_eq!(motions(&trace.since(0)), [CommandId::Homing, CommandId::GripPart, CommandId::ReleasePart]);
    assert!(gripper.state().flags.contains(SystemFlags::FAST_STOP));
}
