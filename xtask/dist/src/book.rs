//! The documents as a book: HTML by mdBook, and a PDF printed by Chromium.

use std::{fs, path::Path, process::Command};

use anyhow::{Context, Result};
use document::{anchor_of, root};

use crate::program::run_program;

/// Folder of the book, as in `book.toml`.
const FOLDER: &str = "target/book";

/// Options of Chromium for a page without a window. Root and containers cannot use the sandbox, and Chromium opens only the book.
pub(crate) const HEADLESS: [&str; 4] =
    ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"];

/// Title of the book.
const TITLE: &str = concat!("wsg-bridge ", env!("CARGO_PKG_VERSION"));

/// Builds the documents as a book in target/book, and prints it to target/book.pdf
#[derive(clap::Args)]
pub(crate) struct Arguments {}

/// Builds `target/book`, and prints it to `target/book.pdf` unless Chromium is missing.
pub(crate) fn build() -> Result<()> {
    let mut mdbook = Command::new("mdbook");
    run_program(mdbook.current_dir(root()).arg("build").env("MDBOOK_BOOK__TITLE", TITLE), "")?;
    let folder = root().join(FOLDER);
    let contents = fs::read_to_string(root().join("docs/SUMMARY.md")).context("docs/SUMMARY.md")?;
    for entry in fs::read_dir(&folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "html") {
            let html = fs::read_to_string(&path)?;
            let html = with_links_to_sources(&html, |file| root().join(file).exists());
            fs::write(&path, with_titles(html, &contents))?;
        }
    }
    println!("{}", folder.join("index.html").display());
    print(&folder, &contents)
}

/// Returns the title page and the table of contents of the printed book.
fn front(contents: &str) -> Result<String> {
    let mut front = format!(
        "<section class=\"front\"><h1>{TITLE}</h1>\n<p>A bridge between PLCs and servo grippers of the WSG series, drivers, and a \
         virtual gripper.<br>Not a safety device.</p>\n<h2>Contents</h2>\n<ul>\n"
    );
    for line in contents.lines() {
        let link = line.trim_start_matches("- ").strip_prefix('[').and_then(|rest| rest.split_once("]("));
        if let Some((title, file)) = link {
            let file = root().join("docs").join(file.trim_end_matches(')'));
            let page = fs::read_to_string(&file).with_context(|| file.display().to_string())?;
            let heading = page.lines().next().unwrap_or_default().trim_start_matches("# ");
            front.push_str(&format!("<li><a href=\"#{}\">{title}</a></li>\n", anchor_of(heading)));
        }
    }
    Ok(front + "</ul></section>\n")
}

/// Prints the book's `print.html` beside its folder, without links to files, which would contain paths of this machine.
fn print(folder: &Path, contents: &str) -> Result<()> {
    let pdf = folder.with_extension("pdf");
    // An older PDF must not be delivered with a newer book.
    let _ = fs::remove_file(&pdf);
    if Command::new("chromium").arg("--version").output().is_err() {
        println!("no PDF of the book: Chromium is missing");
        return Ok(());
    }
    let profile = folder.with_extension("profile");
    let mut chromium = Command::new("chromium");
    chromium.args(HEADLESS).arg("--log-level=3");
    chromium.args(["--no-pdf-header-footer", "--generate-pdf-document-outline"]);
    // Otherwise, an animated picture has a different state in each run.
    chromium.arg("--force-prefers-reduced-motion");
    chromium.arg(format!("--user-data-dir={}", profile.display()));
    chromium.arg(format!("--print-to-pdf={}", pdf.display()));
    let html = fs::read_to_string(folder.join("print.html"))?;
    let page = folder.join("printed.html");
    let html = html.replacen("<main>", &format!("<main>\n{}", front(contents)?), 1);
    let is_file = |link: &str| !link.starts_with(['#', '?']) && !link.contains("://");
    fs::write(&page, without_links(&html, is_file))?;
    let printed = run_program(chromium.arg(format!("file://{}", page.display())), "");
    // The profile exists only if Chromium started.
    let _ = fs::remove_dir_all(profile);
    fs::remove_file(page)?;
    printed?;
    fs::write(&pdf, reproducible(fs::read(&pdf)?))?;
    println!("{}", pdf.display());
    Ok(())
}

