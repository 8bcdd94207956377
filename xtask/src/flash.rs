//! Flashing a real board over its debug probe.

use std::process::Command;

use anyhow::{Result, bail};

use crate::{firmware::Image, process};

/// Fails with installation instructions if probe-rs is missing. Called before the build, which takes longer.
pub(crate) fn require_probe_rs() -> Result<()> {
    if process::answer(probe_rs().arg("--version")).is_none() {
        bail!("probe-rs not found; install it with: cargo install probe-rs-tools --locked");
    }
    Ok(())
}

/// Writes the image to the board's flash and starts it.
pub(crate) fn run(image: &Image) -> Result<()> {
    process::run(probe_rs().args(["download", "--chip", image.board.chip]).arg(&image.path))?;
    process::run(probe_rs().args(["reset", "--chip", image.board.chip]))
}

fn probe_rs() -> Command {
    Command::new("probe-rs")
}
