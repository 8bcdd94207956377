//! Mutation testing of the protocol crate, the buses and the bridge library: finds changes that no test detects.

mod accepted;

use std::{collections::BTreeSet, fs, path::Path};

use anyhow::{Context, Result, bail, ensure};

use crate::{
    process,
    tool::{self, CARGO_MUTANTS},
    workspace::Workspace,
};
use accepted::Accepted;

/// Paths in which every surviving mutant must be accepted.
const ALL_CAUGHT_IN: [&str; 7] = [
    "protocol/src/checksum.rs",
    "protocol/src/frame",
    "protocol/src/can",
    "fieldbus/",
    "protocol/src/session",
    "buses/",
    "bridge-fw/src/",
];

/// Minimum share of caught and accepted mutants in percent.
const CAUGHT_PERCENT: usize = 95;

/// One run of cargo-mutants: the mutants and the tests to run on them. Lists are separated by spaces.
struct Part {
    name: &'static str,
    packages: &'static str,
    /// Folder of the files to mutate.
    folder: &'static str,
    /// Options for cargo-mutants that select the mutants and their features.
    options: &'static str,
    /// The tests, and after `--` the arguments for them. Doc examples detect no further mutants and would double the time.
    tests: &'static str,
}

const PARTS: [Part; 7] = [
    Part {
        name: "protocol",
        packages: "wsg-protocol",
        folder: "protocol/",
        // The tests that need the servers of the virtual gripper are with it, where a baseline would not find them.
        options: "--exclude-re ^protocol/src/decimal --exclude-re ^protocol/src/session \
            --test-package wsg-protocol,wsg-sim --baseline skip",
        // Cargo stops at the first test that fails, so the last two, which wait for sockets, run for few mutants.
        tests: "--lib --test=drivers --test=gcl --test=hashes --test=host --test=stream -- --skip decimal::tests",
    },
    // The session's tests are all in the crate itself, so no other crate needs to be linked. Includes the tests of the GCL session,
    // which uses the same engine.
    Part {
        name: "session",
        packages: "wsg-protocol",
        folder: "protocol/",
        options: "--re ^protocol/src/session",
        tests: "--lib --test=hashes -- --skip decimal::tests",
    },
    // The parser of decimal fractions: its tests take as long as all others and detect nothing elsewhere.
    Part {
        name: "decimal",
        packages: "wsg-protocol",
        folder: "protocol/",
        options: "--re ^protocol/src/decimal",
        tests: "--lib --test=gcl",
    },
    // Code specific to the feature. A mutant caught in either run counts as caught.
    Part {
        name: "small-table",
        packages: "wsg-protocol",
        folder: "protocol/",
        options: "--features small-table --re ^protocol/src/checksum.*(lookup|chunk)::",
        tests: "--lib",
    },
    Part {
        name: "fieldbus",
        packages: "wsg-fieldbus",
        folder: "fieldbus/",
        options: "",
        tests: "--lib --tests",
    },
    Part {
        name: "buses",
        packages: "bus-modbus bus-slcan bus-canopen bus-profibus bus-profinet bus-ethernetip",
        folder: "buses/",
        options: "",
        tests: "--lib",
    },
    // The board crates are tested only by their images in the emulator.
    Part {
        name: "bridge-fw",
        packages: "wsg-bridge-fw",
        folder: "bridge-fw/",
        // Only `cargo xtask loom` compiles the models. The harness has the tests in virtual time, which a baseline would not find.
        options: "--exclude **/model.rs --test-package wsg-bridge-fw,host-tests --baseline skip",
        tests: "--lib --test=bridge --test=can_bus --test=gripper_link --test=register_table --test=rtu_port --test=uart_*",
    },
];

