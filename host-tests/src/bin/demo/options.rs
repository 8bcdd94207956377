//! Command-line options.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Parser;
use wsg_sim::Part;

/// Runs the firmware against a simulated PLC and a virtual gripper, and prints a trace.
#[derive(Parser)]
#[command(bin_name = "cargo xtask demo")]
pub(crate) struct Options {
    /// Part between the fingers for the first grip
    #[arg(long, value_name = "none|WIDTH_MM", value_parser = parse_part, default_value = "20")]
    pub(crate) part: MaybePart,
    /// Speed factor of the fingers, 0.1 to 20 (default 1, or 4 with --record)
    #[arg(long, value_name = "X", value_parser = parse_speed_up)]
    pub(crate) speed_up: Option<f32>,
    /// Also write the trace to FILE
    #[arg(long, value_name = "FILE")]
    pub(crate) trace: Option<PathBuf>,
    /// Also write an animated picture of the trace, unless a step fails (docs/demo.svg)
    #[arg(long, value_name = "FILE.svg", conflicts_with = "trace")]
    pub(crate) record: Option<PathBuf>,
    /// Firmware image (`cargo xtask demo` builds it and passes it); without it, the bridge's library runs on this computer
    #[arg(long, value_name = "FILE")]
    pub(crate) elf: Option<PathBuf>,
}

/// A part, or none. clap would take `Option` for an option without a default.
pub(crate) type MaybePart = Option<Part>;

/// Above 20 the fingers arrive before a PLC could stop them.
const SPEED_UPS: RangeInclusive<f32> = 0.1..=20.0;

fn parse_part(text: &str) -> Result<MaybePart> {
    match text.parse().ok().and_then(Part::of_width) {
        _ if text == "none" => Ok(None),
        Some(part) => Ok(Some(part)),
        None => bail!("expected \"none\" or a width in mm greater than 0, such as 20"),
    }
}

fn parse_speed_up(text: &str) -> Result<f32> {
    match text.parse() {
        Ok(factor) if SPEED_UPS.contains(&factor) => Ok(factor),
        _ => bail!("expected a factor from {} to {}", SPEED_UPS.start(), SPEED_UPS.end()),
    }
}
