//! How long the gripper takes to stop while its line is disturbed: an example of host-tests, in virtual time.

use std::process::Stdio;

use anyhow::{Context, Result, ensure};

use crate::{process, workspace::Workspace};

/// Runs every case; the rows of the table, each with its limit. Fails where one takes longer.
pub(crate) fn run(workspace: &Workspace) -> Result<String> {
    let mut cargo = workspace.cargo("run");
    cargo.args(["--quiet", "--release", "-p", "host-tests", "--example", "fast_stop"]);
    eprintln!("+ {}", process::shell_line(&cargo));
    let output = cargo.stdin(Stdio::null()).stderr(Stdio::inherit()).output().context("cannot run cargo")?;
    let table = String::from_utf8(output.stdout).context("the table is no text")?;
    print!("{table}");
    ensure!(output.status.success(), "a gripper does not stop in time");
    Ok(table)
}
