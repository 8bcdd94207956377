//! Which lines of the crates for boards their tests reach.

use std::{fs, path::PathBuf, process::Command};

use anyhow::{Context, Result, ensure};

use crate::{
    process,
    tool::{self, NIGHTLY, Tool},
    workspace::{TARGET_CRATES, Workspace},
};

const LLVM_TOOLS: Tool = Tool {
    name: "llvm-tools",
    probe: &["sh", "-c", "ls \"$(rustup run nightly rustc --print target-libdir)/../bin/llvm-cov\""],
    install: &["rustup", "component", "add", "--toolchain", "nightly", "llvm-tools"],
};

/// Prints the coverage of each file, and of all together: that of the tests, without the examples in the docs.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let what_for = "the coverage of protocol and buses";
    NIGHTLY.require(workspace, what_for)?;
    LLVM_TOOLS.require(workspace, what_for)?;
    let folder = workspace.target_dir.join("coverage");
    let profiles = folder.join("profiles");
    // Profiles of an earlier run would be counted in.
    let _ = fs::remove_dir_all(&profiles);
    let tests = |more: &[&str]| {
        let mut cargo = tool::nightly_cargo(workspace, &["test", "--locked", "--lib", "--tests"]);
        cargo.args(TARGET_CRATES.into_iter().flat_map(|(package, _)| ["-p", package]));
        cargo.args(more).env("CARGO_TARGET_DIR", &folder).env("RUSTFLAGS", "-Cinstrument-coverage");
        cargo.env("LLVM_PROFILE_FILE", profiles.join("%p-%m.profraw"));
        cargo
    };
    let programs = programs_in(&process::output(&mut tests(&["--no-run", "--message-format", "json"]))?);
    ensure!(!programs.is_empty(), "cargo names no test programs");
    process::run(&mut tests(&[]))?;

    let bin = llvm_bin(workspace)?;
    let merged = folder.join("merged.profdata");
    let mut profdata = Command::new(bin.join("llvm-profdata"));
    profdata.args(["merge", "-sparse", "-o"]).arg(&merged).args(files_with(&profiles, "profraw")?);
    process::run(&mut profdata)?;
    let mut report = Command::new(bin.join("llvm-cov"));
    report.args(["report", "--ignore-filename-regex", r"tests\.rs|/tests/|\.cargo|rustc|gripper-sim"]);
    report.arg("--instr-profile").arg(&merged);
    for program in programs {
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

/// The programs that cargo says it has made: others of earlier runs may lie beside them.
fn programs_in(messages: &str) -> Vec<PathBuf> {
    let paths = messages.split("\"executable\":\"").skip(1);
    paths.filter_map(|rest| rest.split_once('"')).map(|(path, _)| PathBuf::from(path)).collect()
}

fn files_with(folder: &std::path::Path, extension: &str) -> Result<Vec<PathBuf>> {
    let all = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let has_it = |path: &PathBuf| path.extension().is_some_and(|it| it == extension);
    Ok(all.flatten().map(|entry| entry.path()).filter(has_it).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_are_those_that_cargo_names() {
        let messages = "{\"reason\":\"compiler-artifact\",\"executable\":\"/t/deps/a-1\",\"fresh\":true}\n\
                        {\"reason\":\"compiler-artifact\",\"executable\":null,\"fresh\":true}\n\
                        {\"executable\":\"/t/deps/b-2\"}\n";

        assert_eq!(programs_in(messages), [PathBuf::from("/t/deps/a-1"), PathBuf::from("/t/deps/b-2")]);
    }
}