/// Runs the tests with as many cases as `cargo xtask test`, but with a fixed seed. Failing cases are neither shrunk nor persisted.
const ENVIRONMENT: [(&str, &str); 4] = [
    ("PROPTEST_RNG_SEED", "1"),
    ("PROPTEST_MAX_SHRINK_ITERS", "0"),
    ("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "true"),
    ("CARGO_INCREMENTAL", "1"),
];

/// Results of the mutants, each identified by a line of cargo-mutants.
#[derive(Debug, Default, PartialEq)]
struct Outcome {
    caught: BTreeSet<String>,
    survived: BTreeSet<String>,
}

/// Which mutants to test.
#[derive(clap::Args)]
pub(crate) struct Extent {
    /// Mutate only these files (or file patterns)
    #[arg(value_name = "FILE")]
    files: Vec<String>,
    /// Options for cargo-mutants, such as --shard K/N --sharding round-robin for a sample, --iterate, or --jobs N
    #[arg(last = true, value_name = "OPTIONS")]
    options: Vec<String>,
}

/// Tests the mutants and compares the survivors with the accepted ones.
pub(crate) fn run(workspace: &Workspace, extent: &Extent) -> Result<()> {
    let accepted = Accepted::read(&workspace.root)?;
    CARGO_MUTANTS.require(workspace, "the mutants of protocol, buses and bridge")?;
    let mut outcome = Outcome::default();
    for part in &PARTS {
        let files: Vec<&String> = extent.files.iter().filter(|file| file.starts_with(part.folder)).collect();
        if extent.files.is_empty() || !files.is_empty() {
            outcome.join(make(workspace, part, &files, extent)?);
        }
    }
    judge(&outcome, &accepted, extent.files.is_empty() && extent.options.is_empty())
}

/// Runs cargo-mutants for one part.
fn make(workspace: &Workspace, part: &Part, files: &[&String], extent: &Extent) -> Result<Outcome> {
    let output = workspace.target_dir.join("mutants").join(part.name);
    fs::create_dir_all(&output).with_context(|| format!("cannot create {}", output.display()))?;
    let mut mutants = tool::plain(workspace, "cargo mutants --no-shuffle --profile mutants --colors never");
    mutants.args(part.packages.split(' ').flat_map(|package| ["-p", package])).envs(ENVIRONMENT);
    mutants.arg("--output").arg(&output).args(&extent.options);
    let (targets, arguments) = part.tests.split_once(" -- ").unwrap_or((part.tests, ""));
    // As arguments for every call of Cargo. Otherwise each mutant would be built into all tests and examples.
    mutants.args(targets.split(' ').map(|target| format!("--cargo-arg={target}")));
    // A generous time-out, so that a busy machine is not mistaken for a hanging mutant.
    mutants.args(["--timeout-multiplier", "6", "--minimum-test-timeout", "20"]);
    mutants.args(["--exclude", "**/tests/**", "--exclude", "**/*tests.rs", "--cargo-arg=--locked"]);
    mutants.args(files.iter().flat_map(|file| ["--file", file])).args(part.options.split_whitespace());
    mutants.args(["--", "--"]).args(arguments.split_whitespace());
    let status = process::run_for_status(&mut mutants)?;
    // 2: mutants survived. 3: some timed out, which counts as caught.
    ensure!(matches!(status.code(), Some(0 | 2 | 3)), "cargo-mutants itself failed ({status})");
    outcome(&output.join("mutants.out"))
}

/// Reads the results. A file is missing if there were no mutants.
fn outcome(folder: &Path) -> Result<Outcome> {
    let mut outcome = Outcome::default();
    for name in ["caught.txt", "timeout.txt", "previously_caught.txt", "missed.txt"] {
        let path = folder.join(name);
        if path.exists() {
            let text =
                fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
            let of = if name == "missed.txt" { &mut outcome.survived } else { &mut outcome.caught };
            of.extend(text.lines().map(str::to_owned));
        }
    }
    Ok(outcome)
}

impl Outcome {
    /// Merges another run. A mutant caught in either run counts as caught.
    fn join(&mut self, other: Self) {
        self.caught.extend(other.caught);
        self.survived.extend(other.survived);
        self.survived.retain(|mutant| !self.caught.contains(mutant));
    }
}

fn judge(outcome: &Outcome, accepted: &Accepted, is_whole: bool) -> Result<()> {
    let mut open = Vec::new();
    for mutant in &outcome.survived {
        match accepted.reason(mutant) {
            Some(reason) => println!("  accepted: {mutant} ({reason})"),
            None => {
                println!("  SURVIVED: {mutant}");
                open.push(mutant);
            }
        }
    }
    let caught = outcome.caught.len();
    let made = caught + outcome.survived.len();
    ensure!(made > 0, "no mutants; check that the files belong to protocol, buses or bridge-fw");
    let settled = made - open.len();
    println!("mutants: {caught} of {made} caught, {} accepted, {} survived", settled - caught, open.len());
    let must = |mutant: &&&String| ALL_CAUGHT_IN.iter().any(|place| mutant.starts_with(place));
    let count = open.iter().filter(must).count();
    if let Some(first) = open.iter().find(must) {
        bail!("{count} mutants survive where none may; the first is {first}");
    }
    if is_whole && settled * 100 < made * CAUGHT_PERCENT {
        bail!("less than {CAUGHT_PERCENT} % of the mutants are caught");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn survived(names: &[&str]) -> Outcome {
        let caught = (0..99).map(|n| format!("protocol/src/x.rs:{n}:1: caught")).collect();
        Outcome { caught, survived: names.iter().map(|name| (*name).to_owned()).collect() }
    }

    fn is_fine(outcome: &Outcome, is_whole: bool) -> bool {
        judge(outcome, &Accepted::default(), is_whole).is_ok()
    }

    #[test]
    fn what_either_run_catches_is_caught() {
        let mut both = Outcome { caught: ["a".into()].into(), survived: ["b".into(), "c".into()].into() };
        let second = Outcome { caught: ["b".into()].into(), survived: ["a".into(), "c".into()].into() };

        both.join(second);

        let expected = Outcome { caught: ["a".into(), "b".into()].into(), survived: ["c".into()].into() };
        assert_eq!(both, expected);
    }

    #[test]
    fn none_may_survive_in_parser_buses_and_bridge() {
        for file in ["protocol/src/frame/parser.rs", "buses/modbus/src/pdu.rs", "bridge-fw/src/bridge.rs"] {
            assert!(
                !is_fine(&survived(&[&format!("{file}:12:5: replace + with - in push")]), false),
                "{file}"
            );
        }
    }

    #[test]
    fn elsewhere_five_percent_may_survive() {
        let names: Vec<String> = (0..6).map(|n| format!("protocol/src/gcl.rs:{n}:1: mutant {n}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();

        assert!(is_fine(&survived(&names[..5]), true));
        assert!(!is_fine(&survived(&names), true));
    }

    #[test]
    fn a_run_without_a_mutant_proves_nothing() {
        assert!(!is_fine(&Outcome::default(), false));
    }
}
