//! Accepted surviving mutants, listed with line and reason in xtask/mutants-accepted.txt.
//!
//! A mutant is accepted if file, name and text of the line match. The line number is informative, because lines may move. A mutant
//! with the same name in another line is not accepted.

use std::{collections::BTreeSet, fs, path::Path};

use anyhow::{Context, Result, bail};

use super::Sources;

const DOCUMENT: &str = "xtask/mutants-accepted.txt";

/// Folders of the mutated sources.
const FOLDERS: [&str; 4] = ["fieldbus/src", "protocol/src", "buses", "bridge-fw/src"];

/// An accepted surviving mutant.
#[derive(Debug, PartialEq)]
struct Entry {
    /// Title in the form `FILE:LINE: NAME`.
    title: String,
    file: String,
    line: usize,
    name: String,
    reason: String,
    /// Text of the mutated line.
    text: String,
}

/// The accepted surviving mutants.
#[derive(Debug, Default)]
pub(super) struct Accepted(Vec<Entry>);

impl Accepted {
    pub(super) fn read(root: &Path) -> Result<Self> {
        Self::parse(
            &fs::read_to_string(root.join(DOCUMENT)).with_context(|| format!("cannot read {DOCUMENT}"))?,
        )
    }

    /// Parses entries of two lines: `FILE:LINE: NAME -- REASON`, and the text of the line, indented.
    fn parse(text: &str) -> Result<Self> {
        let mut entries = Vec::new();
        let mut lines = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
        while let Some(head) = lines.next() {
            let what_failed = || format!("{DOCUMENT}: not `FILE:LINE: NAME -- REASON`: {head}");
            let (title, reason) = head.split_once(" -- ").with_context(what_failed)?;
            let (place, name) = title.split_once(": ").with_context(what_failed)?;
            let (file, line) = place.split_once(':').with_context(what_failed)?;
            let text = lines.next().filter(|line| line.starts_with(' '));
            entries.push(Entry {
                title: title.to_owned(),
                file: file.to_owned(),
                line: line.parse().with_context(what_failed)?,
                name: name.to_owned(),
                reason: reason.to_owned(),
                text: text
                    .with_context(|| format!("{DOCUMENT}: missing source line below {head}"))?
                    .trim()
                    .to_owned(),
            });
        }
        Ok(Self(entries))
    }

    /// Fails if the line of an entry is no longer in its file. Reports lines that have moved.
    pub(super) fn hold_to(&self, sources: &Sources) -> Result<()> {
        let mut stale = Vec::new();
        for entry in &self.0 {
            let lines = || sources.get(&entry.file).into_iter().flat_map(|source| source.lines());
            let is_it = |line: &str| line.trim() == entry.text;
            if lines().nth(entry.line.wrapping_sub(1)).is_some_and(is_it) {
                continue;
            }
            match lines().position(is_it) {
                Some(at) => println!("  moved: {}, to line {}", entry.title, at + 1),
                None => stale.push(entry.title.as_str()),
            }
        }
        if !stale.is_empty() {
            bail!("{DOCUMENT}: these lines are no longer in their files: {}", stale.join("; "));
        }
        Ok(())
    }

    /// Returns the reason why a mutant is accepted, if it is.
    pub(super) fn reason(&self, mutant: &str, sources: &Sources) -> Option<&str> {
        self.0.iter().find(|entry| entry.is(mutant, sources)).map(|entry| entry.reason.as_str())
    }

    /// Returns the entries that match none of the survivors.
    pub(super) fn unused(&self, survived: &BTreeSet<String>, sources: &Sources) -> Vec<&str> {
        let is_unused = |entry: &&Entry| !survived.iter().any(|mutant| entry.is(mutant, sources));
        self.0.iter().filter(is_unused).map(|entry| entry.title.as_str()).collect()
    }
}

