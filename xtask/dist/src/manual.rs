//! The manual of a board: the documents for PLC engineers as one self-contained HTML file.
//!
//! Links between these documents become internal links and show a document's title instead of its file name. Pictures
//! are embedded. Links to other documents are reduced to their text. Text between `<!-- manual: off -->` and `<!--
//! manual: on -->` is for people who build the image and is removed. Text between `<!-- manual: NAME, NAME -->` and
//! `<!-- manual: on -->` is only for the manuals of these boards.

use std::{collections::BTreeMap, fmt::Write as _, fs};

use anyhow::{Context, Result, bail, ensure};
use base64::{Engine, engine::general_purpose::STANDARD};
use boards::Board;
use document::{anchor_of, root};
use host_tests::board_wiring::BoardWiring;
use pulldown_cmark::{CowStr, Event, Options, Parser, Tag, TagEnd, html};

/// The documents, in reading order.
pub(crate) const DOCUMENTS: [&str; 9] = [
    "quick-start.md",
    "commissioning.md",
    "wiring.md",
    "registers.md",
    "can.md",
    "profibus.md",
    "updates.md",
    "grip-cycle.md",
    "states.md",
];

/// Begins a part that is left out (`off`), or a part for the named boards.
const MARK: &str = "<!-- manual: ";
const ON: &str = "<!-- manual: on -->";
const OFF: &str = "off";

/// The picture of the wiring, which differs by board.
const WIRING: &str = "wiring.svg";

