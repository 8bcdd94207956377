//! Builds the library crates as users will: every combination of features on targets with and without atomics, with the oldest
//! supported Rust, and as published packages.

use std::{fs, process::Command};

use anyhow::{Context, Result, bail};

use crate::{
    process,
    setup::{self, MINIMUM_RUST},
    workspace::{TARGET_CRATES, Workspace},
};

/// A target without compare-and-swap, the default board's target, and one without any atomics.
const TARGETS: [&str; 3] = ["thumbv6m-none-eabi", "thumbv7em-none-eabihf", "riscv32i-unknown-none-elf"];

/// Host-only features.
const HOST_FEATURES: [&str; 2] = ["std", "tokio"];

/// The `no_std` example for boards.
const BOARD_EXAMPLE: [&str; 6] =
    ["-p", "wsg-protocol", "--example", "no_std_board", "--features", "embedded-io"];

/// Which combinations to build.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Extent {
    /// All combinations, and the whole workspace on the oldest Rust. Takes minutes.
    Whole,
    /// No features and all features on every target. Each feature alone and the example on the first target. Only the library
    /// crates on the oldest Rust.
    Quick,
}

/// Number of successful builds, and a list of skipped ones.
pub(crate) struct Outcome {
    pub(crate) passed: usize,
    pub(crate) not_checked: Vec<String>,
}

/// Builds the whole matrix. Fails at the end if any build was skipped.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let Outcome { passed, not_checked } = build(workspace, Extent::Whole)?;
    if !not_checked.is_empty() {
        bail!("{passed} builds passed; NOT CHECKED: {}", not_checked.join("; "));
    }
    println!("matrix: {passed} builds passed");
    Ok(())
}

/// Builds the selected combinations. Fails at the first failed build.
pub(crate) fn build(workspace: &Workspace, extent: Extent) -> Result<Outcome> {
    let mut outcome = Outcome { passed: 0, not_checked: Vec::new() };

    let (targets, missing): (Vec<&str>, Vec<&str>) = TARGETS.into_iter().partition(|target| {
        setup::has_target(workspace, target) || setup::rustup(workspace, &["target", "add", target])
    });
    let not_checked = |target| format!("the crates on {target} (rustup could not install the target)");
    outcome.not_checked.extend(missing.into_iter().map(not_checked));
    for (package, folder) in TARGET_CRATES {
        let features = features(&workspace.root.join(folder).join("Cargo.toml"))?;
        for (combination, is_everywhere) in combinations(&features, extent) {
            let targets: Vec<&str> =
                targets.iter().copied().filter(|target| is_everywhere || *target == TARGETS[0]).collect();
            if targets.is_empty() {
                continue;
            }
            let mut check = workspace.cargo("check");
            check.args(["--quiet", "-p", package, "--no-default-features", "--features", &combination]);
            // One call for all targets, which run in parallel.
            process::run(check.args(targets.iter().flat_map(|target| ["--target", target])))?;
            outcome.passed += targets.len();
        }
    }
    if extent == Extent::Whole {
        // Checked but not linked, because this workspace's flags would be added to its own.
        let mut template = workspace.cargo("check");
        template.args([
            "--quiet",
            "--manifest-path",
            "boards/template/Cargo.toml",
            "--target",
            setup::TRIPLE,
        ]);
        process::run(&mut template)?;
        outcome.passed += 1;
    }
    for target in targets.into_iter().filter(|target| extent == Extent::Whole || *target == TARGETS[0]) {
        let mut example = workspace.cargo("build");
        process::run(example.args(["--quiet", "--target", target]).args(BOARD_EXAMPLE))?;
        outcome.passed += 1;
    }

    let oldest = format!("{MINIMUM_RUST}.0");
    if has_toolchain(&oldest)
        || setup::rustup(
            workspace,
            &["toolchain", "install", &oldest, "--profile", "minimal", "--no-self-update"],
        )
    {
        process::run(&mut check_with(workspace, &oldest, extent))?;
        outcome.passed += 1;
    } else {
        outcome.not_checked.push(format!("Rust {oldest} (rustup could not install it)"));
    }

    let mut package = workspace.cargo("package");
    // One call for all packages, so that each is verified against the local versions of the others.
    process::run(package.args(["--quiet", "--allow-dirty"]).args(packages()))?;
    outcome.passed += 1;
    Ok(outcome)
}

