//! Mutants of the protocol crate: which changes of the code no test notices.

mod record;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use anyhow::{Context, Result, bail, ensure};

use crate::{
    figures, process,
    tool::{self, CARGO_MUTANTS},
    workspace::Workspace,
};
use record::{Record, Sources};

pub(crate) use record::rows;

/// Survivors that are accepted, a name and a reason each.
const ACCEPTED: &str = "xtask/mutants-accepted.txt";

/// Where no mutant may survive that is not accepted.
const ALL_CAUGHT_IN: [&str; 3] = ["protocol/src/checksum.rs", "protocol/src/frame/", "protocol/src/can"];

/// How many must be caught of all, in percent.
const CAUGHT_PERCENT: usize = 95;

/// The file that the feature `small-table` changes, and the options that leave only what it changes there.
const OF_SMALL_TABLE: &str = "protocol/src/checksum.rs";
const SMALL_TABLE: [&str; 6] = ["--features", "small-table", "--re", "lookup::|chunk::", "--", "--lib"];

/// The crate's own tests. Those of its documents and examples notice nothing more, and linking them takes the time again.
const TESTS: [&str; 4] = ["--", "--lib", "--test=drivers", "--test=gcl"];

/// The reader of decimal fractions, whose tests take as long as all others and notice nothing elsewhere.
const DECIMAL: &str = "protocol/src/gcl/decimal.rs";
const WITHOUT_DECIMAL: [&str; 3] = ["--", "--skip", "gcl::decimal"];

/// The tests as they are in `cargo xtask test`, with as many cases; but the same in each run, and a case that fails is
/// neither made smaller nor kept for the next mutant.
const ENVIRONMENT: [(&str, &str); 4] = [
    ("PROPTEST_RNG_SEED", "1"),
    ("PROPTEST_MAX_SHRINK_ITERS", "0"),
    ("PROPTEST_DISABLE_FAILURE_PERSISTENCE", "true"),
    ("CARGO_INCREMENTAL", "1"),
];

/// Why a survivor is accepted, by its name.
type Accepted = BTreeMap<String, String>;

/// What became of the mutants, each a line of cargo-mutants.
#[derive(Debug, Default, PartialEq)]
struct Outcome {
    caught: BTreeSet<String>,
    survived: BTreeSet<String>,
}

/// Which mutants to make.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Extent {
    /// Files of the crate; none for all.
    pub(crate) files: Vec<String>,
    /// `K/N`: every N-th, from the K-th on: a sample of them all.
    pub(crate) shard: Option<String>,
    /// Only what has survived before.
    pub(crate) again: bool,
    /// How many at a time; one if not given.
    pub(crate) jobs: Option<usize>,
}

impl Extent {
    fn is_whole(&self) -> bool {
        self.files.is_empty()
    }
}

/// Makes the mutants, and holds the survivors to the accepted ones.
pub(crate) fn run(workspace: &Workspace, extent: &Extent) -> Result<()> {
    let accepted = read_accepted(&workspace.root)?;
    CARGO_MUTANTS.require(workspace, "the mutants of wsg-protocol")?;
    // Before it takes hours in which somebody edits.
    let sources = Sources::read(&workspace.root)?;
    let run_over = |file: &str| extent.is_whole() || extent.files.iter().any(|named| named == file);
    let jobs = extent.jobs.unwrap_or(1).to_string();
    let outcome = if extent.again {
        let left = Record::read(&workspace.root)?.survived(&accepted, &sources, run_over);
        ensure!(!left.is_empty(), "no survivor is known of these files as they are now");
        let files: BTreeSet<&str> = left.iter().map(|mutant| record::file_of(mutant)).collect();
        let mut outcome = find(workspace, &jobs, &Vec::from_iter(files), &these(&left))?;
        outcome.only(&left);
        outcome
    } else {
        let sample = match &extent.shard {
            Some(shard) => ["--sharding", "round-robin", "--shard", shard].map(str::to_owned).to_vec(),
            None => vec![],
        };
        find(workspace, &jobs, &extent.files.iter().map(String::as_str).collect::<Vec<_>>(), &sample)?
    };
    let mut record = Record::read(&workspace.root)?;
    if extent.again {
        record.catch(&outcome.caught);
    } else {
        record.take(&outcome, extent.shard.as_deref(), &sources, run_over);
    }
    record.write(&workspace.root, &accepted)?;
    figures::write_mutants(workspace)?;
    println!("{}, docs/figures.md and README.md are written", record::DOCUMENT);
    judge(&outcome, &accepted, extent.is_whole() && !extent.again)
}

