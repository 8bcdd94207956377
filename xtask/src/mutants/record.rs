//! docs/mutants.txt: what was found in each file, kept from run to run, and the rows of the figures that follow from it.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use sha2::{Digest, Sha256};

use super::{ALL_CAUGHT_IN, Accepted, CAUGHT_PERCENT, Outcome, name_of};

/// Where it is kept.
pub(crate) const DOCUMENT: &str = "docs/mutants.txt";

const WHOLE: &str = "whole";
const ACCEPTED: &str = "accepted";
const SURVIVED: &str = "survived";

/// Where the changed files are.
const SOURCES: &str = "protocol/src";

const HEAD: &str = "\
# Mutants of wsg-protocol, file by file. `cargo xtask mutants` writes a line for each file that it was run over.
# source: the first digits of the file's SHA-256 when it was; another one now means that the line is older than the file.
# extent: `whole`, or K/N for every N-th mutant from the K-th on.
# accepted: not caught, with the reason in xtask/mutants-accepted.txt. survived: not caught, and nobody has said why. Both
# by name below the file; `cargo xtask mutants --again` tries what has survived once more.

#   made caught accepted survived extent source   file
";

/// What was found in one file.
#[derive(Clone, Debug, Default, PartialEq)]
struct Line {
    caught: usize,
    /// Not caught: mutants as cargo-mutants names them.
    left: BTreeSet<String>,
    /// `None` for all mutants of the file.
    sample: Option<String>,
    source: String,
}

/// Lines by file.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Record(BTreeMap<String, Line>);

/// The files that mutants may be made of, with what stands for their content.
#[derive(Debug, Default)]
pub(super) struct Sources(BTreeMap<String, String>);

impl Line {
    fn made(&self) -> usize {
        self.caught + self.left.len()
    }

    fn accepted(&self, accepted: &Accepted) -> usize {
        self.left.iter().filter(|mutant| accepted.contains_key(&name_of(mutant))).count()
    }
}

impl Sources {
    /// As they are now, below the workspace's root.
    pub(super) fn read(root: &Path) -> Result<Self> {
        let mut sources = BTreeMap::new();
        let mut folders = vec![PathBuf::from(SOURCES)];
        while let Some(folder) = folders.pop() {
            let entries = fs::read_dir(root.join(&folder));
            for entry in entries.with_context(|| format!("cannot read {}", folder.display()))? {
                let path = folder.join(entry?.file_name());
                let name = path.to_string_lossy().into_owned();
                if root.join(&path).is_dir() {
                    folders.push(path);
                } else if name.ends_with(".rs") && !name.ends_with("tests.rs") && !name.contains("/tests/") {
                    let text = fs::read(root.join(&path)).with_context(|| format!("cannot read {name}"))?;
                    let digest = Sha256::digest(&text);
                    sources.insert(name, digest.iter().take(4).map(|byte| format!("{byte:02x}")).collect());
                }
            }
        }
        Ok(Self(sources))
    }
}

impl Record {
    /// What is kept; nothing where there is no document yet.
    pub(super) fn read(root: &Path) -> Result<Self> {
        match fs::read_to_string(root.join(DOCUMENT)) {
            Ok(text) => Self::parse(&text),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(error).with_context(|| format!("cannot read {DOCUMENT}")),
        }
    }

