//! How long the gripper takes to stop while its line is disturbed: an example of host-tests, in virtual time.

use anyhow::{Context, Result};

use crate::{process, workspace::Workspace};

/// Runs every case; the rows of the table, each with its limit. Fails where one takes longer.
pub(crate) fn run(workspace: &Workspace) -> Result<String> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["--quiet", "--release", "-p", "host-tests", "--example", "fast_stop"]);
    let table = process::output(&mut cargo).context("a gripper does not stop in time")?;
    print!("{table}");
    Ok(table)
}