/// Makes the mutants of these files (none: of all) that the options leave.
fn find(workspace: &Workspace, jobs: &str, files: &[&str], options: &[String]) -> Result<Outcome> {
    let is_whole = files.is_empty();
    let options: Vec<&str> = ["--jobs", jobs].into_iter().chain(options.iter().map(String::as_str)).collect();
    let (decimal, others): (Vec<&str>, Vec<&str>) = files.iter().partition(|file| **file == DECIMAL);
    let mut outcome = Outcome::default();
    if is_whole || !others.is_empty() {
        // A pattern may mean that file as well: then it stays, with its tests.
        let (without, skipped): (&[&str], &[&str]) = if others.iter().any(|file| file.contains('*')) {
            (&[], &[])
        } else {
            (&["--exclude", DECIMAL], &WITHOUT_DECIMAL)
        };
        outcome.join(make(workspace, "all", &others, &[&options, without, &TESTS, skipped].concat())?);
    }
    if is_whole || !decimal.is_empty() {
        outcome.join(make(workspace, "decimal", &[DECIMAL], &[&options, &TESTS[..]].concat())?);
    }
    if is_whole || others.iter().any(|file| file.contains(OF_SMALL_TABLE)) {
        // What is only there with the feature is noticed only with it; what either run notices is noticed.
        let options = [&["--jobs", jobs], &SMALL_TABLE[..]].concat();
        outcome.join(make(workspace, "small-table", &[OF_SMALL_TABLE], &options)?);
    }
    Ok(outcome)
}

/// Options that leave these mutants.
fn these(mutants: &BTreeSet<String>) -> Vec<String> {
    mutants.iter().flat_map(|mutant| ["--re".to_owned(), exactly(mutant)]).collect()
}

/// The regular expression of this mutant alone.
fn exactly(mutant: &str) -> String {
    let mut expression = "^".to_owned();
    for c in mutant.chars() {
        if r"\.+*?()|[]{}^$#&-~".contains(c) {
            expression.push('\\');
        }
        expression.push(c);
    }
    expression + "$"
}

/// One run of cargo-mutants.
fn make(workspace: &Workspace, name: &str, files: &[&str], options: &[&str]) -> Result<Outcome> {
    let output = workspace.target_dir.join("mutants").join(name);
    fs::create_dir_all(&output).with_context(|| format!("cannot make {}", output.display()))?;
    let mut mutants = tool::plain(workspace, &["cargo", "mutants", "-p", "wsg-protocol", "--no-shuffle"]);
    mutants.args(["--profile", "mutants"]).envs(ENVIRONMENT);
    mutants.arg("--output").arg(&output).args(["--colors", "never"]);
    // Many times what the tests take unchanged: a busy machine must not be taken for a mutant that hangs.
    mutants.args(["--timeout-multiplier", "6", "--minimum-test-timeout", "20"]);
    mutants.args(files.iter().flat_map(|file| ["--file", file]));
    // What the tests are made of is no part of the crate.
    mutants.args(["--exclude", "**/tests/**", "--exclude", "**/*tests.rs"]).args(options);
    let status = process::run_for_status(&mut mutants)?;
    // 2: mutants survived; 3: some ran out of time, which counts as noticed.
    ensure!(matches!(status.code(), Some(0 | 2 | 3)), "cargo-mutants itself failed ({status})");
    outcome(&output.join("mutants.out"))
}

fn outcome(folder: &Path) -> Result<Outcome> {
    let lines = |name: &str| {
        let text = read(&folder.join(name))?;
        Ok::<_, anyhow::Error>(text.lines().map(str::to_owned).collect::<BTreeSet<_>>())
    };
    let mut caught = lines("caught.txt")?;
    caught.extend(lines("timeout.txt")?);
    Ok(Outcome { caught, survived: lines("missed.txt")? })
}

