//! Mutants of the protocol crate, of the buses and of the bridge's library: which changes of the code no test notices.

mod accepted;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use anyhow::{Context, Result, bail, ensure};

use crate::{
    process,
    tool::{self, CARGO_MUTANTS},
    workspace::Workspace,
};
use accepted::Accepted;

/// Where no mutant may survive that is not accepted.
const ALL_CAUGHT_IN: [&str; 7] = [
    "protocol/src/checksum.rs",
    "protocol/src/frame",
    "protocol/src/can",
    "fieldbus/",
    "protocol/src/session",
    "buses/",
    "bridge-fw/src/",
];

/// How many must be caught of all, in percent.
const CAUGHT_PERCENT: usize = 95;

/// Mutants that are made in one run of cargo-mutants, and what notices them.
struct Part {
    name: &'static str,
    package: &'static str,
    /// The folder whose files it takes.
    folder: &'static str,
    /// Options to cargo-mutants: which mutants of them, and how they are built.
    options: &'static [&'static str],
    /// Arguments to `cargo test`. The examples in documents notice nothing more, and linking them takes the time again.
    tests: &'static [&'static str],
}

/// The reader of decimal fractions is apart: its tests take as long as all others and notice nothing elsewhere.
const DECIMAL: &str = "^protocol/src/gcl/decimal";

/// What has all its tests in the crate itself, and needs no other to be built and linked each time.
const SESSION: &str = "^protocol/src/session";

const PARTS: [Part; 11] = [
    Part {
        name: "protocol",
        package: "wsg-protocol",
        folder: "protocol/",
        options: &["--exclude-re", DECIMAL, "--exclude-re", SESSION],
        tests: &["--lib", "--test=drivers", "--test=gcl", "--test=hashes", "--", "--skip", "gcl::decimal"],
    },
    Part {
        name: "session",
        package: "wsg-protocol",
        folder: "protocol/",
        options: &["--re", SESSION],
        // Those of GCL's session as well: both run on one engine.
        tests: &["--lib", "--test=hashes", "--", "--skip", "gcl::decimal"],
    },
    Part {
        name: "decimal",
        package: "wsg-protocol",
        folder: "protocol/",
        options: &["--re", DECIMAL],
        tests: &["--lib", "--test=gcl"],
    },
    // What is only there with the feature is noticed only with it; what either run notices is noticed.
    Part {
        name: "small-table",
        package: "wsg-protocol",
        folder: "protocol/",
        options: &["--features", "small-table", "--re", "^protocol/src/checksum.*(lookup|chunk)::"],
        tests: &["--lib"],
    },
    Part {
        name: "fieldbus",
        package: "wsg-fieldbus",
        folder: "fieldbus/",
        options: &[],
        tests: &["--lib", "--tests"],
    },
    Part { name: "modbus", package: "bus-modbus", folder: "buses/modbus/", options: &[], tests: &["--lib"] },
    Part { name: "slcan", package: "bus-slcan", folder: "buses/slcan/", options: &[], tests: &["--lib"] },
    Part {
        name: "canopen",
        package: "bus-canopen",
        folder: "buses/canopen/",
        options: &[],
        tests: &["--lib"],
    },
    Part {
        name: "profibus",
        package: "bus-profibus",
        folder: "buses/profibus/",
        options: &[],
        tests: &["--lib"],
    },
    Part {
        name: "profinet",
        package: "bus-profinet",
        folder: "buses/profinet/",
        options: &[],
        tests: &["--lib"],
    },
    // A board's registers are tested by the image in the emulator.
    Part {
        name: "bridge-fw",
        package: "wsg-bridge-fw",
        folder: "bridge-fw/",
        // Only `cargo xtask loom` compiles the models. The tests in virtual time are those of the harness.
        options: &["--exclude", "**/model.rs", "--test-package", "wsg-bridge-fw,host-tests"],
        tests: &[
            "--lib",
            "--test=bridge",
            "--test=can_bus",
            "--test=gripper_link",
            "--test=register_table",
            "--test=rtu_port",
            "--test=uart_*",
        ],
    },
];

/// The tests as they are in `cargo xtask test`, with as many cases; but the same in each run, and a case that fails is
/// neither made smaller nor kept for the next mutant.
const ENVIRONMENT: [(&str, &str); 4] = [
    ("PROPTEST_RNG_SEED", "1"),
    ("PROPTEST_MAX_SHRINK_ITERS", "0"),
    ("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "true"),
    ("CARGO_INCREMENTAL", "1"),
];

/// Files by path below the root, as they were when the mutants were made of them.
type Sources = BTreeMap<String, String>;

/// What became of the mutants, each a line of cargo-mutants.
#[derive(Debug, Default, PartialEq)]
struct Outcome {
    caught: BTreeSet<String>,
    survived: BTreeSet<String>,
}

/// Which mutants to make.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Extent {
    /// Files, or patterns of files; none for all.
    pub(crate) files: Vec<String>,
    /// `K/N`: every N-th, from the K-th on: a sample of them all.
    pub(crate) shard: Option<String>,
    /// Not those that the run before has caught.
    pub(crate) again: bool,
    /// How many at a time; one if not given.
    pub(crate) jobs: Option<usize>,
}

