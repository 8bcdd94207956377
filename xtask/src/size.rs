//! Size gates: flash and RAM of the images and the protocol, compared with their limits.

use std::{fs, path::Path, process::Command};

use anyhow::{Context, Result};
use boards::BOARDS;
use footprint::{Footprint, Section};

use crate::{
    firmware::{self, Image},
    gate::Gate,
    process,
    setup::{TRIPLE, ThumbToolchain},
};

const STATIC_RAM_LIMIT: u64 = 12 * 1024;

/// Flash limits of parser and encoder in bytes, with the 512-byte table and with the 32-byte table.
const FRAME_LIMIT: u64 = 1_900;
const SMALL_FRAME_LIMIT: u64 = 1_100;

/// Flash limit of the protocol crate without GCL, MODBUS server and drivers, so that growth is noticed. It includes 1 100 B of units
/// and descriptions, which a board that shows no text does not link.
const PROTOCOL_LIMIT: u64 = 35_900;

/// Flash limits of GCL and the MODBUS server. 1 400 B of GCL are verbose-mode texts.
const GCL_LIMIT: u64 = 44 * 1024;
const MODBUS_LIMIT: u64 = 9_600;

/// Payload length of the probe's parser, and the RAM limit beyond it, in bytes.
const PARSER_PAYLOAD: u64 = 64;
const PARSER_OVERHEAD_LIMIT: u64 = 16;

/// Flash limits of the C library by target and C compiler options, and the RAM limit per gripper, in bytes. A core without
/// floating-point unit takes more.
const C_LIBRARY: [(&str, &[&str], u64); 2] = [
    (TRIPLE, &["-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"], 17 * 1024),
    ("thumbv6m-none-eabi", &["-mcpu=cortex-m0plus"], 20 * 1024),
];
const C_RAM_LIMIT: u64 = 640;

/// Flash limit of the boot loaders: their part of the flash.
const BOOT_LOADER_LIMIT: u64 = wsg_update::BOOT_LEN as u64;

/// Returns all gates.
pub(crate) fn of_all(toolchain: &ThumbToolchain<'_>, images: &[Image]) -> Result<Vec<Gate>> {
    Ok([of_images(images)?, of_updates(toolchain)?, of_protocol(toolchain)?, of_c_library(toolchain)?]
        .concat())
}

/// Returns the gates of the boards' images.
pub(crate) fn of_images(images: &[Image]) -> Result<Vec<Gate>> {
    let mut gates = Vec::new();
    for Image { board, path, .. } in images {
        let sections = sections_of(path)?;
        for section in sections.iter().filter(|section| section.size > 0) {
            println!("  {:<16} {:>7} B  {}", section.name, section.size, section.place());
        }
        let Footprint { flash, static_ram } = Footprint::of(&sections);
        gates.push(Gate::bytes(board.figure("firmware image, flash"), flash, board.flash_limit));
        gates.push(Gate::bytes(board.figure("firmware image, static RAM"), static_ram, STATIC_RAM_LIMIT));
    }
    Ok(gates)
}

/// Returns the gates of the programs for updates in the field: boot loaders, and images for slot A.
pub(crate) fn of_updates(toolchain: &ThumbToolchain<'_>) -> Result<Vec<Gate>> {
    let mut gates = Vec::new();
    for board in &BOARDS {
        for (what, image, limit) in [
            ("boot loader, flash", firmware::boot_loader(toolchain, board)?, BOOT_LOADER_LIMIT),
            ("image for slot A, flash", firmware::build_for_slot(toolchain, board)?, board.slot_flash_limit),
        ] {
            let Footprint { flash, .. } = Footprint::of(&sections_of(&image.path)?);
            gates.push(Gate::bytes(board.figure(what), flash, limit));
        }
    }
    Ok(gates)
}

/// Reads the sections of a program.
pub(crate) fn sections_of(path: &Path) -> Result<Vec<Section>> {
    let what_failed = || format!("cannot read the sections of {}", path.display());
    footprint::sections_of(&fs::read(path).with_context(what_failed)?).with_context(what_failed)
}

/// Returns the gates of the protocol crate, from the sizes of programs minus that of an empty one.
pub(crate) fn of_protocol(toolchain: &ThumbToolchain<'_>) -> Result<Vec<Gate>> {
    let empty = toolchain.footprint("empty", "on-target")?;
    let frame = toolchain.footprint("frame", "on-target")?.over(empty);
    let protocol = toolchain.footprint("functions", "protocol,on-target")?.over(empty);
    let text = toolchain.footprint("text", "text")?.over(empty);
    let gcl = toolchain.footprint("functions", "gcl,on-target")?.over(empty);
    let modbus = toolchain.footprint("functions", "modbus,on-target")?.over(empty);
    let driver = toolchain.footprint("functions", "drivers,on-target")?.over(empty);
    let small_empty = toolchain.footprint("empty", "on-target,small-table")?;
    let small_frame = toolchain.footprint("frame", "on-target,small-table")?.over(small_empty);
    println!("  drivers, every method of both protocols, with dependencies: {} B", driver.flash);
    println!("  human-readable text (Display of commands and replies, core::fmt): {} B", text.flash);
    let gates = [
        ("parser and encoder, flash with table", frame.flash, FRAME_LIMIT),
        ("parser and encoder, flash with `small-table`", small_frame.flash, SMALL_FRAME_LIMIT),
        ("parser for 64 bytes of payload, RAM", frame.static_ram, PARSER_PAYLOAD + PARSER_OVERHEAD_LIMIT),
        ("whole protocol crate (no `gcl`, `modbus`, drivers), flash", protocol.flash, PROTOCOL_LIMIT),
        ("`gcl`, every public function, flash", gcl.flash, GCL_LIMIT),
        ("`modbus`, every public function, flash", modbus.flash, MODBUS_LIMIT),
    ];
    Ok(gates.map(|(what, measured, limit)| Gate::bytes(what, measured, limit)).to_vec())
}

/// Returns the gates of the C library: a C program with the whole session minus the same program without it.
pub(crate) fn of_c_library(toolchain: &ThumbToolchain<'_>) -> Result<Vec<Gate>> {
    let mut gates = Vec::new();
    for (triple, options, limit) in C_LIBRARY {
        let library = firmware::c_library(toolchain, triple)?;
        let program = |definition: &str| {
            let elf = library.with_file_name("c-size.elf");
            let mut gcc = Command::new("arm-none-eabi-gcc");
            gcc.current_dir(toolchain.workspace.root.join("bindings/c"));
            gcc.args("-mthumb -Os -ffreestanding -nostdlib -z noexecstack -Wl,--gc-sections".split(' '));
            gcc.args(options).args([definition, "-I", "include", "size/size.c"]).arg(&library);
            process::run(gcc.args(["-T", "examples/board.ld", "-o"]).arg(&elf))?;
            anyhow::Ok(Footprint::of(&sections_of(&elf)?))
        };
        let library = program("-DWSG_WHOLE")?.over(program("-DWSG_EMPTY")?);
        gates.push(Gate::bytes(format!("C library, whole session, flash, {triple}"), library.flash, limit));
        let ram = format!("C library, RAM per gripper, {triple}");
        gates.push(Gate::bytes(ram, library.static_ram, C_RAM_LIMIT));
    }
    Ok(gates)
}
