//! Checks the project's English: spelling with `typos`, and a list of wordings that read like a translation.
//!
//! Neither replaces reading. The list applies to every page and every source of the repository.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::Command;

use document::{files, read, root};
use host_tests::masters::PYTHON_VARIABLE;

/// Files that contain the wordings.
const EXEMPT: [&str; 1] = ["host-tests/tests/words.rs"];

/// Wordings, each with a replacement.
const WORDINGS: [(&str, &str); 22] = [
    ("nobody", "name who does not: no client, no program, no test"),
    ("those of", "repeat the noun"),
    ("tell", "software reports, returns, shows or logs"),
    ("tells", "software reports, returns, shows or logs"),
    ("told", "software reports, returns, shows or logs"),
    ("what is", "use a noun or a participle: received bytes, the running motion"),
    ("what was", "use a noun or a participle: received bytes, the running motion"),
    ("what are", "use a noun or a participle: received bytes, the running motion"),
    ("what were", "use a noun or a participle: received bytes, the running motion"),
    ("behind", "time is after; a place is beyond, past, or connected to"),
    ("asked for", "requested"),
    ("goes on", "continues"),
    ("asks on", "keeps polling"),
    ("anew", "again"),
    ("whatever", "regardless of, any"),
    ("falls silent", "stops sending, stops responding"),
    ("fell silent", "stopped sending, stopped responding"),
    ("if there is none", "name the case: without a client, if no message is pending"),
    ("of no use", "requires, has no effect"),
    ("besides", "in addition to, except"),
    ("at the most", "at most"),
    ("be had", "is available"),
];

/// Number of words in the longest wording.
const LONGEST: usize = 4;

#[test]
#[ignore = "needs typos: run `cargo xtask test`"]
fn typos_finds_nothing_in_any_text() {
    let python = std::env::var_os(PYTHON_VARIABLE);
    let python = python.unwrap_or_else(|| panic!("{PYTHON_VARIABLE} is not set: run `cargo xtask test`"));
    let run = Command::new(Path::new(&python).with_file_name("typos"))
        .args(["--format", "brief"])
        .current_dir(root())
        .output()
        .expect("typos must be installed beside the masters' Python");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stdout));
}

