//! The documents as a book: HTML by mdBook, and a PDF printed by Chromium.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};

use crate::{
    process, setup,
    tool::{MDBOOK, plain},
    workspace::Workspace,
};

/// Folder of the book, as in `book.toml`.
const FOLDER: &str = "target/book";

/// Builds `target/book`, prints it to `target/book.pdf` unless Chromium is missing, and returns its folder.
pub(crate) fn build(workspace: &Workspace) -> Result<PathBuf> {
    MDBOOK.require(workspace, "the book")?;
    process::run(&mut plain(workspace, "mdbook build"))?;
    let folder = workspace.root.join(FOLDER);
    let contents = fs::read_to_string(workspace.root.join("docs/SUMMARY.md")).context("docs/SUMMARY.md")?;
    for entry in fs::read_dir(&folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "html") {
            let html = fs::read_to_string(&path)?;
            let html = with_links_to_sources(&html, |file| workspace.root.join(file).exists());
            fs::write(&path, with_titles(html, &contents))?;
        }
    }
    println!("{}", folder.join("index.html").display());
    print(&folder)?;
    Ok(folder)
}

/// Prints the book's `print.html` beside its folder.
fn print(folder: &Path) -> Result<()> {
    let pdf = folder.with_extension("pdf");
    // An older PDF must not be delivered with a newer book.
    let _ = fs::remove_file(&pdf);
    if !setup::lacking(&[("the PDF", "chromium", "chromium")]).is_empty() {
        println!("no PDF of the book: Chromium is missing");
        return Ok(());
    }
    let profile = folder.with_extension("profile");
    let mut chromium = Command::new("chromium");
    // Root and containers cannot use the sandbox, and Chromium opens only the book.
    chromium.args([
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        "--log-level=3",
    ]);
    chromium.args(["--no-pdf-header-footer", "--generate-pdf-document-outline"]);
    chromium.arg(format!("--user-data-dir={}", profile.display()));
    chromium.arg(format!("--print-to-pdf={}", pdf.display()));
    let printed = process::output(chromium.arg(format!("file://{}", folder.join("print.html").display())));
    // The profile exists only if Chromium started.
    let _ = fs::remove_dir_all(profile);
    printed?;
    println!("{}", pdf.display());
    Ok(())
}

/// Makes links from `docs` to other files of the repository lead from the book to these files. mdBook has changed the
/// extension `.md` to `.html`.
fn with_links_to_sources(html: &str, exists: impl Fn(&str) -> bool) -> String {
    const LINK: &str = "href=\"../";
    let mut parts = html.split(LINK);
    let mut changed = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (target, rest) = part.split_once('"').unwrap_or((part, ""));
        let source = target.replace(".html", ".md");
        let target = if exists(&source) { format!("../{source}") } else { target.to_owned() };
        changed.push_str(&format!("{LINK}{target}\"{rest}"));
    }
    changed
}

/// Shows the title of a page, as in the table of contents, where a link shows its file name.
fn with_titles(html: String, contents: &str) -> String {
    let pages = contents
        .lines()
        .filter_map(|line| line.trim_start().strip_prefix("- [")?.strip_suffix(')')?.split_once("]("));
    pages.fold(html, |html, (title, file)| html.replace(&format!(">{file}</a>"), &format!(">{title}</a>")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_out_of_the_documents_lead_to_the_sources() {
        let html =
            "<a href=\"../ARCHITECTURE.html\">a</a> <a href=\"../x/y.rs\">b</a> <a href=\"can.html\">c</a>";
        let changed = with_links_to_sources(html, |file| ["ARCHITECTURE.md", "x/y.rs"].contains(&file));
        let wanted = "<a href=\"../../ARCHITECTURE.md\">a</a> <a href=\"../../x/y.rs\">b</a> <a href=\"can.html\">c</a>";
        assert_eq!(changed, wanted);
        assert_eq!(with_links_to_sources(html, |_| false), html);
    }

    #[test]
    fn links_show_titles_instead_of_file_names() {
        let html = "<a href=\"can.html\">can.md</a>, <a href=\"can.html\">on CAN</a>, can.md".to_owned();
        let wanted = "<a href=\"can.html\">CAN and CANopen</a>, <a href=\"can.html\">on CAN</a>, can.md";
        assert_eq!(with_titles(html, "# A\n\n- [CAN and CANopen](can.md)\n"), wanted);
    }
}
