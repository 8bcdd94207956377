//! The fuzz targets of host-tests/fuzz, one after the other; and their bodies over generated inputs, without cargo-fuzz.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};

use crate::{
    process,
    tool::{self, CARGO_FUZZ, NIGHTLY},
    workspace::Workspace,
};

/// How long each target runs when nothing else is said.
pub(crate) const SECONDS: u32 = 60;

/// How much is fuzzed.
pub(crate) enum Extent {
    /// Each target for so many seconds.
    Seconds(u32),
    /// Each body over so many generated inputs.
    Inputs(u32),
}

const FOLDER: &str = "host-tests/fuzz";

/// No input may take longer: a body is bounded, so this is a hang.
const HANG_SECONDS: u32 = 10;

/// Fuzzes as much as is asked for.
pub(crate) fn run(workspace: &Workspace, extent: &Extent) -> Result<()> {
    match extent {
        Extent::Seconds(seconds) => run_targets(workspace, *seconds),
        Extent::Inputs(count) => run_inputs(workspace, *count),
    }
}

/// Runs each body over so many generated inputs, on stable Rust. Nothing watches what they reach, but without a sanitizer
/// they are some hundred times as many in the same time.
fn run_inputs(workspace: &Workspace, count: u32) -> Result<()> {
    let mut inputs = workspace.cargo("run");
    // The profile of the mutants: optimised, with all checks.
    inputs.args(["--quiet", "--profile", "mutants", "-p", "host-tests", "--example", "inputs", "--"]);
    process::run(inputs.arg(count.to_string())).context("the input stands behind what the body says")
}

/// Runs each target for so long, from its committed seeds and from what earlier runs have found.
fn run_targets(workspace: &Workspace, seconds: u32) -> Result<()> {
    let targets = targets(&workspace.root.join(FOLDER).join("fuzz_targets"))?;
    let what_for = format!("the fuzz targets {}", targets.join(", "));
    NIGHTLY.require(workspace, &what_for)?;
    CARGO_FUZZ.require(workspace, &what_for)?;
    let work = workspace.target_dir.join("fuzz");
    // cargo-fuzz does not know `--locked`: this fails in its place.
    let manifest = format!("{FOLDER}/Cargo.toml");
    process::run(&mut tool::nightly_cargo(
        workspace,
        &["fetch", "--quiet", "--locked", "--manifest-path", &manifest],
    ))?;
    for target in &targets {
        let (corpus, artifacts) = (work.join("corpus").join(target), work.join("artifacts").join(target));
        for folder in [&corpus, &artifacts] {
            fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        }
        let mut fuzz = tool::nightly_cargo(workspace, &["fuzz", "run", "--fuzz-dir", FOLDER, "--target-dir"]);
        fuzz.arg(work.join("build")).arg(target).arg(&corpus).arg(format!("{FOLDER}/seeds/{target}"));
        fuzz.args(["--", &format!("-max_total_time={seconds}"), &format!("-timeout={HANG_SECONDS}")]);
        fuzz.args([&format!("-dict={FOLDER}/wsg.dict"), "-print_final_stats=1", "-verbosity=0"]);
        fuzz.arg(format!("-artifact_prefix={}/", artifacts.display()));
        process::run(&mut fuzz)
            .with_context(|| format!("fuzz target {target}: the input is in {}", artifacts.display()))?;
    }
    println!(
        "fuzz: {} targets, {seconds} s each, no crash and no hang: {}",
        targets.len(),
        targets.join(", ")
    );
    Ok(())
}

/// The names of the targets.
fn targets(folder: &Path) -> Result<Vec<String>> {
    let entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut names = Vec::new();
    for entry in entries {
        let path = entry?.path();
        names.extend(path.file_stem().map(|name| name.to_string_lossy().into_owned()));
    }
    names.sort();
    ensure!(!names.is_empty(), "no fuzz targets in {}", folder.display());
    Ok(names)
}
