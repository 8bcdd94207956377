//! Programs of `bindings/c/examples` on the emulated default board, with a virtual gripper on its UART.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use host_tests::emulator::{Emulator, Extras};
use host_tests::gripper_end::GripperEnd;
use host_tests::rig::{MOTION_PATIENCE, PATIENCE, motions};
use host_tests::trace::Trace;
use wsg_bridge_fw::io::Outputs;
use wsg_protocol::{CommandId, SystemFlags};
use wsg_sim::{Config, Part};

/// Compiles an example and other sources, as the first comment of `bare_metal.c` says, with the library that this variable names.
fn compile(name: &str, others: &[PathBuf], includes: &[PathBuf]) -> PathBuf {
    let library = std::env::var_os("WSG_C_LIBRARY")
        .expect("WSG_C_LIBRARY names no static library: run `cargo xtask test`");
    // A reachable panic in any function would call an undefined function; see the library's panic handler.
    let nm = Command::new("arm-none-eabi-nm").arg("--undefined-only").arg(&library).output().unwrap();
    let undefined = String::from_utf8_lossy(&nm.stdout);
    assert!(undefined.contains(" U __aeabi_memcpy") && !undefined.contains("a_panic_can_be_reached"));
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../bindings/c/examples");
    let elf = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name).with_extension("elf");
    let mut gcc = Command::new("arm-none-eabi-gcc");
    gcc.args("-std=gnu99 -Wall -Wextra -Werror -Os -ffreestanding -nostdlib -z noexecstack".split(' '));
    gcc.args("-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -Wl,--gc-sections".split(' '));
    gcc.args(includes.iter().flat_map(|folder| [Path::new("-isystem"), folder]));
    gcc.arg("-I").arg(examples.join("../include")).arg("-I").arg(&examples);
    gcc.arg(examples.join(name)).arg(examples.join("board.c")).args(others).arg(library);
    gcc.arg("-T").arg(examples.join("board.ld")).arg("-o").arg(&elf);
    assert!(gcc.status().unwrap().success(), "{gcc:?}");
    elf
}

/// Runs a program that homes, grips, loses the part, releases, and ends with a FAST STOP.
fn grips_loses_the_part_releases_and_stops(elf: &Path) {
    // The pins are the wires between bridge and PLC. READY shows the end of the program.
    let mut board = Emulator::start_with(elf, Extras::default()).unwrap();
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

#[test]
#[ignore = "needs QEMU, arm-none-eabi-gcc and the library: run `cargo xtask test`"]
fn bare_metal_program_of_arm_none_eabi_gcc_grips() {
    grips_loses_the_part_releases_and_stops(&compile("bare_metal.c", &[], &[]));
}

/// Returns the folder of the FreeRTOS kernel, which is in the sources of a crate.
fn kernel() -> PathBuf {
    let mut cargo = Command::new(env!("CARGO"));
    let metadata = cargo.args(["metadata", "--locked", "--format-version", "1"]).output().unwrap().stdout;
    let metadata = String::from_utf8(metadata).unwrap();
    let is_manifest = |text: &&str| text.contains("/freertos-next-") && text.ends_with("/Cargo.toml");
    let manifest = metadata.split('"').find(is_manifest).expect("freertos-next is a dependency");
    Path::new(manifest).with_file_name("FreeRTOS-Kernel")
}

#[test]
#[ignore = "needs QEMU, arm-none-eabi-gcc and the library: run `cargo xtask test`"]
fn freertos_program_of_arm_none_eabi_gcc_grips() {
    let kernel = kernel();
    let port = kernel.join("portable/GCC/ARM_CM4F");
    let sources = ["tasks.c", "queue.c", "list.c", "stream_buffer.c"].map(|name| kernel.join(name));
    let sources = [&sources[..], &[port.join("port.c")]].concat();
    // The part of the C library that the kernel needs, which Debian has in another package.
    let library = Path::new(env!("CARGO_TARGET_TMPDIR")).join("freertos-libc");
    fs::create_dir_all(&library).unwrap();
    let functions = "#include <stddef.h>\nvoid *memcpy(void *, const void *, size_t);\nvoid *memset(void *, int, size_t);\n";
    fs::write(library.join("string.h"), functions).unwrap();
    fs::write(library.join("stdlib.h"), "").unwrap();
    let elf = compile("freertos.c", &sources, &[library, kernel.join("include"), port]);
    grips_loses_the_part_releases_and_stops(&elf);
}
