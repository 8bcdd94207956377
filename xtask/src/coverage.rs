//! Line coverage of the library crates by their tests, with cargo-llvm-cov.

use anyhow::Result;

use crate::{
    process,
    tool::{self, CARGO_LLVM_COV},
    workspace::{TARGET_CRATES, Workspace},
};

/// Prints the coverage per file and in total, by the tests without doc examples.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    CARGO_LLVM_COV.require(workspace, "the coverage of protocol and buses")?;
    // CARGO_LLVM_COV_SETUP lets it install missing LLVM tools with rustup without asking.
    let mut coverage = tool::plain(workspace, &["cargo", "llvm-cov", "--locked", "--lib", "--tests"]);
    coverage
        .env("CARGO_LLVM_COV_SETUP", "yes")
        .args(["--ignore-filename-regex", r"tests\.rs|/tests/|gripper-sim|host-tests|boards/"]);
    coverage.args(TARGET_CRATES.into_iter().flat_map(|(package, _)| ["-p", package]));
    // The tests of the bridge in virtual time.
    coverage.args(["-p", "host-tests"]);
    coverage.env("CARGO_LLVM_COV_TARGET_DIR", workspace.target_dir.join("coverage"));
    process::run(&mut coverage)
}