fn check_with(workspace: &Workspace, toolchain: &str, extent: Extent) -> Command {
    let mut check = Command::new("rustup");
    // A separate build folder, so that the tool chains do not invalidate each other's builds.
    check.current_dir(&workspace.root).env("CARGO_TARGET_DIR", workspace.target_dir.join("oldest-rust"));
    check.args(["run", toolchain, "cargo", "check", "--locked", "--quiet"]);
    match extent {
        Extent::Whole => check.args(["--workspace", "--all-targets"]),
        Extent::Quick => check.args(packages()).arg("--all-features"),
    };
    check
}

/// The crates for boards, and the one that makes a part of `wsg-protocol` while it is compiled.
fn packages() -> impl Iterator<Item = &'static str> {
    let packages = TARGET_CRATES.into_iter().map(|(package, _)| package);
    packages.chain(["wsg-protocol-macros"]).flat_map(|package| ["-p", package])
}

/// Reads the features for boards from a manifest. A crate may have none.
pub(crate) fn features(manifest: &std::path::Path) -> Result<Vec<String>> {
    let text = fs::read_to_string(manifest).with_context(|| format!("cannot read {}", manifest.display()))?;
    let features: Vec<String> = text
        .lines()
        .skip_while(|line| *line != "[features]")
        .skip(1)
        .take_while(|line| !line.starts_with('['))
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| Some(line.split_once('=')?.0.trim().to_owned()))
        .filter(|name| name != "default" && !HOST_FEATURES.contains(&name.as_str()))
        .collect();
    Ok(features)
}

/// Returns comma-separated combinations, the empty one first, and whether to build each on every target. With [`Extent::Quick`],
/// single features are built on the first target only.
fn combinations(features: &[String], extent: Extent) -> Vec<(String, bool)> {
    let all = (1usize << features.len()) - 1;
    (0..=all)
        .map(|chosen| (chosen, extent == Extent::Whole || chosen == 0 || chosen == all))
        .filter(|(chosen, is_everywhere)| *is_everywhere || chosen.count_ones() == 1)
        .map(|(chosen, is_everywhere)| {
            let names = features.iter().enumerate().filter(|(n, _)| chosen & (1 << n) != 0);
            let names: Vec<&str> = names.map(|(_, name)| name.as_str()).collect();
            (names.join(","), is_everywhere)
        })
        .collect()
}

fn has_toolchain(version: &str) -> bool {
    process::answer(Command::new("rustup").args(["run", version, "rustc", "--version"])).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_combination_occurs_once() {
        let names = ["a", "b", "c"].map(str::to_owned);
        let whole = combinations(&names, Extent::Whole);
        let whole: Vec<(&str, bool)> = whole.iter().map(|(names, all)| (names.as_str(), *all)).collect();
        assert_eq!(whole, ["", "a", "b", "a,b", "c", "a,c", "b,c", "a,b,c"].map(|names| (names, true)));
    }

    #[test]
    fn quick_takes_a_feature_alone_on_the_first_target_only() {
        let names = ["a", "b", "c"].map(str::to_owned);
        let quick = [("", true), ("a", false), ("b", false), ("c", false), ("a,b,c", true)];
        assert_eq!(combinations(&names, Extent::Quick), quick.map(|(names, all)| (names.to_owned(), all)));
    }

    #[test]
    fn features_are_read_from_the_manifest() {
        let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/../protocol/Cargo.toml");
        let features = features(manifest.as_ref()).unwrap();
        assert!(features.contains(&"small-table".to_owned()), "{features:?}");
        assert!(!features.iter().any(|name| name == "default" || name.contains('#')), "{features:?}");
        let once = [(String::new(), true)];
        assert_eq!(combinations(&[], Extent::Whole), once, "a crate without features is built once");
    }
}
