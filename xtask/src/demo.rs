//! The demonstration of the image in the emulator, and the delivery folder for PLC engineers.

use std::{ffi::OsString, process::ExitStatus};

use anyhow::Result;

use crate::{firmware::Image, process, setup, workspace::Workspace};

/// Runs the demonstration of an image with its own `arguments`, and returns its exit status.
pub(crate) fn run(workspace: &Workspace, image: &Image, arguments: &[OsString]) -> Result<ExitStatus> {
    let mut cargo = workspace.cargo_in_current_dir("run");
    cargo.args(["-q", "-p", "host-tests", "--bin", "demo", "--", "--elf"]).arg(&image.path).args(arguments);
    setup::tell_emulator(workspace, image.board, &mut cargo)?;
    process::run_for_status(&mut cargo)
}

/// Builds the delivery folder with `image`.
pub(crate) fn dist(workspace: &Workspace, image: &Image) -> Result<()> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["-q", "-p", "dist", "--", "--elf"]).arg(&image.path);
    process::run(cargo.arg("--to").arg(workspace.target_dir.join("dist")))
}
