//! The book in the release folder: without links to files that are only in the repository.

use std::{fs, path::Path};

use anyhow::{Context, Result};

/// Start of a link out of the book's folder.
const LINK_OUT: &str = "<a href=\"../../";

/// Returns the files of a book as `book/...`, and its PDF as `book.pdf` if there is one.
pub(crate) fn files(folder: &Path) -> Result<Vec<(String, Vec<u8>)>> {
    let mut files = Vec::new();
    read(folder, "book", &mut files)?;
    if let Ok(pdf) = fs::read(folder.with_extension("pdf")) {
        files.push(("book.pdf".to_owned(), pdf));
    }
    Ok(files)
}

fn read(folder: &Path, name: &str, files: &mut Vec<(String, Vec<u8>)>) -> Result<()> {
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        let name = format!("{name}/{}", path.file_name().unwrap_or_default().display());
        if path.is_dir() {
            read(&path, &name, files)?;
        } else if name.ends_with(".html") {
            files.push((name, without_links_out(&fs::read_to_string(&path)?).into_bytes()));
        } else {
            files.push((name, fs::read(&path)?));
        }
    }
    Ok(())
}

/// Replaces each link out of the book with its text.
fn without_links_out(html: &str) -> String {
    let mut parts = html.split(LINK_OUT);
    let mut changed = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (_, link) = part.split_once('>').unwrap_or(("", part));
        let (text, rest) = link.split_once("</a>").unwrap_or((link, ""));
        changed.push_str(text);
        changed.push_str(rest);
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_links_out_of_the_book_become_text() {
        let html = "see <a href=\"../../x.md\"><code>x</code></a> and <a href=\"can.html\">CAN</a>.";
        assert_eq!(without_links_out(html), "see <code>x</code> and <a href=\"can.html\">CAN</a>.");
    }
}
