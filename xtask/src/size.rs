//! Size gates: what image and protocol take of flash and RAM, against the limits of DESIGN.md section 7.

use std::fs;

use anyhow::{Context, Result};
use footprint::Footprint;

use crate::{firmware::Image, gate::Gate, probe::Probes};

const STATIC_RAM_LIMIT: u64 = 12 * 1024;

/// Parser and encoder, with the table of 512 bytes and with that of 32.
const FRAME_LIMIT: u64 = 1_900;
const SMALL_FRAME_LIMIT: u64 = 1_100;

/// The whole protocol crate without its text protocol, MODBUS server and drivers, so that it does not grow unseen. 1 100 B of it
/// are units and meanings in texts, which a board that shows none does not link.
const PROTOCOL_LIMIT: u64 = 34_500;

/// The two that are not in that, for the same reason. 1 400 B of GCL are the texts of verbose mode.
const GCL_LIMIT: u64 = 44 * 1024;
const MODBUS_LIMIT: u64 = 9 * 1024;

/// The payload of the probe's parser, and what the parser may take beside it.
const PARSER_PAYLOAD: u64 = 64;
const PARSER_OVERHEAD_LIMIT: u64 = 16;

/// The gates of the boards' images.
pub(crate) fn of_images(images: &[Image]) -> Result<Vec<Gate>> {
    images.iter().map(of_image).collect::<Result<Vec<_>>>().map(|gates| gates.concat())
}

fn of_image(image: &Image) -> Result<Vec<Gate>> {
    let what_failed = || format!("cannot read the sections of {}", image.path.display());
    let bytes = fs::read(&image.path).with_context(what_failed)?;
    let sections = footprint::sections_of(&bytes).with_context(what_failed)?;
    for section in sections.iter().filter(|section| section.size > 0) {
        println!("  {:<16} {:>7} B  {}", section.name, section.size, section.place());
    }
    let Footprint { flash, static_ram } = Footprint::of(&sections);
    Ok(vec![
        Gate::bytes(image.board.figure("firmware image, flash"), flash, image.board.flash_limit),
        Gate::bytes(image.board.figure("firmware image, static RAM"), static_ram, STATIC_RAM_LIMIT),
    ])
}

/// The gates of the protocol crate: programs beside an empty one.
pub(crate) fn of_protocol(probes: &Probes<'_>) -> Result<Vec<Gate>> {
    let empty = probes.footprint("empty", "on-target")?;
    let frame = probes.footprint("frame", "on-target")?.over(empty);
    let protocol = probes.footprint("functions", "protocol,on-target")?.over(empty);
    let text = probes.footprint("text", "text")?.over(empty);
    let gcl = probes.footprint("functions", "gcl,on-target")?.over(empty);
    let modbus = probes.footprint("functions", "modbus,on-target")?.over(empty);
    let driver = probes.footprint("functions", "drivers,on-target")?.over(empty);
    let small_empty = probes.footprint("empty", "on-target,small-table")?;
    let small_frame = probes.footprint("frame", "on-target,small-table")?.over(small_empty);
    println!("  the drivers, every method of both protocols, with all they need: {} B", driver.flash);
    println!("  text for persons (Display of commands and replies, core::fmt): {} B", text.flash);
    Ok(vec![
        Gate::bytes("parser and encoder, flash with table", frame.flash, FRAME_LIMIT),
        Gate::bytes("parser and encoder, flash with `small-table`", small_frame.flash, SMALL_FRAME_LIMIT),
        Gate::bytes(
            "parser for 64 bytes of payload, RAM",
            frame.static_ram,
            PARSER_PAYLOAD + PARSER_OVERHEAD_LIMIT,
        ),
        Gate::bytes(
            "whole protocol crate (no `gcl`, `modbus`, drivers), flash",
            protocol.flash,
            PROTOCOL_LIMIT,
        ),
        Gate::bytes("`gcl`, every public function, flash", gcl.flash, GCL_LIMIT),
        Gate::bytes("`modbus`, every public function, flash", modbus.flash, MODBUS_LIMIT),
    ])
}
