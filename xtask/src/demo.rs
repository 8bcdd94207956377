//! The demonstration: the image in the emulator, between a PLC and a virtual gripper.

use std::{ffi::OsString, process::ExitStatus};

use anyhow::Result;

use crate::{firmware::Image, process, workspace::Workspace};

/// Runs the demonstration on `image` with its own `arguments`, and hands back how it ended.
pub(crate) fn run(workspace: &Workspace, image: &Image, arguments: &[OsString]) -> Result<ExitStatus> {
    let mut cargo = workspace.cargo_in_current_dir("run");
    cargo.args(["-q", "-p", "host-tests", "--bin", "demo", "--", "--elf"]).arg(&image.path).args(arguments);
    process::run_for_status(&mut cargo)
}
