//! Command-line options.

use std::ffi::OsString;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use lexopt::prelude::*;
use wsg_sim::Part;

/// Text of `--help`.
pub(crate) const HELP: &str = "\
Runs the released image against a simulated PLC and a virtual gripper, and prints a trace.

  --part none|WIDTH_MM   part between the fingers for the first grip (default 20)
  --speed-up X           speed factor of the fingers, 0.1 to 20 (default 1)
  --trace FILE           also write the trace to FILE
  --elf FILE             firmware image (`cargo xtask demo` builds it and passes it)";

pub(crate) struct Options {
    pub(crate) elf: PathBuf,
    /// Part between the fingers for the first grip.
    pub(crate) part: Option<Part>,
    /// Speed factor of the fingers.
    pub(crate) speed_up: f32,
    /// Additional destination of the trace.
    pub(crate) trace: Option<PathBuf>,
}

/// Above 20 the fingers arrive before a PLC could stop them.
const SPEED_UPS: std::ops::RangeInclusive<f32> = 0.1..=20.0;

impl Options {
    /// Returns the options of this process; `None` for `--help`.
    pub(crate) fn from_arguments() -> Result<Option<Self>> {
        let (mut elf, mut part, mut speed_up, mut trace) = (None, Part::of_width(20.0), 1.0, None);
        let mut parser = lexopt::Parser::from_env();
        while let Some(argument) = parser.next()? {
            match argument {
                Long("part") => part = parse_part(parser.value()?)?,
                Long("speed-up") => speed_up = parse_speed_up(parser.value()?)?,
                Long("trace") => trace = Some(parser.value()?.into()),
                Long("elf") => elf = Some(parser.value()?.into()),
                Long("help") | Short('h') => return Ok(None),
                other => return Err(other.unexpected().into()),
            }
        }
        let elf = elf.context("--elf FILE is missing; `cargo xtask demo` builds the image and passes it")?;
        Ok(Some(Self { elf, part, speed_up, trace }))
    }
}

fn parse_part(value: OsString) -> Result<Option<Part>> {
    let text = value.to_string_lossy();
    if text == "none" {
        return Ok(None);
    }
    let part = text.parse().ok().and_then(Part::of_width);
    match part {
        Some(part) => Ok(Some(part)),
        None => bail!("--part is \"{text}\"; expected \"none\" or a width in mm greater than 0, such as 20"),
    }
}

fn parse_speed_up(value: OsString) -> Result<f32> {
    let text = value.to_string_lossy();
    match text.parse() {
        Ok(factor) if SPEED_UPS.contains(&factor) => Ok(factor),
        _ => bail!(
            "--speed-up is \"{text}\"; expected a factor from {} to {}",
            SPEED_UPS.start(),
            SPEED_UPS.end()
        ),
    }
}