const HEAD: &str = "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">\n\
<title>TITLE</title>\n<style>\n\
body { font: 16px/1.5 sans-serif; color: #222; background: #fff; max-width: 60em; margin: 0 auto; padding: 1em; }\n\
section { border-top: 2px solid #444; margin-top: 3em; }\n\
.wide { overflow-x: auto; }\n\
table { border-collapse: collapse; font-size: 0.9em; margin: 1em 0; }\n\
td, th { border: 1px solid #bbb; padding: 0.25em 0.5em; text-align: left; vertical-align: top; }\n\
th { background: #eee; }\n\
pre { background: #f4f4f4; padding: 0.75em; overflow-x: auto; }\n\
code { font-family: monospace; }\n\
img { max-width: 100%; }\n\
@media print { section { break-before: page; } body { max-width: none; font-size: 11px; } }\n\
</style>\n</head>\n<body>\n";

/// Returns the manual of a board.
///
/// # Errors
/// Fails when a document or a picture cannot be read, or a link is broken.
pub(crate) fn html(board: &Board, files: &[&str]) -> Result<String> {
    let wiring = BoardWiring::of(board);
    let mut documents = BTreeMap::new();
    for name in DOCUMENTS {
        let text =
            fs::read_to_string(root().join("docs").join(name)).with_context(|| format!("docs/{name}"))?;
        documents.insert(name, parts_for(board.name, &text).with_context(|| format!("docs/{name}"))?);
    }
    let titles =
        documents.iter().filter_map(|(name, text)| Some((*name, text.lines().next()?.strip_prefix("# ")?)));
    let titles: BTreeMap<_, _> = titles.collect();
    let mut contents = String::new();
    let mut chapters = String::new();
    for name in DOCUMENTS {
        let chapter = Chapter { name, files, titles: &titles, wiring: &wiring };
        let events = chapter.events(documents.get(name).map_or("", String::as_str))?;
        chapter.list(&events, &mut contents)?;
        writeln!(chapters, "<section id=\"{}\">", chapter.id(""))?;
        html::push_html(&mut chapters, events.into_iter());
        chapters.push_str("</section>\n");
    }
    let title = format!("wsg-bridge {} for the {}: manual", env!("CARGO_PKG_VERSION"), wiring.name);
    let head = HEAD.replace("TITLE", &title);
    let manual = format!("{head}<h1>{title}</h1>\n<nav>\n{contents}</nav>\n{chapters}</body>\n</html>\n");
    check(&manual, files)?;
    Ok(manual)
}

/// Returns a document without the parts for people who build the image and for other boards.
fn parts_for(board: &str, text: &str) -> Result<String> {
    let mut kept = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once(MARK) {
        let (mark, after) = after.split_once(" -->").with_context(|| format!("{MARK} has no end"))?;
        let names: Vec<&str> = mark.split(", ").collect();
        for name in &names {
            ensure!(*name == OFF || Board::named(name).is_ok(), "{name} of {MARK}{mark} --> is no board");
        }
        let (part, after) =
            after.split_once(ON).with_context(|| format!("{MARK}{mark} --> has no closing {ON}"))?;
        ensure!(!part.contains(MARK), "{MARK}{mark} --> contains another mark");
        kept.push_str(before);
        if names.contains(&board) {
            kept.push_str(part.strip_prefix('\n').unwrap_or(part));
        }
        rest = after.strip_prefix('\n').unwrap_or(after);
    }
    Ok(kept + rest)
}

/// A document and its link targets outside the manual.
struct Chapter<'a> {
    name: &'a str,
    files: &'a [&'a str],
    /// Titles of all documents.
    titles: &'a BTreeMap<&'a str, &'a str>,
    wiring: &'a BoardWiring,
}

/// Target of a link.
enum Target {
    To(String),
    /// Content outside the manual.
    Elsewhere,
}

impl Chapter<'_> {
    /// Returns the id of a heading in the manual.
    fn id(&self, heading: &str) -> String {
        id(self.name, heading)
    }

    fn events<'t>(&self, text: &'t str) -> Result<Vec<Event<'t>>> {
        let mut events = Vec::new();
        let mut ids: Vec<String> = Vec::new();
        let mut link_is_kept = true;
        for event in Parser::new_ext(text, Options::ENABLE_TABLES) {
            let event = match event {
                Event::Html(html) | Event::InlineHtml(html) => {
                    ensure!(
                        html.trim_start().starts_with("<!--"),
                        "docs/{} contains HTML: {html}",
                        self.name
                    );
                    continue;
                }
                Event::Start(Tag::Link { link_type, dest_url, title, id }) => match self.target(&dest_url)? {
                    Target::To(address) => {
                        link_is_kept = true;
                        Event::Start(Tag::Link { link_type, dest_url: address.into(), title, id })
                    }
                    Target::Elsewhere => {
                        link_is_kept = false;
                        continue;
                    }
                },
                Event::End(TagEnd::Link) if !link_is_kept => continue,
                Event::Text(words) => {
                    let title = self
                        .titles
                        .get(&*words)
                        .filter(|_| matches!(events.last(), Some(Event::Start(Tag::Link { .. }))));
                    Event::Text(title.map_or(words, |title| format!("\u{201C}{title}\u{201D}").into()))
                }
                Event::Start(Tag::Image { link_type, dest_url, title, id }) => {
                    let dest_url = self.picture(&dest_url)?.into();
                    Event::Start(Tag::Image { link_type, dest_url, title, id })
                }
                Event::Start(Tag::Table(alignments)) => {
                    events.push(Event::Html(CowStr::Borrowed("<div class=\"wide\">\n")));
                    Event::Start(Tag::Table(alignments))
                }
                Event::End(TagEnd::Table) => {
                    events.push(Event::End(TagEnd::Table));
                    Event::Html(CowStr::Borrowed("</div>\n"))
                }
                Event::End(TagEnd::Heading(level)) => {
                    let (start, words) = heading(&events);
                    let mut id = self.id(&anchor_of(&words));
                    // Numbered like duplicate headings on repository hosts.
                    let same = ids.iter().filter(|other| **other == id).count();
                    ids.push(id.clone());
                    if same > 0 {
                        write!(id, "-{same}")?;
                    }
                    if let Some(Event::Start(Tag::Heading { id: place, .. })) = events.get_mut(start) {
                        *place = Some(id.into());
                    }
                    Event::End(TagEnd::Heading(level))
                }
                other => other,
            };
            events.push(event);
        }
        Ok(events)
    }

    /// Adds headings of levels 1 and 2 to the table of contents.
    fn list(&self, events: &[Event<'_>], contents: &mut String) -> Result<()> {
        let mut entries = Vec::new();
        for (end, event) in events.iter().enumerate() {
            if let Event::End(TagEnd::Heading(level)) = event
                && (*level as usize) <= 2
            {
                let (start, words) = heading(&events[..end]);
                if let Some(Event::Start(Tag::Heading { id: Some(id), .. })) = events.get(start) {
                    entries.push((*level as usize, id.to_string(), escaped(&words)));
                }
            }
        }
        for (level, id, words) in entries {
            let (open, close) = if level == 1 { ("<p><b>", "</b></p>") } else { ("", "<br>") };
            writeln!(contents, "{open}<a href=\"#{id}\">{words}</a>{close}")?;
        }
        Ok(())
    }

    fn target(&self, link: &str) -> Result<Target> {
        if link.starts_with("https://") {
            return Ok(Target::To(link.to_owned()));
        }
        let (file, heading) = link.split_once('#').unwrap_or((link, ""));
        let file = if file.is_empty() { self.name } else { file };
        if DOCUMENTS.contains(&file) {
            return Ok(Target::To(format!("#{}", id(file, heading))));
        }
        if self.files.contains(&file) {
            return Ok(Target::To(file.to_owned()));
        }
        ensure!(
            root().join("docs").join(file).exists(),
            "docs/{} links to the missing file {link}",
            self.name
        );
        Ok(Target::Elsewhere)
    }

    /// Returns a drawing or a screenshot as a data URL.
    fn picture(&self, file: &str) -> Result<String> {
        if file.ends_with(".png") {
            let bytes = fs::read(root().join("docs").join(file)).with_context(|| format!("docs/{file}"))?;
            return Ok(format!("data:image/png;base64,{}", STANDARD.encode(bytes)));
        }
        ensure!(file.ends_with(".svg"), "{file} is neither an SVG drawing nor a PNG picture");
        let drawing = if file == WIRING {
            self.wiring.picture()
        } else {
            fs::read_to_string(root().join("docs").join(file)).with_context(|| format!("docs/{file}"))?
        };
        let mut address = String::from("data:image/svg+xml;charset=utf-8,");
        for byte in drawing.bytes() {
            if byte.is_ascii_alphanumeric() || b"-_.".contains(&byte) {
                address.push(byte.into());
            } else {
                write!(address, "%{byte:02X}")?;
            }
        }
        Ok(address)
    }
}

fn id(document: &str, heading: &str) -> String {
    let stem = document.strip_suffix(".md").unwrap_or(document);
    if heading.is_empty() { stem.to_owned() } else { format!("{stem}--{heading}") }
}

/// Returns the index and the words of the last heading.
fn heading(events: &[Event<'_>]) -> (usize, String) {
    let is_start = |event: &Event<'_>| matches!(event, Event::Start(Tag::Heading { .. }));
    let start = events.iter().rposition(is_start).unwrap_or(0);
    let mut words = String::new();
    for event in &events[start..] {
        if let Event::Text(text) | Event::Code(text) = event {
            words.push_str(text);
        }
    }
    (start, words)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Fails on broken links, duplicate ids, and external resources.
fn check(manual: &str, files: &[&str]) -> Result<()> {
    let ids: Vec<&str> = attributes(manual, " id=\"").collect();
    for (n, id) in ids.iter().enumerate() {
        ensure!(!ids[n + 1..].contains(id), "the manual has a duplicate id {id}");
    }
    for link in attributes(manual, " href=\"") {
        let is_there = match link.strip_prefix('#') {
            Some(id) => ids.contains(&id),
            None => link.starts_with("https://") || files.contains(&link),
        };
        ensure!(is_there, "broken link in the manual: {link}");
    }
    for address in attributes(manual, " src=\"") {
        ensure!(address.starts_with("data:"), "the manual loads an external resource: {address}");
    }
    for loads in ["<script", "<link", "<iframe", "<object", "@import", "url("] {
        if manual.contains(loads) {
            bail!("the manual contains {loads}, which may load external resources");
        }
    }
    Ok(())
}

fn attributes<'a>(html: &'a str, name: &'a str) -> impl Iterator<Item = &'a str> {
    html.split(name).skip(1).filter_map(|rest| rest.split('"').next())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linked;
    use boards::BOARDS;

    fn rendered(text: &str) -> Result<String> {
        let titles = BTreeMap::from([("wiring.md", "Wiring")]);
        let wiring = BoardWiring::of(<&Board>::default());
        let chapter = Chapter { name: "states.md", files: &["a.eds"], titles: &titles, wiring: &wiring };
        let events = chapter.events(text)?;
        let mut html = String::new();
        html::push_html(&mut html, events.into_iter());
        Ok(html)
    }

    #[test]
    fn manual_has_every_document_no_build_tools_and_is_reproducible() {
        for board in &BOARDS {
            let manual = html(board, &linked()).unwrap();

            for document in DOCUMENTS {
                assert!(manual.contains(&format!("<section id=\"{}\">", id(document, ""))), "{document}");
            }
            for word in ["cargo", "xtask", "Rust", ".rs", "rustup", "crate", "host-tests", ".md"] {
                assert!(!manual.contains(word), "the manual of the {} mentions {word}", board.name);
            }
            assert!(manual.contains("src=\"data:image/svg+xml;"));
            assert!(manual == html(board, &linked()).unwrap());
        }
    }

    #[test]
    fn links_point_into_the_manual_or_to_neighbouring_files() {
        let html =
            rendered("# A b\n[c](wiring.md#the-bus) [d](#a-b) [e](a.eds) [f](protocol.md#x) [g](https://h) [wiring.md](wiring.md)")
                .unwrap();
        for part in [
            "<h1 id=\"states--a-b\">",
            "<a href=\"#wiring--the-bus\">c</a>",
            "<a href=\"#states--a-b\">d</a>",
            "<a href=\"a.eds\">e</a> f ",
            "<a href=\"https://h\">g</a>",
            "<a href=\"#wiring\">\u{201C}Wiring\u{201D}</a>",
        ] {
            assert!(html.contains(part), "{part} is not in {html}");
        }
        assert!(rendered("[a](no-such-file.md)").is_err());
        assert!(rendered("<b>bold</b>").is_err());
        assert!(!rendered("<!-- generated: x -->\na\n\n<!-- end -->\n").unwrap().contains("<!--"));
    }

    #[test]
    fn broken_links_and_external_resources_are_found() {
        assert!(check("<h1 id=\"a\"></h1><a href=\"#a\"></a><img src=\"data:x\">", &[]).is_ok());
        for wrong in [
            "<a href=\"#a\"></a>",
            "<a href=\"b.eds\"></a>",
            "<h1 id=\"a\"></h1><h2 id=\"a\"></h2>",
            "<img src=\"https://a/b.svg\">",
            "<script>",
        ] {
            assert!(check(wrong, &[]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn parts_for_builders_and_other_boards_are_left_out() {
        let text = "a <!-- manual: off -->b<!-- manual: on -->c <!-- manual: pico -->d <!-- manual: on -->e \
                    <!-- manual: pico, nucleo-g474re -->f<!-- manual: on -->";
        assert_eq!(parts_for("pico", text).unwrap(), "a c d e f");
        assert_eq!(parts_for("nucleo-g474re", text).unwrap(), "a c e f");
        assert_eq!(parts_for("b-l475e-iot01a", text).unwrap(), "a c e ");
        let lines = "- a\n<!-- manual: pico -->\n- b\n<!-- manual: on -->\n- c\n";
        assert_eq!(parts_for("pico", lines).unwrap(), "- a\n- b\n- c\n");
        for wrong in [
            "<!-- manual: off -->b",
            "a <!-- manual: on -->",
            "<!-- manual: pcio -->b<!-- manual: on -->",
            "<!-- manual: pico -->b<!-- manual: off -->c<!-- manual: on -->",
        ] {
            assert!(parts_for("pico", wrong).is_err(), "{wrong}");
        }
    }
}
