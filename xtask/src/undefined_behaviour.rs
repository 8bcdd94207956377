//! Miri over the host tests of the crates that the firmware's static queues and the board-free bridge are in.

use anyhow::Result;

use crate::{
    firmware, process,
    tool::{self, MIRI, NIGHTLY},
    workspace::Workspace,
};

/// Runs the tests of the bridge's library under Miri.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let what_for = "the bridge's host tests under Miri";
    NIGHTLY.require(workspace, what_for)?;
    MIRI.require(workspace, what_for)?;
    let mut miri =
        tool::nightly_cargo(workspace, &["miri", "test", "--locked", "-p", firmware::BRIDGE, "--lib"]);
    miri.env("CARGO_TARGET_DIR", workspace.target_dir.join("miri"));
    // Property tests write what failed to files, which Miri keeps them from; their cases are few here, for time.
    miri.env("MIRIFLAGS", "-Zmiri-disable-isolation").env("PROPTEST_CASES", "4");
    process::run(&mut miri)?;
    println!(
        "miri: no undefined behaviour in the bridge's host tests (board code, which only the target has, is not among them)"
    );
    Ok(())
}
