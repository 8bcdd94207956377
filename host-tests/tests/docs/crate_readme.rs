//! Checks protocol/README.md: its examples against the compiled ones, its tables against Cargo.toml.

use document::read;

const DOCUMENT: &str = "protocol/README.md";

/// Returns the first example in a crate's documentation.
fn first_example(source: &str) -> String {
    let doc = source
        .lines()
        .map_while(|line| line.strip_prefix("//!"))
        .map(|line| line.strip_prefix(' ').unwrap_or(line));
    let example = doc.skip_while(|line| *line != "```").skip(1).take_while(|line| *line != "```");
    example.collect::<Vec<_>>().join("\n")
}

#[test]
fn quick_start_comes_first_and_is_the_example_that_is_run() {
    let source = read("protocol/examples/quick_start.rs");
    let program = source.split_once("\n\n").unwrap().1.split("#[cfg(test)]").next().unwrap().trim_end();
    assert!(program.contains("fn main()"));
    let readme = read(DOCUMENT);
    let (_, first) = readme.split_once("```rust\n").unwrap();
    assert_eq!(first.split("\n```").next().unwrap(), program);
}

#[test]
fn example_is_the_one_compiled_in_the_crates_documentation() {
    let example = first_example(&read("protocol/src/lib.rs"));
    assert!(example.contains("FrameParser"));
    assert!(
        read(DOCUMENT).contains(&format!("```rust\n{example}\n```")),
        "{DOCUMENT} has a different example"
    );
}

#[test]
fn features_are_those_of_the_manifest() {
    let manifest = read("protocol/Cargo.toml");
    let section = |name: &str| {
        let lines = manifest.lines().skip_while(move |line| line.trim() != name).skip(1);
        lines.take_while(|line| !line.starts_with('[')).map(str::to_owned).collect::<Vec<_>>()
    };
    let key = |line: &String| line.split([' ', '=', '.']).next().unwrap().to_owned();
    let is_entry = |line: &&String| line.contains('=') && !line.starts_with('#');
    let features = section("[features]");
    let mut named: Vec<String> =
        features.iter().filter(is_entry).map(key).filter(|name| name != "default").collect();
    // An optional dependency without a `dep:` entry is a feature itself.
    let dependencies = section("[dependencies]");
    let optional = dependencies.iter().filter(|line| line.contains("optional = true")).map(key);
    named.extend(optional.filter(|name| !manifest.contains(&format!("\"dep:{name}\""))));

    let readme = read(DOCUMENT);
    let rows: Vec<&str> = readme
        .lines()
        .skip_while(|line| !line.starts_with("| feature"))
        .skip(2)
        .map_while(|line| line.strip_prefix("| `")?.split('`').next())
        .collect();
    named.sort();
    let mut reported: Vec<String> = rows.iter().map(|row| (*row).to_owned()).collect();
    reported.sort();
    assert_eq!(reported, named);
}

#[test]
fn least_rust_version_is_that_of_the_workspace() {
    let manifest = read("Cargo.toml");
    let version =
        manifest.lines().find_map(|line| line.strip_prefix("rust-version = ")).unwrap().trim_matches('"');
    for document in [DOCUMENT, "README.md"] {
        assert!(read(document).contains(&format!("Rust {version}")), "{document} must state Rust {version}");
    }
}
