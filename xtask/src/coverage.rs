//! Which lines of the protocol crate its tests reach.

use std::{fs, path::PathBuf, process::Command};

use anyhow::{Context, Result};

use crate::{
    process,
    tool::{self, NIGHTLY, Tool},
    workspace::Workspace,
};

const LLVM_TOOLS: Tool = Tool {
    name: "llvm-tools",
    probe: &["sh", "-c", "ls \"$(rustup run nightly rustc --print target-libdir)/../bin/llvm-cov\""],
    install: &["rustup", "component", "add", "--toolchain", "nightly", "llvm-tools"],
};

/// Prints the coverage of each file, and of all together.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let what_for = "the coverage of wsg-protocol";
    NIGHTLY.require(workspace, what_for)?;
    LLVM_TOOLS.require(workspace, what_for)?;
    let folder = workspace.target_dir.join("coverage");
    let profiles = folder.join("profiles");
    // Profiles of an earlier run would be counted in.
    let _ = fs::remove_dir_all(&profiles);
    let mut cargo = tool::nightly_cargo(workspace, &["test", "-p", "wsg-protocol", "--lib", "--tests"]);
    cargo.env("CARGO_TARGET_DIR", &folder).env("RUSTFLAGS", "-Cinstrument-coverage");
    cargo.env("LLVM_PROFILE_FILE", profiles.join("%p-%m.profraw"));
    process::run(&mut cargo)?;

    let bin = llvm_bin(workspace)?;
    let merged = folder.join("merged.profdata");
    let mut profdata = Command::new(bin.join("llvm-profdata"));
    profdata.args(["merge", "-sparse", "-o"]).arg(&merged).args(files_with(&profiles, "profraw")?);
    process::run(&mut profdata)?;
    let mut report = Command::new(bin.join("llvm-cov"));
    report.args(["report", "--ignore-filename-regex", r"_tests\.rs|/tests/|\.cargo|rustc|gripper-sim"]);
    report.arg("--instr-profile").arg(&merged);
    for program in test_programs(&folder)? {
        report.arg("--object").arg(program);
    }
    process::run(&mut report)
}

fn llvm_bin(workspace: &Workspace) -> Result<PathBuf> {
    let mut rustc =
        tool::plain(workspace, &["rustup", "run", "nightly", "rustc", "--print", "target-libdir"]);
    let libdir = process::answer(&mut rustc).context("nightly Rust does not say where it is")?;
    Ok(PathBuf::from(libdir.trim()).join("../bin"))
}

/// Test programs have a hash in their name and no extension.
fn test_programs(folder: &std::path::Path) -> Result<Vec<PathBuf>> {
    let deps = folder.join("debug/deps");
    let all = fs::read_dir(&deps).with_context(|| format!("cannot read {}", deps.display()))?;
    let is_program = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        path.extension().is_none()
            && path.is_file()
            && (name.starts_with("wsg_protocol-") || name.starts_with("decisions-"))
    };
    Ok(all.flatten().map(|entry| entry.path()).filter(is_program).collect())
}

fn files_with(folder: &std::path::Path, extension: &str) -> Result<Vec<PathBuf>> {
    let all = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let has_it = |path: &PathBuf| path.extension().is_some_and(|it| it == extension);
    Ok(all.flatten().map(|entry| entry.path()).filter(has_it).collect())
}