    fn parse(text: &str) -> Result<Self> {
        let mut record = Self::default();
        let mut last: Option<&str> = None;
        for line in text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
            let not_a_line = || format!("not a line of {DOCUMENT}: {line}");
            if let Some((ACCEPTED | SURVIVED, mutant)) = line.trim_start().split_once(' ') {
                let left = last.and_then(|file| record.0.get_mut(file));
                left.with_context(not_a_line)?.left.insert(mutant.to_owned());
                continue;
            }
            let words: Vec<&str> = line.split_whitespace().collect();
            let [_, caught, _, _, extent, source, file] = words[..] else { bail!(not_a_line()) };
            record.0.insert(
                file.to_owned(),
                Line {
                    caught: caught.parse().with_context(not_a_line)?,
                    left: BTreeSet::new(),
                    sample: (extent != WHOLE).then(|| extent.to_owned()),
                    source: source.to_owned(),
                },
            );
            last = Some(file);
        }
        Ok(record)
    }

    /// Writes it where it is kept.
    pub(super) fn write(&self, root: &Path, accepted: &Accepted) -> Result<()> {
        fs::write(root.join(DOCUMENT), self.text(accepted))
            .with_context(|| format!("cannot write {DOCUMENT}"))
    }

    fn text(&self, accepted: &Accepted) -> String {
        let mut text = HEAD.to_owned();
        for (file, line) in &self.0 {
            let Line { caught, left, sample, source } = line;
            let (made, extent) = (line.made(), sample.as_deref().unwrap_or(WHOLE));
            let settled = line.accepted(accepted);
            let open = left.len() - settled;
            text.push_str(&format!(
                "{made:>8} {caught:>6} {settled:>8} {open:>8} {extent:>6} {source} {file}\n"
            ));
            for mutant in left {
                let word = if accepted.contains_key(&name_of(mutant)) { ACCEPTED } else { SURVIVED };
                text.push_str(&format!("         {word} {mutant}\n"));
            }
        }
        text
    }

    /// Takes over what a run found, with the sources as they were when it began, of which `run_over` says which it took.
    pub(super) fn take(
        &mut self,
        outcome: &Outcome,
        sample: Option<&str>,
        sources: &Sources,
        run_over: impl Fn(&str) -> bool,
    ) {
        let mut found: BTreeMap<&str, Line> = BTreeMap::new();
        for file in sources.0.keys().filter(|file| run_over(file)) {
            found.entry(file).or_default();
        }
        for mutant in &outcome.caught {
            found.entry(file_of(mutant)).or_default().caught += 1;
        }
        for mutant in &outcome.survived {
            found.entry(file_of(mutant)).or_default().left.insert(mutant.clone());
        }
        for (file, mut line) in found {
            let Some(source) = sources.0.get(file) else { continue };
            line.source.clone_from(source);
            line.sample = sample.map(str::to_owned);
            let says_more =
                self.0.get(file).is_some_and(|kept| kept.sample.is_none() && kept.source == *source);
            if line.sample.is_none() || !says_more {
                self.0.insert(file.to_owned(), line);
            }
        }
        self.0.retain(|file, _| sources.0.contains_key(file));
    }

    /// What has survived in the files that are still the same and that `run_over` chooses.
    pub(super) fn survived(
        &self,
        accepted: &Accepted,
        sources: &Sources,
        run_over: impl Fn(&str) -> bool,
    ) -> BTreeSet<String> {
        let same = self.0.iter().filter(|(file, line)| sources.0.get(*file) == Some(&line.source));
        same.filter(|(file, _)| run_over(file))
            .flat_map(|(_, line)| &line.left)
            .filter(|mutant| !accepted.contains_key(&name_of(mutant)))
            .cloned()
            .collect()
    }

    /// Of what has survived, this is caught now.
    pub(super) fn catch(&mut self, caught: &BTreeSet<String>) {
        for line in self.0.values_mut() {
            let before = line.left.len();
            line.left.retain(|mutant| !caught.contains(mutant));
            line.caught += before - line.left.len();
        }
    }

    /// Rows of the figures' table: what, measured, limit.
    fn rows(&self, sources: &Sources, accepted: &Accepted) -> String {
        let must = |file: &str| ALL_CAUGHT_IN.iter().any(|place| file.starts_with(place));
        let row = |what: &str, limit: usize, chosen: &dyn Fn(&str) -> bool| {
            let lines = || self.0.iter().filter(|(file, _)| chosen(file)).map(|(_, line)| line);
            let made: usize = lines().map(Line::made).sum();
            let caught: usize = lines().map(|line| line.caught).sum();
            let more: usize = lines().map(|line| line.accepted(accepted)).sum();
            let settled = caught + more;
            let mut text = format!("{caught} of {made}, {more} more accepted");
            let mut remark = |count: usize, what: &str| {
                if count > 0 {
                    text.push_str(&format!("; {count} {} {what}", if count == 1 { "file" } else { "files" }));
                }
            };
            let chosen_sources = || sources.0.iter().filter(|(file, _)| chosen(file));
            remark(lines().filter(|line| line.sample.is_some()).count(), "only by a sample");
            remark(
                chosen_sources()
                    .filter(|(file, source)| self.0.get(*file).is_some_and(|line| line.source != **source))
                    .count(),
                "changed since",
            );
            remark(chosen_sources().filter(|(file, _)| !self.0.contains_key(*file)).count(), "not run");
            let missed = if settled * 100 >= made * limit { "" } else { ", **missed**" };
            format!("| {what} | {text} | {limit} %{missed} |\n")
        };
        row("mutants caught in checksum, frame and CAN", 100, &must)
            + &row("mutants caught, protocol crate", CAUGHT_PERCENT, &|_| true)
    }
}

/// Rows of the figures' table that follow from what is kept.
pub(crate) fn rows(root: &Path) -> Result<String> {
    Ok(Record::read(root)?.rows(&Sources::read(root)?, &super::read_accepted(root)?))
}

