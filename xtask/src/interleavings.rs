//! Checks data shared by interrupt handlers and the main loop under every order that the memory model allows, with `loom`.

use anyhow::{Result, ensure};

use crate::{firmware, process, workspace::Workspace};

/// Runs the loom models of the bridge.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let mut models = workspace.cargo("test");
    models.args(["--release", "-p", firmware::BRIDGE, "--lib", "::model::"]);
    // A separate build folder, because the flag would cause a full rebuild of everything else.
    models.env("RUSTFLAGS", "--cfg loom").env("CARGO_TARGET_DIR", workspace.target_dir.join("loom"));
    let said = process::output(&mut models)?;
    print!("{said}");
    ensure!(!said.contains("running 0 tests"), "no loom models were run");
    println!(
        "loom: bytes, frames, images and silences stay whole, in order and current under every order of events"
    );
    Ok(())
}
