//! Runs the fuzz targets in host-tests/fuzz, or their bodies on generated inputs without cargo-fuzz.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};

use crate::{
    process,
    tool::{self, CARGO_FUZZ, NIGHTLY},
    workspace::Workspace,
};

/// How much to fuzz.
#[derive(clap::Args)]
pub(crate) struct Extent {
    /// Run time per target in seconds
    #[arg(long, value_name = "N", default_value_t = 60)]
    seconds: u32,
    /// Run the bodies of the targets on N generated inputs each instead, on stable Rust
    #[arg(long, value_name = "N", conflicts_with = "seconds")]
    inputs: Option<u32>,
}

const FOLDER: &str = "host-tests/fuzz";

/// Time-out per input in seconds. Bodies are bounded, so a longer run is a hang.
const HANG_SECONDS: u32 = 10;

/// Fuzzes to the given extent. Generated inputs give no coverage feedback, but without a sanitizer about a hundred times as many run
/// in the same time.
pub(crate) fn run(workspace: &Workspace, extent: &Extent) -> Result<()> {
    let Some(count) = extent.inputs else { return run_targets(workspace, extent.seconds) };
    // The `mutants` profile is optimised and keeps all checks.
    let mut inputs = workspace.cargo("run --quiet --profile mutants -p host-tests --example inputs --");
    process::run(inputs.arg(count.to_string()))
        .context("a body failed; its input is printed after the message above")
}

/// Runs each target for `seconds`, starting from its committed seeds and the corpus of earlier runs.
fn run_targets(workspace: &Workspace, seconds: u32) -> Result<()> {
    let targets = targets(&workspace.root.join(FOLDER).join("fuzz_targets"))?;
    let what_for = format!("the fuzz targets {}", targets.join(", "));
    [NIGHTLY, CARGO_FUZZ].iter().try_for_each(|tool| tool.require(workspace, &what_for))?;
    let work = workspace.target_dir.join("fuzz");
    // The targets are no part of the workspace, but use the same versions.
    let lock = workspace.root.join(FOLDER).join("Cargo.lock");
    fs::copy(workspace.root.join("Cargo.lock"), &lock)
        .with_context(|| format!("cannot write {}", lock.display()))?;
    for target in &targets {
        let (corpus, artifacts) = (work.join("corpus").join(target), work.join("artifacts").join(target));
        for folder in [&corpus, &artifacts] {
            fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        }
        let mut fuzz = tool::plain(workspace, "rustup run nightly cargo fuzz run --fuzz-dir");
        fuzz.arg(FOLDER)
            .arg("--target-dir")
            .arg(work.join("build"))
            .arg(target)
            .arg(&corpus)
            .arg(format!("{FOLDER}/seeds/{target}"));
        fuzz.args(["--", &format!("-max_total_time={seconds}"), &format!("-timeout={HANG_SECONDS}")]);
        fuzz.args([&format!("-dict={FOLDER}/wsg.dict"), "-print_final_stats=1", "-verbosity=0"]);
        fuzz.arg(format!("-artifact_prefix={}/", artifacts.display()));
        process::run(&mut fuzz)
            .with_context(|| format!("fuzz target {target}: the input is in {}", artifacts.display()))?;
    }
    println!("fuzz: {seconds} s each, no crash and no hang: {what_for}");
    Ok(())
}

/// Returns the sorted names of the fuzz targets.
fn targets(folder: &Path) -> Result<Vec<String>> {
    let entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let names = entries.map(|entry| Ok(entry?.path().file_stem().unwrap_or_default().display().to_string()));
    let mut names = names.collect::<Result<Vec<_>>>()?;
    names.sort();
    ensure!(!names.is_empty(), "no fuzz targets in {}", folder.display());
    Ok(names)
}
