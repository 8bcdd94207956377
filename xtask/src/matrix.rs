//! Builds the library crates as users will: every combination of features on targets with and without atomics, with the oldest
//! supported Rust, and as published packages.

use std::process::Command;

use anyhow::{Context, Result, ensure};
use boards::BOARDS;
use serde_json::Value;

use crate::{
    firmware, process,
    setup::{self, MINIMUM_RUST},
    workspace::{TARGET_CRATES, Workspace},
};

/// A target without compare-and-swap, the default board's target, and one without any atomics.
const TARGETS: [&str; 3] = ["thumbv6m-none-eabi", "thumbv7em-none-eabihf", "riscv32i-unknown-none-elf"];

const HOST_FEATURES: [&str; 4] = ["editor", "log", "std", "tokio"];

/// The `no_std` example for boards.
const BOARD_EXAMPLE: &str = "build --quiet -p wsg-protocol --example no_std_board --features embedded-io";

/// Which combinations to build.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Extent {
    /// All combinations, and the whole workspace with the images on the oldest Rust. Takes minutes.
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
    ensure!(not_checked.is_empty(), "{passed} builds passed; NOT CHECKED: {}", not_checked.join("; "));
    println!("matrix: {passed} builds passed");
    Ok(())
}

/// Builds the selected combinations. Fails at the first failed build.
pub(crate) fn build(workspace: &Workspace, extent: Extent) -> Result<Outcome> {
    let mut outcome = Outcome { passed: 0, not_checked: Vec::new() };

    let (targets, missing): (Vec<&str>, Vec<&str>) =
        TARGETS.into_iter().partition(|target| setup::provide_target(workspace, target));
    let not_checked = |target| format!("the crates on {target} (rustup could not install the target)");
    outcome.not_checked.extend(missing.into_iter().map(not_checked));
    let metadata = workspace.packages()?;
    for package in TARGET_CRATES {
        let features = features(&metadata, package)?;
        for (combination, is_everywhere) in combinations(&features, extent) {
            let targets: Vec<&str> =
                targets.iter().copied().filter(|target| is_everywhere || *target == TARGETS[0]).collect();
            if targets.is_empty() {
                continue;
            }
            let mut check = workspace.cargo("check --quiet --no-default-features");
            check.args(["-p", package, "--features", &combination]);
            // One call for all targets, which run in parallel.
            process::run(check.args(targets.iter().flat_map(|target| ["--target", target])))?;
            outcome.passed += targets.len();
        }
    }
    // Never linked, because this workspace's flags would be added to its own. `update` only compares the lock file.
    let check = format!("check --target {}", setup::TRIPLE);
    let line = if extent == Extent::Whole { &check } else { "update --workspace" };
    let mut template = workspace.cargo(line);
    process::run(template.args(["--quiet", "--manifest-path", "boards/template/Cargo.toml"]))?;
    outcome.passed += 1;
    for target in targets.into_iter().filter(|target| extent == Extent::Whole || *target == TARGETS[0]) {
        process::run(workspace.cargo(BOARD_EXAMPLE).args(["--target", target]))?;
        outcome.passed += 1;
    }

    let oldest = format!("{MINIMUM_RUST}.0");
    let rustc = ["run", &oldest, "rustc", "--version"];
    let install = ["toolchain", "install", &oldest, "--profile", "minimal", "--no-self-update"];
    if process::answer(Command::new("rustup").args(rustc)).is_some() || setup::rustup(workspace, &install) {
        let mut check = check_with(workspace, &oldest);
        process::run(match extent {
            Extent::Whole => check.args(["--workspace", "--all-targets"]),
            Extent::Quick => check.args(packages()).arg("--all-features"),
        })?;
        outcome.passed += 1;
        if extent == Extent::Whole {
            for board in &BOARDS {
                setup::rustup(workspace, &["target", "add", "--toolchain", &oldest, board.triple]);
                let mut image = check_with(workspace, &oldest);
                image.args(firmware::selection(board, &[], firmware::PROFILE));
                process::run(image.args(["--target", board.triple]))?;
                outcome.passed += 1;
            }
        }
    } else {
        outcome.not_checked.push(format!("Rust {oldest} (rustup could not install it)"));
    }

    // One call for all packages, so that each is verified against the local versions of the others.
    process::run(workspace.cargo("package --quiet --allow-dirty").args(packages()))?;
    outcome.passed += 1;
    Ok(outcome)
}

fn check_with(workspace: &Workspace, toolchain: &str) -> Command {
    let mut check = Command::new("rustup");
    // A separate build folder, so that the tool chains do not invalidate each other's builds.
    check.current_dir(&workspace.root).env("CARGO_TARGET_DIR", workspace.target_dir.join("oldest-rust"));
    check.args(["run", toolchain, "cargo", "check", "--locked", "--quiet"]);
    check
}

/// The crates for boards, and the one that makes a part of `wsg-protocol` while it is compiled.
fn packages() -> impl Iterator<Item = &'static str> {
    TARGET_CRATES.into_iter().chain(["wsg-protocol-macros"]).flat_map(|package| ["-p", package])
}

/// Returns the features for boards of a library crate, which may have none.
pub(crate) fn features(packages: &[Value], name: &str) -> Result<Vec<String>> {
    let features = packages.iter().find(|package| package["name"] == name).map(|it| &it["features"]);
    let features = features.and_then(Value::as_object).with_context(|| format!("no package {name}"))?;
    let is_for_boards = |name: &&String| *name != "default" && !HOST_FEATURES.contains(&name.as_str());
    Ok(features.keys().filter(is_for_boards).cloned().collect())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_combination_occurs_once_and_quick_limits_lone_features() {
        let of = |extent| combinations(&["a", "b", "c"].map(str::to_owned), extent);
        let whole = ["", "a", "b", "a,b", "c", "a,c", "b,c", "a,b,c"];
        assert_eq!(of(Extent::Whole), whole.map(|names| (names.to_owned(), true)));
        let quick = [("", true), ("a", false), ("b", false), ("c", false), ("a,b,c", true)];
        assert_eq!(of(Extent::Quick), quick.map(|(names, all)| (names.to_owned(), all)));
    }

    #[test]
    fn features_for_boards_are_neither_the_default_nor_for_the_host() {
        let packages = Workspace::from_env().unwrap().packages().unwrap();
        let of = |name: &str| features(&packages, name).unwrap();
        assert!(of("wsg-protocol").contains(&"small-table".to_owned()), "{:?}", of("wsg-protocol"));
        assert!(!of("wsg-protocol").iter().any(|name| ["default", "std", "tokio"].contains(&name.as_str())));
        let once = [(String::new(), true)];
        assert_eq!(combinations(&of("bus-slcan"), Extent::Whole), once);
        assert!(features(&packages, "no-such-package").is_err());
    }
}