impl Entry {
    /// Returns whether the entry matches a mutant, given as `FILE:LINE:COLUMN: NAME`.
    fn is(&self, mutant: &str, sources: &Sources) -> bool {
        let mut parts = mutant.splitn(4, ':');
        let mut next = || parts.next().unwrap_or_default();
        let (file, line, _, name) = (next(), next(), next(), next());
        let line = line.parse().map_or(0, |line: usize| line.wrapping_sub(1));
        let text = sources.get(file).and_then(|source| source.lines().nth(line));
        self.file == file && self.name == name.trim_start() && text.is_some_and(|it| it.trim() == self.text)
    }
}

/// Reads all mutated source files.
pub(super) fn sources(root: &Path) -> Result<Sources> {
    let mut sources = Sources::new();
    let mut folders = FOLDERS.map(str::to_owned).to_vec();
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(root.join(&folder)).with_context(|| format!("cannot read {folder}"))?;
        for entry in entries {
            let entry = entry?;
            let name = format!("{folder}/{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                folders.push(name);
            } else {
                let text = fs::read_to_string(entry.path()).with_context(|| format!("cannot read {name}"))?;
                sources.insert(name, text);
            }
        }
    }
    Ok(sources)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "protocol/src/x.rs";
    const TITLE: &str = "protocol/src/x.rs:2: replace | with ^ in f";
    const ACCEPTED: &str =
        "# why\n\nprotocol/src/x.rs:2: replace | with ^ in f -- both give the same\n    a | b\n";

    fn sources(text: &str) -> Sources {
        [(FILE.to_owned(), text.to_owned())].into()
    }

    #[test]
    fn a_mutant_is_accepted_by_file_name_and_text_wherever_the_line_is_now() {
        let accepted = Accepted::parse(ACCEPTED).unwrap();
        let is_accepted = |mutant: &str, source: &str| accepted.reason(mutant, &sources(source)).is_some();

        assert!(is_accepted("protocol/src/x.rs:2:7: replace | with ^ in f", "fn f\n  a | b\n"));
        assert!(is_accepted("protocol/src/x.rs:3:7: replace | with ^ in f", "// new\nfn f\n  a | b\n"));
        assert!(!is_accepted("protocol/src/x.rs:2:7: replace | with ^ in f", "fn f\n  a | c\n"));
        assert!(!is_accepted("protocol/src/x.rs:2:7: replace | with & in f", "fn f\n  a | b\n"));
        assert!(!is_accepted("protocol/src/y.rs:2:7: replace | with ^ in f", "fn f\n  a | b\n"));
    }

    #[test]
    fn an_entry_whose_line_is_gone_is_stale_and_one_whose_line_has_moved_is_not() {
        let accepted = Accepted::parse(ACCEPTED).unwrap();

        assert!(accepted.hold_to(&sources("fn f\n  a | b\n")).is_ok());
        assert!(accepted.hold_to(&sources("// new\nfn f\n  a | b\n")).is_ok());
        let error = accepted.hold_to(&sources("fn f\n  a | c\n")).unwrap_err().to_string();
        assert!(error.ends_with(TITLE), "{error}");
        assert!(accepted.hold_to(&Sources::new()).is_err());
    }

    #[test]
    fn an_entry_without_a_survivor_is_unused() {
        let accepted = Accepted::parse(ACCEPTED).unwrap();
        let survived = BTreeSet::from(["protocol/src/x.rs:1:3: replace | with ^ in f".to_owned()]);

        assert_eq!(accepted.unused(&survived, &sources("a | b")), [""; 0]);
        assert_eq!(accepted.unused(&BTreeSet::new(), &sources("a | b")), [TITLE]);
    }

    #[test]
    fn an_entry_without_line_reason_or_source_is_refused() {
        assert!(Accepted::parse("protocol/src/x.rs: replace + with - -- why\n    a + b").is_err());
        assert!(Accepted::parse("protocol/src/x.rs:1: replace + with -\n    a + b").is_err());
        assert!(Accepted::parse("protocol/src/x.rs:1: replace + with - -- why\n").is_err());
    }

    /// Detects stale entries here rather than hours later in a run of the mutants.
    #[test]
    fn accepted_lines_are_in_their_files() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        Accepted::read(root).unwrap().hold_to(&super::sources(root).unwrap()).unwrap();
    }
}
