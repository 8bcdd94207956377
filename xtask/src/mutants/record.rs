//! docs/mutants.txt: what was found in each file, kept from run to run, and the rows of the figures that follow from it.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use sha2::{Digest, Sha256};

use super::{ALL_CAUGHT_IN, CAUGHT_PERCENT, Outcome, name_of};

/// Where it is kept.
pub(crate) const DOCUMENT: &str = "docs/mutants.txt";

/// Where the changed files are.
const SOURCES: &str = "protocol/src";

const HEAD: &str = "\
# Mutants of wsg-protocol, file by file. `cargo xtask mutants` writes a line for each file that it was run over.
# source: the first digits of the file's SHA-256 when it was; another one now means that the line is older than the file.
# extent: `whole`, or K/N for every N-th mutant from the K-th on.
# accepted: not caught, with the reason in xtask/mutants-accepted.txt. survived: not caught, and nobody has said why.

#   made caught accepted survived extent source   file
";

/// What was found in one file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Line {
    caught: usize,
    accepted: usize,
    survived: usize,
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
        self.caught + self.accepted + self.survived
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
        let lines = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
        let line = |line: &str| {
            let [_, caught, accepted, survived, extent, source, file] =
                line.split_whitespace().collect::<Vec<_>>().try_into().ok()?;
            let line = Line {
                caught: str::parse(caught).ok()?,
                accepted: str::parse(accepted).ok()?,
                survived: str::parse(survived).ok()?,
                sample: (extent != "whole").then(|| extent.to_owned()),
                source: source.to_owned(),
            };
            Some((file.to_owned(), line))
        };
        lines
            .map(|it| line(it).with_context(|| format!("not a line of {DOCUMENT}: {it}")))
            .collect::<Result<_>>()
            .map(Self)
    }

    /// Writes it where it is kept.
    pub(super) fn write(&self, root: &Path) -> Result<()> {
        fs::write(root.join(DOCUMENT), self.text()).with_context(|| format!("cannot write {DOCUMENT}"))
    }

    fn text(&self) -> String {
        let mut text = HEAD.to_owned();
        for (file, line) in &self.0 {
            let (made, extent) = (line.made(), line.sample.as_deref().unwrap_or("whole"));
            let Line { caught, accepted, survived, source, .. } = line;
            text.push_str(&format!(
                "{made:>8} {caught:>6} {accepted:>8} {survived:>8} {extent:>6} {source} {file}\n"
            ));
        }
        text
    }

    /// Takes over what a run found, with the sources as they were when it began, of which `run_over` says which it took.
    pub(super) fn take(
        &mut self,
        outcome: &Outcome,
        accepted: &BTreeMap<String, String>,
        sample: Option<&str>,
        sources: &Sources,
        run_over: impl Fn(&str) -> bool,
    ) {
        let file_of = |mutant: &str| mutant.split(':').next().unwrap_or(mutant).to_owned();
        let mut found: BTreeMap<String, Line> = BTreeMap::new();
        for (file, source) in &sources.0 {
            if run_over(file) {
                found.entry(file.clone()).or_default().source.clone_from(source);
            }
        }
        for mutant in &outcome.caught {
            found.entry(file_of(mutant)).or_default().caught += 1;
        }
        for mutant in &outcome.survived {
            let line = found.entry(file_of(mutant)).or_default();
            let count =
                if accepted.contains_key(&name_of(mutant)) { &mut line.accepted } else { &mut line.survived };
            *count += 1;
        }
        for (file, mut line) in found {
            line.source = sources.0.get(&file).cloned().unwrap_or_else(|| "-".to_owned());
            line.sample = sample.map(str::to_owned);
            let kept = self.0.get(&file);
            let says_more = kept.is_some_and(|kept| kept.sample.is_none() && kept.source == line.source);
            if line.sample.is_none() || !says_more {
                self.0.insert(file, line);
            }
        }
        self.0.retain(|file, _| sources.0.contains_key(file));
    }

    /// Rows of the figures' table: what, measured, limit.
    fn rows(&self, sources: &Sources) -> String {
        let must = |file: &str| ALL_CAUGHT_IN.iter().any(|place| file.starts_with(place));
        let row = |what: &str, limit: usize, chosen: &dyn Fn(&str) -> bool| {
            let lines = || self.0.iter().filter(|(file, _)| chosen(file)).map(|(_, line)| line);
            let made: usize = lines().map(Line::made).sum();
            let accepted: usize = lines().map(|line| line.accepted).sum();
            let caught: usize = lines().map(|line| line.caught).sum();
            let settled = caught + accepted;
            let mut text = format!("{caught} of {made}, {accepted} more accepted");
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
    Ok(Record::read(root)?.rows(&Sources::read(root)?))
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

    fn accepting(mutant: &str) -> BTreeMap<String, String> {
        [(name_of(mutant), "both do the same".to_owned())].into()
    }

    #[test]
    fn a_run_over_one_file_leaves_the_lines_of_the_others() {
        let sources = sources(&[(CAN, "aa"), (SESSION, "bb")]);
        let (can, session) = (mutants(CAN, 0..3), mutants(SESSION, 0..4));
        let mut record = Record::default();
        record.take(&outcome(&can[..2], &can[2..]), &BTreeMap::new(), None, &sources, |file| file == CAN);

        record.take(
            &outcome(&session[1..], &session[..1]),
            &accepting(&session[0]),
            None,
            &sources,
            |file| file == SESSION,
        );

        assert_eq!(
            record.text().strip_prefix(HEAD).unwrap(),
            "       3      2        0        1  whole aa protocol/src/can.rs\n\
             \u{20}      4      3        1        0  whole bb protocol/src/session.rs\n"
        );
        assert_eq!(Record::parse(&record.text()).unwrap(), record);
    }

    #[test]
    fn a_sample_does_not_take_the_place_of_a_whole_run_over_the_same_source() {
        let can = mutants(CAN, 0..4);
        let whole = outcome(&can, &[]);
        let sample = outcome(&can[..1], &[]);
        let none = BTreeMap::new();
        let mut record = Record::default();
        record.take(&whole, &none, None, &sources(&[(CAN, "aa")]), |_| true);

        record.take(&sample, &none, Some("0/4"), &sources(&[(CAN, "aa")]), |_| true);
        assert_eq!(record.0[CAN].made(), 4);

        record.take(&sample, &none, Some("0/4"), &sources(&[(CAN, "cc")]), |_| true);
        assert_eq!((record.0[CAN].made(), record.0[CAN].sample.as_deref()), (1, Some("0/4")));
    }

    #[test]
    fn a_file_that_is_gone_has_no_line_and_one_without_mutants_has() {
        let mut record = Record::default();
        let none = BTreeMap::new();
        record.take(&outcome(&mutants(CAN, 0..1), &[]), &none, None, &sources(&[(CAN, "aa")]), |_| true);

        record.take(&outcome(&[], &[]), &none, None, &sources(&[(SESSION, "bb")]), |_| true);

        assert_eq!(record.0.keys().collect::<Vec<_>>(), [SESSION]);
        assert_eq!(record.0[SESSION].made(), 0);
    }

    #[test]
    fn the_rows_say_what_is_missed_changed_sampled_or_not_run() {
        let (can, session) = (mutants(CAN, 0..10), mutants(SESSION, 0..90));
        let before = sources(&[(CAN, "aa"), (SESSION, "bb")]);
        let mut record = Record::default();
        let none = BTreeMap::new();
        record.take(&outcome(&can[1..], &can[..1]), &none, None, &before, |file| file == CAN);
        record.take(&outcome(&session, &[]), &none, Some("1/2"), &before, |file| file == SESSION);

        let rows = record.rows(&sources(&[(CAN, "cc"), (SESSION, "bb"), ("protocol/src/time.rs", "dd")]));

        assert_eq!(
            rows,
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
        record.take(&outcome(&can[1..], &can[..1]), &accepting(&can[0]), None, &now, |_| true);

        assert!(record.rows(&now).starts_with(
            "| mutants caught in checksum, frame and CAN | 1 of 2, 1 more accepted | 100 % |\n"
        ));
    }
}
