//! Stopping time of the gripper on a disturbed line, measured in virtual time by an example of host-tests.

use anyhow::{Context, Result};

use crate::{process, workspace::Workspace};

/// Runs every case and returns the rows of the table. Fails if a case exceeds its limit.
pub(crate) fn run(workspace: &Workspace) -> Result<String> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["--quiet", "--release", "-p", "host-tests", "--example", "fast_stop"]);
    let table = process::output(&mut cargo).context("the gripper did not stop in time")?;
    print!("{table}");
    Ok(table)
}