impl Outcome {
    /// Of these mutants: cargo-mutants makes more than it is asked for, where a field is left out of a struct.
    fn only(&mut self, these: &BTreeSet<String>) {
        self.caught.retain(|mutant| these.contains(mutant));
        self.survived.retain(|mutant| these.contains(mutant));
    }

    /// With another run: what either has caught is caught.
    fn join(&mut self, other: Self) {
        self.caught.extend(other.caught);
        self.survived.extend(other.survived);
        self.survived.retain(|mutant| !self.caught.contains(mutant));
    }
}

/// A mutant without line and column, which every edit above it changes.
fn name_of(line: &str) -> String {
    let mut parts = line.splitn(4, ':');
    match (parts.next(), parts.next(), parts.next(), parts.next()) {
        (Some(file), Some(_), Some(_), Some(what)) => format!("{file}:{what}"),
        _ => line.to_owned(),
    }
}

fn read_accepted(root: &Path) -> Result<Accepted> {
    accepted(&read(&root.join(ACCEPTED))?)
}

/// Lines of a mutant's name, ` -- ` and the reason.
fn accepted(text: &str) -> Result<Accepted> {
    let lines = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines
        .map(|line| {
            let (name, reason) =
                line.split_once(" -- ").with_context(|| format!("no reason in {ACCEPTED}: {line}"))?;
            Ok((name.to_owned(), reason.to_owned()))
        })
        .collect()
}

fn judge(outcome: &Outcome, accepted: &Accepted, is_whole: bool) -> Result<()> {
    let mut open = Vec::new();
    for mutant in &outcome.survived {
        let name = name_of(mutant);
        match accepted.get(&name) {
            Some(reason) => println!("  accepted: {name} ({reason})"),
            None => {
                println!("  SURVIVED: {mutant}");
                open.push(name);
            }
        }
    }
    let caught = outcome.caught.len();
    let made = caught + outcome.survived.len();
    ensure!(made > 0, "no mutant was made: are these files of protocol/src?");
    let settled = made - open.len();
    println!("mutants: {caught} of {made} caught, {} accepted, {} survived", settled - caught, open.len());
    if let Some(name) = open.iter().find(|name| ALL_CAUGHT_IN.iter().any(|place| name.starts_with(place))) {
        bail!("a mutant survives where none may: {name}");
    }
    if is_whole && settled * 100 < made * CAUGHT_PERCENT {
        bail!("less than {CAUGHT_PERCENT} % of the mutants are caught");
    }
    Ok(())
}

fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn survived(names: &[&str]) -> Outcome {
        let caught = (0..99).map(|n| format!("protocol/src/x.rs:{n}:1: caught")).collect();
        Outcome { caught, survived: names.iter().map(|name| (*name).to_owned()).collect() }
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
    fn a_survivor_in_the_parser_fails_and_an_accepted_one_does_not() {
        let line = "protocol/src/frame/parser.rs:12:5: replace + with - in push";
        let name = name_of(line);
        assert_eq!(name, "protocol/src/frame/parser.rs: replace + with - in push");

        let none = BTreeMap::new();
        let accepted = accepted(&format!("# why\n\n{name} -- both do the same\n")).unwrap();

        assert!(judge(&survived(&[line]), &none, false).is_err());
        assert!(judge(&survived(&[line]), &accepted, false).is_ok());
    }

    #[test]
    fn elsewhere_five_percent_may_survive() {
        let names: Vec<String> =
            (0..6).map(|n| format!("protocol/src/session.rs:{n}:1: mutant {n}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();

        assert!(judge(&survived(&names[..5]), &BTreeMap::new(), true).is_ok());
        assert!(judge(&survived(&names), &BTreeMap::new(), true).is_err());
    }

    #[test]
    fn every_character_of_a_mutant_stands_for_itself() {
        let mutant = "protocol/src/gcl/x.rs:7:1: replace | with ^ in Line<N>::of -> &[u8]";
        assert_eq!(
            exactly(mutant),
            r"^protocol/src/gcl/x\.rs:7:1: replace \| with \^ in Line<N>::of \-> \&\[u8\]$"
        );
    }

    #[test]
    fn a_name_without_a_reason_is_refused() {
        assert!(accepted("protocol/src/frame/parser.rs: replace + with -").is_err());
    }
}