#[test]
fn no_text_of_the_repository_has_a_wording_of_the_list() {
    let files = [files("rs"), files("md"), files("py")].concat();
    assert!(files.len() > 500, "only {} files found", files.len());
    let mut found = Vec::new();
    for file in files {
        let path = file.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
        if EXEMPT.contains(&&path[..]) {
            continue;
        }
        let text = fs::read_to_string(&file).unwrap();
        let extension = file.extension().and_then(|extension| extension.to_str()).unwrap();
        found.extend(
            wordings(&text, extension)
                .map(|(line, wording, instead)| format!("{path}:{line}: \"{wording}\": {instead}")),
        );
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// The pages for users state each fact once.
#[test]
fn user_pages_share_few_runs_of_nine_words() {
    let contents = read("docs/SUMMARY.md");
    let (users, _) = contents.split_once("# Contributors").unwrap();
    let mut pages: BTreeMap<Vec<String>, BTreeSet<&str>> = BTreeMap::new();
    let names = users.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    for name in names {
        let words: Vec<String> = words_of_user_page(&read(&format!("docs/{name}")));
        for run in words.windows(9) {
            pages.entry(run.to_vec()).or_default().insert(name);
        }
    }
    assert!(pages.len() > 10_000, "{} runs", pages.len());
    let shared: Vec<_> = pages.iter().filter(|(_, pages)| pages.len() > 1).collect();
    assert!(shared.len() <= 60, "{} runs: {shared:#?}", shared.len());
}

/// Returns the words of a page without generated parts and code blocks.
fn words_of_user_page(page: &str) -> Vec<String> {
    let mut text = String::new();
    for (at, part) in page.split("<!-- generated: ").enumerate() {
        text.push_str(if at == 0 { part } else { part.split_once("<!-- end -->").map_or("", |(_, it)| it) });
    }
    let prose = prose_of_page(&text).into_iter().map(|(_, line)| line.to_lowercase());
    let words = prose.flat_map(|line| {
        line.split(|char: char| !char.is_alphanumeric() && char != '_').map(str::to_owned).collect::<Vec<_>>()
    });
    words.filter(|word| !word.is_empty()).collect()
}

#[test]
fn planted_wordings_are_found_in_comments_and_messages_only() {
    let source = "\
        // Nobody has asked\n\
        // for it, if there\n\
        // is none.\n\
        fn behind(what: u8) { error(\"half a frame is what was received\") }\n";
    let in_file = |text: &str, extension| -> Vec<_> {
        wordings(text, extension).map(|(line, wording, _)| (line, wording)).collect()
    };
    let found = in_file(source, "rs");
    assert_eq!(found, [(1, "nobody"), (1, "asked for"), (2, "if there is none"), (4, "what was")]);
    let page = "The bytes behind it.\n\n```sh\ncat nobody\n```\n";
    assert_eq!(in_file(page, "md"), [(1, "behind")]);
    let source = "\
        # Nobody\n\
        def behind(what):\n    \"\"\"Return half a frame.\n\n    It is what was\n    received.\n    \"\"\"\n\
        fail(\"goes on\")\n";
    assert_eq!(in_file(source, "py"), [(1, "nobody"), (5, "what was"), (8, "goes on")]);
}

/// Returns each wording found in the text, with the number of its first line and the replacement.
fn wordings(text: &str, extension: &str) -> impl Iterator<Item = (usize, &'static str, &'static str)> {
    let prose = match extension {
        "rs" => prose_of_source(text, "//"),
        "py" => prose_of_source(text, "#"),
        _ => prose_of_page(text),
    };
    // Words with their line numbers. An empty word marks the end of a sentence.
    let mut words: Vec<(usize, String)> = Vec::new();
    for (line, part) in prose {
        let part = part.to_lowercase();
        let part = without_code(&part);
        let split = part.split(|char: char| !char.is_alphanumeric() && char != '\'' && char != '_');
        words.extend(split.filter(|word| !word.is_empty()).map(|word| (line, word.to_owned())));
        if part.is_empty() {
            words.push((line, String::new()));
        }
    }
    (0..words.len()).flat_map(move |at| {
        let rest: Vec<_> = words[at..].iter().take(LONGEST).cloned().collect();
        WORDINGS.into_iter().filter_map(move |(wording, instead)| {
            let mut pairs = wording.split(' ').zip(&rest);
            let is_here =
                pairs.all(|(word, (_, here))| word == here) && wording.split(' ').count() <= rest.len();
            is_here.then(|| (rest[0].0, wording, instead))
        })
    })
}

/// Removes code in a text, such as `behind` and {told}.
fn without_code(text: &str) -> String {
    let outside_ticks: String = text.split('`').step_by(2).collect::<Vec<_>>().join(" ");
    let parts = outside_ticks.split('{').enumerate();
    parts
        .map(|(at, part)| if at == 0 { part } else { part.split_once('}').map_or(part, |(_, rest)| rest) })
        .collect()
}

/// Returns the comments and strings of a source by line. An empty part ends a comment.
fn prose_of_source(source: &str, marker: &str) -> Vec<(usize, String)> {
    let mut prose = Vec::new();
    let mut is_docstring = false;
    for (index, line) in source.replace("'\"'", "''").lines().enumerate() {
        let is_inside = is_docstring;
        is_docstring ^= marker == "#" && line.matches("\"\"\"").count() % 2 == 1;
        if is_inside {
            prose.push((index + 1, line.trim().to_owned()));
            continue;
        }
        // Only a comment on its own line continues the previous comment.
        let (code, comment) = match line.split_once(marker) {
            Some((code, comment)) if code.trim().is_empty() => ("", comment),
            Some((code, comment)) if !code.ends_with(':') => (code, comment),
            _ => (line, ""),
        };
        if !code.trim().is_empty() {
            prose.push((index + 1, String::new()));
            for string in code.split('"').skip(1).step_by(2) {
                prose.push((index + 1, string.to_owned()));
                prose.push((index + 1, String::new()));
            }
        }
        prose.push((index + 1, comment.trim_matches(['/', '!', ' ']).to_owned()));
    }
    prose
}

/// Returns the text of a Markdown page by line, without code blocks.
fn prose_of_page(page: &str) -> Vec<(usize, String)> {
    let mut is_code = false;
    let lines = page.lines().enumerate().map(|(index, line)| {
        is_code ^= line.trim_start().starts_with("```");
        (index + 1, if is_code { String::new() } else { line.to_owned() })
    });
    lines.collect()
}
