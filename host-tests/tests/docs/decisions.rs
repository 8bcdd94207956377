//! Checks docs/decisions.md: each decision names an existing test, or is marked as not built.

use std::collections::BTreeSet;
use std::fs;

use document::{files, read};

const DOCUMENT: &str = "docs/decisions.md";

/// Start of the last cell of a decision without an implementation.
const NOT_BUILT: &str = "not built yet";

/// Returns the names of all tests in the workspace.
fn tests() -> BTreeSet<String> {
    files("rs").iter().flat_map(|file| tests_in(&fs::read_to_string(file).unwrap())).collect()
}

fn tests_in(source: &str) -> Vec<String> {
    let mut names = Vec::new();
    let mut is_test = false;
    for line in source.lines().map(str::trim) {
        if line == "#[test]" || line.starts_with("#[tokio::test") {
            is_test = true;
        } else if let Some(rest) = ["pub(super) ", "async "]
            .iter()
            .fold(line, |line, word| line.strip_prefix(word).unwrap_or(line))
            .strip_prefix("fn ")
        {
            // A list for a macro names tests without parameters.
            let is_listed = rest.ends_with(';') && !rest.contains('(');
            if is_test || is_listed {
                names.push(rest.split(['(', ';']).next().unwrap().to_owned());
            }
            is_test = false;
        }
    }
    // Functions from which the macro makes tests.
    for list in ["on_every_board!(", "on_every_bus!("] {
        let lists = source.split(list).skip(1).filter_map(|rest| rest.split(");").next());
        let lists = lists.map(|list| list.split_once("=>").map_or(list, |(_, names)| names));
        names.extend(lists.flat_map(|list| list.split(',').map(|name| name.trim().to_owned())));
    }
    names
}

/// Returns the decisions: the cells of each table row, without the headings.
fn decisions(text: &str) -> Vec<Vec<&str>> {
    let rows = text.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| decision"));
    rows.map(|row| row.trim_matches('|').split(" | ").map(str::trim).collect()).collect()
}

#[test]
fn each_decision_names_tests_that_exist() {
    let text = read(DOCUMENT);
    let tests = tests();
    let decisions = decisions(&text);
    assert!(decisions.len() > 50, "{DOCUMENT} has {} decisions", decisions.len());
    for cells in decisions {
        let [decision, held_by] = cells[..] else {
            panic!("{DOCUMENT}: expected two cells, found {cells:?}")
        };
        let named: Vec<&str> = held_by.split('`').skip(1).step_by(2).collect();
        assert!(
            !named.is_empty() || held_by.starts_with(NOT_BUILT),
            "{DOCUMENT}: no test holds \"{decision}\""
        );
        for name in named {
            assert!(
                tests.contains(name),
                "{DOCUMENT}: test `{name}` not found; it should hold \"{decision}\""
            );
        }
    }
}

#[test]
fn tests_are_found_with_attributes_between_and_helpers_are_not() {
    let source = "#[test]\n#[ignore = \"x\"]\nfn a_test() {\n}\nfn helper() {}\n    #[test]\n    fn in_proptest(\n\
                  list! {\n    fn in_list;\n}\ntrait T {\n    fn method(&self);\n}\n";
    assert_eq!(tests_in(source), ["a_test", "in_proptest", "in_list"]);
}
