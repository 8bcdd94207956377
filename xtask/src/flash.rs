//! Flashing a real board over its debug probe.

use std::process::Command;

use anyhow::{Result, bail};

use crate::{firmware::Image, process};

/// Says how to get probe-rs where it is missing; asked before the build, which takes longer.
pub(crate) fn require_probe_rs() -> Result<()> {
    if process::answer(probe_rs().arg("--version")).is_none() {
        bail!("probe-rs is missing; install it with: cargo install probe-rs-tools --locked");
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
