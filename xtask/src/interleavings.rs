//! What interrupt handlers and the main loop share, under every order of events that the memory model allows: `loom`.

use anyhow::{Result, ensure};

use crate::{firmware, process, workspace::Workspace};

/// Runs the models.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let mut models = workspace.cargo("test");
    models.args(["--release", "-p", firmware::BRIDGE, "--lib", "::model::"]);
    // Everything is built anew with that flag: in a folder of its own, so that nothing else is.
    models.env("RUSTFLAGS", "--cfg loom").env("CARGO_TARGET_DIR", workspace.target_dir.join("loom"));
    let said = process::output(&mut models)?;
    print!("{said}");
    ensure!(!said.contains("running 0 tests"), "there are no models");
    println!(
        "loom: bytes, frames, images and silences are whole, in order and current in every order of events"
    );
    Ok(())
}
