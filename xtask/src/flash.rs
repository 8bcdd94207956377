//! Flashing a real board over its debug probe.

use std::process::Command;

use anyhow::{Result, bail};

use crate::{firmware::Image, process};

const PROBE_RS: &str = "probe-rs";

/// Fails with installation instructions if probe-rs is missing. Called before the build, which takes longer.
pub(crate) fn require_probe_rs() -> Result<()> {
    if process::answer(Command::new(PROBE_RS).arg("--version")).is_none() {
        bail!("probe-rs not found; install it with: cargo install probe-rs-tools --locked");
    }
    Ok(())
}

/// Writes the image to the board's flash and starts it.
pub(crate) fn run(image: &Image) -> Result<()> {
    process::run(Command::new(PROBE_RS).args(["download", "--chip", image.board.chip]).arg(&image.path))?;
    process::run(Command::new(PROBE_RS).args(["reset", "--chip", image.board.chip]))
}
