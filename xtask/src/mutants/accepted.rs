//! Accepted surviving mutants, listed with line and reason in xtask/mutants-accepted.txt.
//!
//! A mutant is accepted if file, name and text of the line match. The line number is informative, because lines may move. A mutant
//! with the same name in another line is not accepted.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};

const DOCUMENT: &str = "xtask/mutants-accepted.txt";

/// An accepted surviving mutant.
#[derive(Debug)]
struct Entry {
    file: String,
    name: String,
    reason: String,
    /// Text of the mutated line.
    text: String,
    /// The lines of the file, as of the start of the run, because they may be edited during a run of several hours.
    source: Vec<String>,
}

/// The accepted surviving mutants.
#[derive(Debug, Default)]
pub(super) struct Accepted(Vec<Entry>);

impl Accepted {
    /// Reads the list and its sources. Fails if the line of an entry is no longer in its file.
    pub(super) fn read(root: &Path) -> Result<Self> {
        let read =
            |file: &str| fs::read_to_string(root.join(file)).with_context(|| format!("cannot read {file}"));
        Self::parse(&read(DOCUMENT)?, read)
    }

    /// Parses entries of two lines: `FILE:LINE: NAME -- REASON`, and the text of the line, indented. Reports lines that have moved.
    fn parse(text: &str, source: impl Fn(&str) -> Result<String>) -> Result<Self> {
        let mut entries = Vec::new();
        let mut stale = Vec::new();
        let mut lines = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
        while let Some(head) = lines.next() {
            let what_failed = || format!("{DOCUMENT}: not `FILE:LINE: NAME -- REASON`: {head}");
            let (title, reason) = head.split_once(" -- ").with_context(what_failed)?;
            let (place, name) = title.split_once(": ").with_context(what_failed)?;
            let (file, line) = place.split_once(':').with_context(what_failed)?;
            let line: usize = line.parse().with_context(what_failed)?;
            let text = lines.next().and_then(|line| line.strip_prefix(' '));
            let text = text.with_context(|| format!("{DOCUMENT}: missing source line below {head}"))?.trim();
            let source: Vec<String> = source(file)?.lines().map(|line| line.trim().to_owned()).collect();
            match (1..).zip(&source).filter(|(_, it)| *it == text).min_by_key(|(at, _)| line.abs_diff(*at)) {
                Some((at, _)) if at != line => println!("  moved: {title}, to line {at}"),
                Some(_) => {}
                None => stale.push(title),
            }
            let [file, name, reason, text] = [file, name, reason, text].map(str::to_owned);
            entries.push(Entry { file, name, reason, text, source });
        }
        ensure!(
            stale.is_empty(),
            "{DOCUMENT}: these lines are no longer in their files: {}",
            stale.join("; ")
        );
        Ok(Self(entries))
    }

    /// Returns the reason why a mutant is accepted, if it is.
    pub(super) fn reason(&self, mutant: &str) -> Option<&str> {
        self.0.iter().find(|entry| entry.is(mutant)).map(|entry| entry.reason.as_str())
    }
}

impl Entry {
    /// Returns whether the entry matches a mutant, given as `FILE:LINE:COLUMN: NAME`.
    fn is(&self, mutant: &str) -> bool {
        let mut parts = mutant.splitn(4, ':');
        let mut next = || parts.next().unwrap_or_default().trim_start();
        let (file, line, _, name) = (next(), next().parse::<usize>(), next(), next());
        let text = line.ok().and_then(|line| self.source.get(line.checked_sub(1)?));
        self.file == file && self.name == name && text == Some(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACCEPTED: &str =
        "# why\n\nprotocol/src/x.rs:2: replace | with ^ in f -- both give the same\n    a | b\n";

    fn accepted(source: &str) -> Result<Accepted> {
        Accepted::parse(ACCEPTED, |_| Ok(source.to_owned()))
    }

    #[test]
    fn mutant_is_accepted_by_file_name_and_text_on_any_line() {
        let is_accepted = |mutant: &str, source| accepted(source).unwrap().reason(mutant).is_some();
        let source = "// new\nfn f\n  a | b\n  a | c\n";

        assert!(is_accepted("protocol/src/x.rs:2:7: replace | with ^ in f", "fn f\n  a | b\n"));
        assert!(is_accepted("protocol/src/x.rs:3:7: replace | with ^ in f", source));
        assert!(!is_accepted("protocol/src/x.rs:4:7: replace | with ^ in f", source));
        assert!(!is_accepted("protocol/src/x.rs:3:7: replace | with & in f", source));
        assert!(!is_accepted("protocol/src/y.rs:3:7: replace | with ^ in f", source));
    }

    #[test]
    fn entry_is_refused_if_line_reason_or_source_is_missing_or_gone() {
        let refused = |text: &str| Accepted::parse(text, |_| Ok("a - b".to_owned())).unwrap_err().to_string();
        for head in ["x.rs: replace + with - -- why\n a - b", "x.rs:1: replace + with -\n a - b"] {
            assert!(refused(head).contains("not `FILE:LINE: NAME -- REASON`"), "{head}");
        }
        assert!(refused("x.rs:1: replace + with - -- why\n").contains("missing source line"));
        let gone = refused("x.rs:1: replace + with - -- why\n a + b");
        assert!(gone.ends_with("no longer in their files: x.rs:1: replace + with -"), "{gone}");
    }

    /// Detects stale entries here rather than hours later in a run of the mutants.
    #[test]
    fn accepted_lines_are_in_their_files() {
        Accepted::read(Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()).unwrap();
    }
}