pub(super) fn file_of(mutant: &str) -> &str {
    mutant.split(':').next().unwrap_or(mutant)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAN: &str = "protocol/src/can.rs";
    const SESSION: &str = "protocol/src/session.rs";

    fn sources(list: &[(&str, &str)]) -> Sources {
        Sources(list.iter().map(|(file, source)| ((*file).to_owned(), (*source).to_owned())).collect())
    }

    fn outcome(caught: &[String], survived: &[String]) -> Outcome {
        Outcome { caught: caught.iter().cloned().collect(), survived: survived.iter().cloned().collect() }
    }

    fn mutants(file: &str, lines: std::ops::Range<usize>) -> Vec<String> {
        lines.map(|line| format!("{file}:{line}:1: replace {line}")).collect()
    }

    fn accepting(mutant: &str) -> Accepted {
        [(name_of(mutant), "both do the same".to_owned())].into()
    }

    #[test]
    fn a_run_over_one_file_leaves_the_lines_of_the_others() {
        let sources = sources(&[(CAN, "aa"), (SESSION, "bb")]);
        let (can, session) = (mutants(CAN, 0..3), mutants(SESSION, 0..4));
        let mut record = Record::default();
        record.take(&outcome(&can[..2], &can[2..]), None, &sources, |file| file == CAN);

        record.take(&outcome(&session[1..], &session[..1]), None, &sources, |file| file == SESSION);

        let accepted = accepting(&session[0]);
        assert_eq!(
            record.text(&accepted).strip_prefix(HEAD).unwrap(),
            "       3      2        0        1  whole aa protocol/src/can.rs\n\
             \u{20}        survived protocol/src/can.rs:2:1: replace 2\n\
             \u{20}      4      3        1        0  whole bb protocol/src/session.rs\n\
             \u{20}        accepted protocol/src/session.rs:0:1: replace 0\n"
        );
        assert_eq!(Record::parse(&record.text(&accepted)).unwrap(), record);
        assert!(Record::parse("       3      2        0        1  whole aa").is_err());
    }

    #[test]
    fn a_sample_does_not_take_the_place_of_a_whole_run_over_the_same_source() {
        let can = mutants(CAN, 0..4);
        let (whole, sample) = (outcome(&can, &[]), outcome(&can[..1], &[]));
        let mut record = Record::default();
        record.take(&whole, None, &sources(&[(CAN, "aa")]), |_| true);

        record.take(&sample, Some("0/4"), &sources(&[(CAN, "aa")]), |_| true);
        assert_eq!(record.0[CAN].made(), 4);

        record.take(&sample, Some("0/4"), &sources(&[(CAN, "cc")]), |_| true);
        assert_eq!((record.0[CAN].made(), record.0[CAN].sample.as_deref()), (1, Some("0/4")));
    }

    #[test]
    fn a_file_that_is_gone_has_no_line_and_one_without_mutants_has() {
        let mut record = Record::default();
        record.take(&outcome(&mutants(CAN, 0..1), &[]), None, &sources(&[(CAN, "aa")]), |_| true);

        record.take(&outcome(&[], &[]), None, &sources(&[(SESSION, "bb")]), |_| true);

        assert_eq!(record.0.keys().collect::<Vec<_>>(), [SESSION]);
        assert_eq!(record.0[SESSION].made(), 0);
    }

    #[test]
    fn what_has_survived_is_tried_again_where_the_file_is_the_same_and_nobody_accepts_it() {
        let (can, session) = (mutants(CAN, 0..4), mutants(SESSION, 0..2));
        let mut record = Record::default();
        let before = sources(&[(CAN, "aa"), (SESSION, "bb")]);
        record.take(&outcome(&session[..1], &session[1..]), None, &before, |file| file == SESSION);
        record.take(&outcome(&can[..1], &can[1..]), None, &before, |file| file == CAN);

        let now = sources(&[(CAN, "aa"), (SESSION, "cc")]);
        let again = record.survived(&accepting(&can[3]), &now, |_| true);
        assert_eq!(again.iter().collect::<Vec<_>>(), [&can[1], &can[2]]);
        assert!(record.survived(&Accepted::new(), &now, |file| file == SESSION).is_empty());

        record.catch(&[can[1].clone()].into());
        assert_eq!((record.0[CAN].caught, record.0[CAN].made(), record.0[SESSION].caught), (2, 4, 1));
    }

    #[test]
    fn the_rows_say_what_is_missed_changed_sampled_or_not_run() {
        let (can, session) = (mutants(CAN, 0..10), mutants(SESSION, 0..90));
        let before = sources(&[(CAN, "aa"), (SESSION, "bb")]);
        let mut record = Record::default();
        record.take(&outcome(&can[1..], &can[..1]), None, &before, |file| file == CAN);
        record.take(&outcome(&session, &[]), Some("1/2"), &before, |file| file == SESSION);

        let now = sources(&[(CAN, "cc"), (SESSION, "bb"), ("protocol/src/time.rs", "dd")]);

        assert_eq!(
            record.rows(&now, &Accepted::new()),
            "| mutants caught in checksum, frame and CAN | 9 of 10, 0 more accepted; 1 file changed since | \
             100 %, **missed** |\n\
             | mutants caught, protocol crate | 99 of 100, 0 more accepted; 1 file only by a sample; 1 file \
             changed since; 1 file not run | 95 % |\n"
        );
    }

    #[test]
    fn an_accepted_survivor_counts_as_settled() {
        let can = mutants(CAN, 0..2);
        let mut record = Record::default();
        let now = sources(&[(CAN, "aa")]);
        record.take(&outcome(&can[1..], &can[..1]), None, &now, |_| true);

        assert!(record.rows(&now, &accepting(&can[0])).starts_with(
            "| mutants caught in checksum, frame and CAN | 1 of 2, 1 more accepted | 100 % |\n"
        ));
    }
}
