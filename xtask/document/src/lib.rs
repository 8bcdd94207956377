//! Access to this project's documents and sources, and the single writer of the documents' generated parts.
//!
//! A generated part is delimited by `<!-- generated: NAME -->` and `<!-- end -->`. A test generates it from the code
//! and compares the document with it by [`hold`]. With `WSG_UPDATE_DOCS=1` in the environment, the same test writes
//! it.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Environment variable that makes tests write generated parts instead of comparing them.
const UPDATE_VARIABLE: &str = "WSG_UPDATE_DOCS";

const END: &str = "<!-- end -->";

/// Names of folders without sources, at any depth.
const SKIPPED_FOLDERS: [&str; 3] = [".git", "node_modules", "target"];

/// Serializes tests that write to the same file in parallel.
static WRITING: Mutex<()> = Mutex::new(());

/// Returns the workspace folder.
///
/// # Panics
/// Panics if this package is not two folders below it.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("the workspace").to_owned()
}

/// Reads a file of the workspace, given by its path from the root.
///
/// # Panics
/// Panics if the file cannot be read as text.
#[must_use]
pub fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Returns the paths of all files of the workspace with this extension, such as `rs`.
///
/// # Panics
/// Panics if a folder cannot be read.
#[must_use]
pub fn files(extension: &str) -> Vec<PathBuf> {
    let (mut folders, mut files) = (vec![root()], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder of the workspace") {
            let entry = entry.expect("an entry of a folder");
            let (path, kind) = (entry.path(), entry.file_type().expect("the type of an entry"));
            if kind.is_dir() && SKIPPED_FOLDERS.iter().all(|skipped| entry.file_name() != *skipped) {
                folders.push(path);
            } else if kind.is_file() && path.extension().is_some_and(|it| it == extension) {
                files.push(path);
            }
        }
    }
    files
}

/// Compares the generated part of this name with `wanted`, or writes it. Surrounding blank lines are ignored.
///
/// # Panics
/// Panics if the document has no such part, or the part differs.
pub fn hold(document: &str, name: &str, wanted: &str) {
    // Visible with `-- --nocapture`.
    println!("{document}, {name}:\n\n{wanted}\n");
    if is_updating() {
        let _alone = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        let text = with_part(&read(document), name, wanted);
        write(document, &text.unwrap_or_else(|| panic!("{document} has no part \"{name}\"")));
    }
    let stands = part(document, name);
    assert!(
        stands == wanted.trim(),
        "{document}, part \"{name}\", is out of date; run this test with {UPDATE_VARIABLE}=1 to update it.\n\
         --- document\n{stands}\n--- expected\n{wanted}"
    );
}

/// Compares a completely generated file with `wanted`, or writes it.
///
/// # Panics
/// Panics if the file differs.
pub fn hold_file(document: &str, wanted: &str) {
    if is_updating() {
        write(document, wanted);
    }
    assert!(
        fs::read_to_string(root().join(document)).is_ok_and(|text| text == wanted),
        "{document} is out of date; run this test with {UPDATE_VARIABLE}=1 to update it"
    );
}

/// Returns the generated part of this name without surrounding blank lines.
///
/// # Panics
/// Panics if the document has no such part.
#[must_use]
pub fn part(document: &str, name: &str) -> String {
    let text = read(document);
    let range = range(&text, name).unwrap_or_else(|| panic!("{document} has no part \"{name}\""));
    text[range].trim().to_owned()
}

/// Returns the text with its generated part of this name replaced by `part`, or `None` without such a part.
#[must_use]
pub fn with_part(text: &str, name: &str, part: &str) -> Option<String> {
    let Range { start, end } = range(text, name)?;
    Some(format!("{}\n{}\n{}", &text[..start], part.trim(), &text[end..]))
}

/// Returns the link anchor of a heading, without `#`.
#[must_use]
pub fn anchor_of(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c.to_ascii_lowercase() }).collect()
}

/// Returns the CAN frames in a document's text blocks. Each line has a hexadecimal identifier and bytes, then words.
///
/// # Panics
/// Panics if a line of such a block is not a frame.
#[must_use]
pub fn can_frames(text: &str) -> Vec<(u16, Vec<u8>)> {
    let blocks = text.split("```text\n").skip(1).filter_map(|rest| rest.split("```").next());
    let lines = blocks.flat_map(str::lines).map(|line| {
        // The words occupy a separate column.
        let mut numbers = line.get(..29).unwrap_or(line).split_whitespace();
        let number =
            |word| u16::from_str_radix(word, 16).unwrap_or_else(|_| panic!("not a CAN frame: {line}"));
        let id = number(numbers.next().unwrap_or_default());
        (id, numbers.map(|byte| number(byte).to_le_bytes()[0]).collect())
    });
    lines.collect()
}

/// Access of a PLC to the process images, over Modbus or PROFIBUS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageAccess {
    /// Writes these values to holding registers 0 to 3, or as the words of the outputs.
    Write([u16; 4]),
    /// Reads input registers 0 to 5, or the words of the inputs, until they have these values; `None` is any value.
    Read([Option<u16>; 6]),
}

impl ImageAccess {
    /// Returns whether these values of input registers or words are the expected ones of a read.
    #[must_use]
    pub fn expects(expected: &[Option<u16>; 6], values: impl IntoIterator<Item = u16>) -> bool {
        expected.iter().zip(values).all(|(expected, value)| expected.is_none_or(|it| it == value))
    }
}

/// Returns the accesses to the process images in a document: lines that begin with `write 0 to 3:` or `read  0 to 5:` for registers,
/// and with `outputs:` or `inputs:` for words. Numbers with `h` are hexadecimal, and `-` is any value.
///
/// # Panics
/// Panics if such a line has too few numbers.
#[must_use]
pub fn image_accesses(text: &str) -> Vec<ImageAccess> {
    let number = |word: &str| match word.strip_suffix('h') {
        _ if word == "-" => None,
        Some(digits) => Some(u16::from_str_radix(digits, 16).unwrap_or_else(|_| panic!("no number: {word}"))),
        None => Some(word.parse().unwrap_or_else(|_| panic!("no number: {word}"))),
    };
    let access = |line: &str| {
        let after = |[register, word]: [&str; 2]| line.strip_prefix(register).or(line.strip_prefix(word));
        if let Some(values) = after(["write 0 to 3:", "outputs:"]) {
            let mut values = values.split_whitespace().map(number);
            let value = |()| values.next().flatten().unwrap_or_else(|| panic!("four values: {line}"));
            return Some(ImageAccess::Write([(); 4].map(value)));
        }
        let mut values = after(["read  0 to 5:", "inputs:"])?.split_whitespace().map(number);
        let value = |()| values.next().unwrap_or_else(|| panic!("six values: {line}"));
        Some(ImageAccess::Read([(); 6].map(value)))
    };
    text.lines().filter_map(access).collect()
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

/// Returns the range of a part, between its marks.
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