/// Returns the files of the built book as `book/...` and its PDF as `book.pdf`, without links out of the book.
pub(crate) fn files() -> Result<Vec<(String, Vec<u8>)>> {
    let (folder, mut files) = (root().join(FOLDER), Vec::new());
    read(&folder, "book", &mut files)?;
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
            let html = without_links(&fs::read_to_string(&path)?, |link| link.starts_with("../../"));
            files.push((name, html.into_bytes()));
        } else {
            files.push((name, fs::read(&path)?));
        }
    }
    Ok(())
}

/// Replaces what differs from print to print: the dates of creation and change, and the lowest number of an element, which
/// depends on the elements that Chromium made before.
fn reproducible(mut pdf: Vec<u8>) -> Vec<u8> {
    const DATE: &[u8] = b"19800101000000";
    for at in ends_of(&pdf, b"Date (D:") {
        if let Some(date) = pdf.get_mut(at..at + DATE.len()) {
            date.copy_from_slice(DATE);
        }
    }
    let number = |at: usize| str::from_utf8(pdf.get(at..at + 8)?).ok()?.parse::<u32>().ok();
    let elements: Vec<_> =
        ends_of(&pdf, b"(node").into_iter().filter_map(|at| Some((at, number(at)?))).collect();
    let lowest = elements.iter().map(|&(_, number)| number).min().unwrap_or(0);
    for (at, number) in elements {
        pdf[at..at + 8].copy_from_slice(format!("{:08}", number - lowest).as_bytes());
    }
    pdf
}

/// Returns the position after each occurrence of `name`.
fn ends_of(pdf: &[u8], name: &[u8]) -> Vec<usize> {
    let parts = pdf.windows(name.len()).enumerate();
    parts.filter(|(_, part)| *part == name).map(|(at, _)| at + name.len()).collect()
}

/// Removes the targets of these links; their text remains.
pub(crate) fn without_links(html: &str, is_removed: impl Fn(&str) -> bool) -> String {
    const LINK: &str = "<a href=\"";
    let mut parts = html.split(LINK);
    let mut changed = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let target = part.split('"').next().unwrap_or_default();
        changed.push_str(if is_removed(target) { "<a data-source=\"" } else { LINK });
        changed.push_str(part);
    }
    changed
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
    fn printed_book_begins_with_its_version_and_all_pages() {
        let contents = fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
        let front = front(&contents).unwrap();
        assert!(
            front.contains(TITLE) && front.contains("<li><a href=\"#quick-start\">Quick start</a></li>"),
            "{front}"
        );
        assert_eq!(front.matches("<li>").count(), contents.matches(".md)").count());
    }

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
    fn links_to_files_dates_and_lowest_number_are_removed() {
        let html = "<link href=\"a\"><a href=\"../../b.rs\">b</a> <a href=\"c.html\">c</a>";
        let wanted = "<link href=\"a\"><a data-source=\"../../b.rs\">b</a> <a href=\"c.html\">c</a>";
        assert_eq!(without_links(html, |link| link.starts_with("../")), wanted);
        let pdf = |date: &str, number: u32| {
            format!("/ModDate (D:{date}+00'00')>> (node{number:08}) (node{:08})", number + 9).into_bytes()
        };
        assert_eq!(reproducible(pdf("20261126003419", 595)), pdf("19800101000000", 0));
    }

    #[test]
    fn links_show_titles_instead_of_file_names() {
        let html = "<a href=\"can.html\">can.md</a>, <a href=\"can.html\">on CAN</a>, can.md".to_owned();
        let wanted = "<a href=\"can.html\">CAN and CANopen</a>, <a href=\"can.html\">on CAN</a>, can.md";
        assert_eq!(with_titles(html, "# A\n\n- [CAN and CANopen](can.md)\n"), wanted);
    }
}
