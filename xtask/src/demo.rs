//! The demonstration of the image in the emulator, and the delivery folder for PLC engineers.

use std::{ffi::OsString, fs, path::Path, process::ExitStatus};

use anyhow::{Context, Result};

use crate::{firmware::Image, process, recording, setup, workspace::Workspace};

/// Runs the demonstration of an image with its own `arguments`, and returns its exit status.
pub(crate) fn run(workspace: &Workspace, image: &Image, arguments: &[OsString]) -> Result<ExitStatus> {
    let mut cargo = workspace.cargo_in_current_dir("run");
    cargo.args(["-q", "-p", "host-tests", "--bin", "demo", "--", "--elf"]).arg(&image.path).args(arguments);
    setup::tell_emulator(workspace, image.board, &mut cargo)?;
    process::run_for_status(&mut cargo)
}

/// Runs the demonstration four times as fast, and writes an animated picture of its trace unless it fails.
pub(crate) fn record(workspace: &Workspace, image: &Image, picture: &Path) -> Result<ExitStatus> {
    let trace = workspace.target_dir.join("demo.trace");
    let arguments = ["--speed-up".into(), "4".into(), "--trace".into(), trace.clone().into_os_string()];
    let status = run(workspace, image, &arguments)?;
    if status.success() {
        let trace = fs::read_to_string(&trace).with_context(|| format!("cannot read {}", trace.display()))?;
        let write = fs::write(picture, recording::picture(&trace));
        write.with_context(|| format!("cannot write {}", picture.display()))?;
    }
    Ok(status)
}

/// Builds the delivery folder with `image`.
pub(crate) fn dist(workspace: &Workspace, image: &Image) -> Result<()> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["-q", "-p", "dist", "--", "--elf"]).arg(&image.path);
    process::run(cargo.arg("--to").arg(workspace.target_dir.join("dist")))
}
