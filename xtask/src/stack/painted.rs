//! The painted stack: a program of host-tests/probes boots the image on painted memory, puts it through the worst that
//! it knows, and looks how far the paint is gone.

use anyhow::{Context, Result};

use crate::{firmware::Image, gate::Gate, process, workspace::Workspace};

/// The deepest that the stack of this image was seen.
pub(crate) fn of_image(workspace: &Workspace, image: &Image) -> Result<Gate> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["-q", "-p", "wsg-probes", "--features", "painted-stack", "--bin", "painted-stack", "--"]);
    cargo.arg(&image.path);
    let said = process::output(&mut cargo)?;
    let bytes = said.lines().find_map(|line| line.strip_prefix("painted-stack ")?.trim().parse().ok());
    let bytes = bytes.context("the program painted-stack told no figure")?;
    Ok(Gate::bytes("worst-case stack, painted in the emulator", bytes, super::LIMIT))
}
