//! The documents of this project as files, and the one writer of what is generated in them.
//!
//! A generated part stands between `<!-- generated: NAME -->` and `<!-- end -->`. A test makes the part from the code and
//! [`hold`]s the document to it. With `WSG_UPDATE_DOCS=1` in the environment, the same test writes the part.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Makes tests write what is generated instead of only comparing it.
const UPDATE_VARIABLE: &str = "WSG_UPDATE_DOCS";

const END: &str = "<!-- end -->";

/// Tests run in parallel, and several write to one file.
static WRITING: Mutex<()> = Mutex::new(());

/// Returns the folder of the workspace.
///
/// # Panics
/// If this package is not two folders below it.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("the workspace").to_owned()
}

/// Reads a file of the workspace, by its path from the root.
///
/// # Panics
/// If the file cannot be read as text.
#[must_use]
pub fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Holds the generated part of this name to `wanted`, or writes it. Blank lines around the part do not count.
///
/// # Panics
/// If the document has no such part, or the part differs.
pub fn hold(document: &str, name: &str, wanted: &str) {
    // Shown with `-- --nocapture`.
    println!("{document}, {name}:\n\n{wanted}\n");
    if is_updating() {
        let _alone = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        let text = with_part(&read(document), name, wanted);
        write(document, &text.unwrap_or_else(|| panic!("{document} has no part \"{name}\"")));
    }
    let stands = part(document, name);
    assert!(
        stands == wanted.trim(),
        "{document}, part \"{name}\", is out of date; this test writes it anew with {UPDATE_VARIABLE}=1.\n\
         --- stands\n{stands}\n--- wanted\n{wanted}"
    );
}

/// Holds a file that is generated as a whole to `wanted`, or writes it.
///
/// # Panics
/// If the file differs.
pub fn hold_file(document: &str, wanted: &str) {
    if is_updating() {
        write(document, wanted);
    }
    assert!(
        fs::read_to_string(root().join(document)).is_ok_and(|text| text == wanted),
        "{document} is out of date; this test writes it anew with {UPDATE_VARIABLE}=1"
    );
}

/// Reads the generated part of this name, without blank lines around it.
///
/// # Panics
/// If the document has no such part.
#[must_use]
pub fn part(document: &str, name: &str) -> String {
    let text = read(document);
    let range = range(&text, name).unwrap_or_else(|| panic!("{document} has no part \"{name}\""));
    text[range].trim().to_owned()
}

/// Returns the text with `part` as its generated part of this name, or `None` if it has no such part.
#[must_use]
pub fn with_part(text: &str, name: &str, part: &str) -> Option<String> {
    let Range { start, end } = range(text, name)?;
    Some(format!("{}\n{}\n{}", &text[..start], part.trim(), &text[end..]))
}

/// Returns what a link to a heading of these words has behind its `#`.
#[must_use]
pub fn anchor_of(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c.to_ascii_lowercase() }).collect()
}

/// Returns the CAN frames in the text blocks of a document: identifier and bytes, in hexadecimal, and words behind them.
///
/// # Panics
/// If a line of such a block is none.
#[must_use]
pub fn can_frames(text: &str) -> Vec<(u16, Vec<u8>)> {
    let blocks = text.split("```text\n").skip(1).filter_map(|rest| rest.split("```").next());
    let lines = blocks.flat_map(str::lines).map(|line| {
        // The words are a column of their own.
        let mut numbers = line.get(..29).unwrap_or(line).split_whitespace();
        let number = |word| u16::from_str_radix(word, 16).unwrap_or_else(|_| panic!("no frame: {line}"));
        let id = number(numbers.next().unwrap_or_default());
        (id, numbers.map(|byte| number(byte).to_le_bytes()[0]).collect())
    });
    lines.collect()
}

/// Formats a Markdown table.
#[must_use]
pub fn table<const N: usize>(head: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let line = |cells: [String; N]| format!("| {} |\n", cells.join(" | "));
    let mut text = line(head.map(str::to_owned));
    text.push_str(&format!("|{}\n", "---|".repeat(N)));
    text.extend(rows.into_iter().map(line));
    text
}

fn is_updating() -> bool {
    std::env::var_os(UPDATE_VARIABLE).is_some_and(|value| value == "1")
}

fn write(document: &str, text: &str) {
    fs::write(root().join(document), text).unwrap_or_else(|error| panic!("{document}: {error}"));
}

/// Where the part stands in the text, between its marks.
fn range(text: &str, name: &str) -> Option<Range<usize>> {
    let begin = format!("<!-- generated: {name} -->");
    let start = text.find(&begin)? + begin.len();
    Some(start..start + text[start..].find(END)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_generated_part_of_that_name_is_replaced() {
        let text = "# A\n<!-- generated: a -->\nold\n<!-- end -->\n<!-- generated: b -->\nb\n<!-- end -->\n";
        let wanted = text.replace("old", "new");
        assert_eq!(with_part(text, "a", "new\n").as_ref(), Some(&wanted));
        assert_eq!(with_part(&wanted, "a", "new").as_ref(), Some(&wanted));
    }

    #[test]
    fn part_without_a_mark_is_not_written() {
        assert_eq!(with_part("# A\n", "a", "new"), None);
        assert_eq!(with_part("<!-- generated: a -->\n", "a", "new"), None);
    }
}
