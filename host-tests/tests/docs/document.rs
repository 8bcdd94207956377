//! The documents as files: reading them, and holding their generated parts to a text.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The variable that has generated parts written instead of compared.
pub(crate) const UPDATE_VARIABLE: &str = "WSG_UPDATE_DOCS";

const END: &str = "<!-- end -->";

/// Tests run side by side, and several write to one file.
static WRITING: Mutex<()> = Mutex::new(());

/// The folder of the workspace.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

/// A file of the workspace, by its path from the root.
pub(crate) fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Whether generated parts are to be written.
pub(crate) fn is_updating() -> bool {
    std::env::var_os(UPDATE_VARIABLE).is_some_and(|value| value == "1")
}

/// The generated part of this name.
pub(crate) fn part(document: &str, name: &str) -> String {
    let text = read(document);
    let (from, to) = bounds(document, &text, name);
    text[from..to].trim().to_owned()
}

/// Holds the generated part of this name to `wanted`, or writes it.
pub(crate) fn hold(document: &str, name: &str, wanted: &str) {
    // Seen with `-- --nocapture`.
    println!("{document}, {name}:\n\n{wanted}\n");
    if is_updating() {
        let _alone = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        let text = read(document);
        let (from, to) = bounds(document, &text, name);
        let text = format!("{}\n{}\n{}", &text[..from], wanted.trim(), &text[to..]);
        fs::write(root().join(document), text).unwrap();
    }
    let stands = part(document, name);
    assert!(
        stands == wanted.trim(),
        "{document}, part \"{name}\", is out of date; `{UPDATE_VARIABLE}=1 cargo test -p host-tests --test docs` \
         writes it anew.\n--- stands\n{stands}\n--- wanted\n{wanted}"
    );
}

/// Where the text of a part begins and ends.
fn bounds(document: &str, text: &str, name: &str) -> (usize, usize) {
    let begin = format!("<!-- generated: {name} -->");
    let from = text.find(&begin).unwrap_or_else(|| panic!("{document} has no `{begin}`")) + begin.len();
    let to = text[from..].find(END).unwrap_or_else(|| panic!("{document}: `{begin}` has no end")) + from;
    (from, to)
}

/// A Markdown table.
pub(crate) fn table<const N: usize>(head: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let line = |cells: [String; N]| format!("| {} |\n", cells.join(" | "));
    let mut text = line(head.map(str::to_owned));
    text.push_str(&format!("|{}\n", "---|".repeat(N)));
    text.extend(rows.into_iter().map(line));
    text
}
