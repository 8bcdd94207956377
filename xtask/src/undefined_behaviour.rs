//! Runs Miri on the host tests of the bridge library, which contains the firmware's static queues.

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
    // Property tests write failures to files, which Miri's isolation prevents. Few cases, to save time.
    miri.env("MIRIFLAGS", "-Zmiri-disable-isolation").env("PROPTEST_CASES", "4");
    process::run(&mut miri)?;
    println!(
        "miri: no undefined behaviour in the bridge's host tests (board code, which only the target has, is not among them)"
    );
    Ok(())
}
