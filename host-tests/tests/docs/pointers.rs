//! Checks the references of the documents: files, xtask commands and environment variables exist.

use std::path::{Path, PathBuf};

use document::{anchor_of, read, root};

/// Documents outside `docs/`, and the contents of `docs/`.
const DOCUMENTS: [&str; 15] = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "CODE_OF_CONDUCT.md",
    "SECURITY.md",
    "docs/SUMMARY.md",
    "protocol/README.md",
    "fieldbus/README.md",
    "buses/modbus/README.md",
    "buses/slcan/README.md",
    "buses/canopen/README.md",
    "buses/profibus/README.md",
    "buses/profinet/README.md",
    "buses/ethernetip/README.md",
];

/// Returns the paths of all documents.
fn documents() -> Vec<String> {
    let pages = std::fs::read_dir(root().join("docs")).unwrap();
    let pages = pages.map(|page| format!("docs/{}", page.unwrap().file_name().to_str().unwrap()));
    let pages = pages.filter(|page| page.ends_with(".md") && page != "docs/SUMMARY.md");
    DOCUMENTS.map(str::to_owned).into_iter().chain(pages).collect()
}

#[test]
fn contents_list_every_page() {
    let contents = read("docs/SUMMARY.md");
    for page in documents() {
        if let Some(page) = page.strip_prefix("docs/").filter(|page| *page != "SUMMARY.md") {
            assert!(contents.contains(&format!("]({page})")), "docs/SUMMARY.md does not list {page}");
        }
    }
}

#[test]
fn citation_has_the_version() {
    assert!(read("CITATION.cff").contains(concat!("\nversion: ", env!("CARGO_PKG_VERSION"), "\n")));
}

#[test]
fn links_lead_to_files_of_this_repository() {
    for document in documents() {
        let text = read(&document);
        let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for target in targets.filter(|target| !target.starts_with("https://")) {
            let folder = Path::new(&document).parent().unwrap();
            let (file, heading) = target.split_once('#').unwrap_or((target, ""));
            let file = if file.is_empty() { PathBuf::from(&document) } else { folder.join(file) };
            assert!(root().join(&file).exists(), "{document} points at {target}");
            let file = file.to_str().unwrap();
            let has_heading = || read(file).lines().filter_map(anchor).any(|anchor| anchor == heading);
            assert!(heading.is_empty() || has_heading(), "{document} points at {target}");
        }
    }
}

/// Denials that a document must not contain, each with the source that contradicts it.
const EXISTING: [(&str, &str, &str); 2] = [
    ("docs/simulator.md", "\n- PROFINET.", "gripper-sim/src/server/profinet.rs"),
    ("docs/wiring.md", "no watchdog", "host-tests/src/iwdg.rs"),
];

#[test]
fn documents_deny_nothing_that_exists() {
    for (document, denial, source) in EXISTING {
        assert!(root().join(source).exists(), "{source} no longer exists; remove its row from EXISTING");
        assert!(!read(document).contains(denial), "{document} denies {source}");
    }
}

/// Returns the anchor of a heading, or `None` for any other line.
fn anchor(line: &str) -> Option<String> {
    let heading = line.strip_prefix('#')?.trim_start_matches('#').strip_prefix(' ')?;
    Some(anchor_of(heading))
}

#[test]
fn commands_of_xtask_are_those_that_its_help_lists() {
    let arguments = read("xtask/src/main.rs");
    for document in documents() {
        let text = read(&document);
        for rest in text.split("cargo xtask ").skip(1) {
            let command: String = rest
                .chars()
                .take_while(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || *c == '-')
                .collect();
            // clap adds `help`, and derives the other names from the variants of an enum.
            let words = command.split('-').map(|word| word[..1].to_uppercase() + &word[1..]);
            let variant = format!("\n    {}", words.collect::<String>());
            let is_listed = [",", "(", " {"].iter().any(|end| arguments.contains(&(variant.clone() + end)));
            assert!(is_listed || command == "help", "{document}: no `cargo xtask {command}`");
        }
    }
}

#[test]
fn environment_variables_are_known_to_the_code() {
    // Constants of the C library have the same prefix.
    let code = [
        "xtask/src/main.rs",
        "xtask/src/commands.rs",
        "xtask/src/firmware.rs",
        "xtask/document/src/lib.rs",
        "bindings/c/include/wsg.h",
        "bindings/c-host/include/wsg_host.h",
        "bindings/c/package/wsg-config.cmake",
    ]
    .map(read);
    for document in documents() {
        let text = read(&document);
        // After an underscore, it is part of another name. With a single letter, it is a bitmap of a GSD file.
        for (at, _) in text.match_indices("WSG_").filter(|(at, _)| !text[..*at].ends_with('_')) {
            let rest = &text[at + "WSG_".len()..];
            let rest: String = rest.chars().take_while(|c| c.is_ascii_uppercase() || *c == '_').collect();
            let variable = format!("WSG_{rest}");
            assert!(
                rest.len() == 1 || code.iter().any(|code| code.contains(&variable)),
                "{document}: {variable} is not known"
            );
        }
    }
}

#[test]
fn map_in_the_architecture_names_every_part_of_the_workspace() {
    let map = read("ARCHITECTURE.md");
    let manifest = read("Cargo.toml");
    let members = manifest.lines().find(|line| line.starts_with("members")).unwrap();
    for member in members.split('"').skip(1).step_by(2) {
        // The members of a folder `x/*` are each named in the map.
        let row = member.strip_suffix('*').map_or(format!("| `{member}/`"), |folder| format!("| `{folder}"));
        assert!(map.contains(&row), "ARCHITECTURE.md has no row for {member}");
    }
}

#[test]
fn no_document_names_a_local_path() {
    for document in documents() {
        let text = read(&document);
        for place in ["/work", "/root", "/home/", "/Users/"] {
            assert!(!text.contains(place), "{document} names {place}");
        }
    }
}

/// A package that is published contains only the files of its own folder.
#[test]
fn each_published_crate_has_the_licences() {
    let folders = ["protocol", "protocol/macros", "fieldbus"].map(|folder| root().join(folder));
    let buses = std::fs::read_dir(root().join("buses")).unwrap().map(|bus| bus.unwrap().path());
    for folder in folders.into_iter().chain(buses) {
        let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
        assert!(!manifest.contains("publish.workspace"), "{} is published", folder.display());
        for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
            let own = std::fs::read_to_string(folder.join(name));
            assert_eq!(own.ok(), Some(read(name)), "{name} of {}", folder.display());
        }
    }
}