/// Makes the mutants, and holds the survivors to the accepted ones.
pub(crate) fn run(workspace: &Workspace, extent: &Extent) -> Result<()> {
    let accepted = Accepted::read(&workspace.root)?;
    // Before it takes hours in which somebody edits.
    let sources = accepted::sources(&workspace.root)?;
    accepted.hold_to(&sources)?;
    CARGO_MUTANTS.require(workspace, "the mutants of protocol, buses and bridge")?;
    let mut outcome = Outcome::default();
    for part in &PARTS {
        let files: Vec<&String> = extent.files.iter().filter(|file| file.starts_with(part.folder)).collect();
        if extent.files.is_empty() || !files.is_empty() {
            outcome.join(make(workspace, part, &files, extent)?);
        }
    }
    let is_whole = extent.files.is_empty() && extent.shard.is_none();
    judge(&outcome, &accepted, &sources, is_whole)
}

/// One run of cargo-mutants.
fn make(workspace: &Workspace, part: &Part, files: &[&String], extent: &Extent) -> Result<Outcome> {
    let output = workspace.target_dir.join("mutants").join(part.name);
    fs::create_dir_all(&output).with_context(|| format!("cannot make {}", output.display()))?;
    let mut mutants = tool::plain(workspace, &["cargo", "mutants", "-p", part.package, "--no-shuffle"]);
    mutants.args(["--profile", "mutants", "--cargo-arg=--locked"]).envs(ENVIRONMENT);
    mutants.arg("--output").arg(&output).args(["--colors", "never"]);
    mutants.args(["--jobs", &extent.jobs.unwrap_or(1).to_string()]);
    // Many times what the tests take unchanged: a busy machine must not be taken for a mutant that hangs.
    mutants.args(["--timeout-multiplier", "6", "--minimum-test-timeout", "20"]);
    mutants.args(files.iter().flat_map(|file| ["--file", file]));
    if let Some(shard) = &extent.shard {
        mutants.args(["--sharding", "round-robin", "--shard", shard]);
    }
    if extent.again {
        mutants.arg("--iterate");
    }
    // What the tests are made of is no part of the crate.
    mutants.args(["--exclude", "**/tests/**", "--exclude", "**/*tests.rs"]).args(part.options);
    let status = process::run_for_status(mutants.arg("--").args(part.tests))?;
    // 2: mutants survived; 3: some ran out of time, which counts as noticed.
    ensure!(matches!(status.code(), Some(0 | 2 | 3)), "cargo-mutants itself failed ({status})");
    outcome(&output.join("mutants.out"))
}

fn outcome(folder: &Path) -> Result<Outcome> {
    let mut caught = BTreeSet::new();
    for name in ["caught.txt", "timeout.txt", "previously_caught.txt"] {
        caught.extend(lines(&folder.join(name))?);
    }
    Ok(Outcome { caught, survived: lines(&folder.join("missed.txt"))?.into_iter().collect() })
}

/// The lines of a file; none if it is not there, as when no mutant was made.
fn lines(path: &Path) -> Result<Vec<String>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(text.lines().map(str::to_owned).collect())
}

impl Outcome {
    /// With another run: what either has caught is caught.
    fn join(&mut self, other: Self) {
        self.caught.extend(other.caught);
        self.survived.extend(other.survived);
        self.survived.retain(|mutant| !self.caught.contains(mutant));
    }
}

fn judge(outcome: &Outcome, accepted: &Accepted, sources: &Sources, is_whole: bool) -> Result<()> {
    let mut open = Vec::new();
    for mutant in &outcome.survived {
        match accepted.reason(mutant, sources) {
            Some(reason) => println!("  accepted: {mutant} ({reason})"),
            None => {
                println!("  SURVIVED: {mutant}");
                open.push(mutant);
            }
        }
    }
    let caught = outcome.caught.len();
    let made = caught + outcome.survived.len();
    ensure!(made > 0, "no mutant was made: are these files of protocol, buses or bridge-fw?");
    let settled = made - open.len();
    println!("mutants: {caught} of {made} caught, {} accepted, {} survived", settled - caught, open.len());
    if is_whole {
        for entry in accepted.unused(&outcome.survived, sources) {
            println!("  STALE: {entry} has not survived, so it need not be accepted");
        }
    }
    let must = |mutant: &&&String| ALL_CAUGHT_IN.iter().any(|place| mutant.starts_with(place));
    let count = open.iter().filter(must).count();
    if let Some(first) = open.iter().find(must) {
        bail!("{count} survive where none may, the first: {first}");
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
        judge(outcome, &Accepted::default(), &Sources::new(), is_whole).is_ok()
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
