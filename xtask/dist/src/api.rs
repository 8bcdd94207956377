//! Compares the public API of each published crate, and the command line of each program, with the recorded ones in
//! `api`. A line that is missing now may break users.

use std::{collections::BTreeSet, fs, process::Command};

use anyhow::{Context, Result, bail, ensure};
use document::root;

use crate::release::{VERSION, cargo, published, target_dir};

/// Folder of the records.
const FOLDER: &str = "api";
/// Record of third-party items in public APIs: crate and item.
const THIRD_PARTY: &str = "third-party";

/// Compares public APIs and command lines with their records
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Write the records
    #[arg(long)]
    update: bool,
}

/// A record: name, and its lines now.
type Record = (String, String);

pub(crate) fn run(Arguments { update }: &Arguments) -> Result<()> {
    let mut records = command_lines();
    records.extend(apis()?);
    if *update {
        ensure!(
            fs::read_to_string(root().join("CHANGELOG.md"))?
                .contains(&format!("\n## Unreleased ({VERSION})\n")),
            "{VERSION} is released: raise the version in Cargo.toml, and add \"## Unreleased (VERSION)\" to CHANGELOG.md"
        );
        fs::create_dir_all(root().join(FOLDER))?;
    }
    let mut differing = Vec::new();
    for (name, now) in &records {
        let path = root().join(FOLDER).join(name).with_extension("txt");
        let recorded = fs::read_to_string(&path).unwrap_or_default();
        if let Some(difference) = difference(&recorded, now) {
            println!("{FOLDER}/{name}.txt\n{difference}");
            differing.push(name.as_str());
        }
        if *update {
            fs::write(&path, now).with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    println!(
        "api: {} records, {} lines",
        records.len(),
        records.iter().map(|(_, it)| it.lines().count()).sum::<usize>()
    );
    if !differing.is_empty() && !update {
        bail!(
            "the public interface of {} differs from its record; expected no change without an entry in CHANGELOG.md and, \
             for each line with -, a new minor version: add them, then run `cargo xtask api --update`",
            differing.join(", ")
        );
    }
    if *update { Ok(()) } else { compare_with_recorded() }
}

/// Compares the published crates with the crates in the commit that last changed the records. The records leave out
/// derived implementations, and do not show which change breaks users.
fn compare_with_recorded() -> Result<()> {
    let mut log = Command::new("git");
    let log = log.current_dir(root()).args(["log", "-1", "--format=%H", "--", FOLDER]).output();
    let commit = String::from_utf8(log.context("cannot run git")?.stdout)?;
    ensure!(!commit.is_empty(), "no commit contains {FOLDER}; expected a git repository with the records");
    let mut checks = cargo("semver-checks --quiet --all-features --baseline-rev");
    checks.arg(commit.trim()).args(published()?.iter().flat_map(|name| ["--package", name]));
    ensure!(
        checks.status().context("cannot run cargo")?.success(),
        "a public interface breaks users of the one recorded in {}; expected a new minor version and an entry in CHANGELOG.md",
        commit.trim()
    );
    println!("api: compatible with {}", commit.trim());
    Ok(())
}

/// Returns the added and removed lines, or `None` if the texts are equal.
fn difference(recorded: &str, now: &str) -> Option<String> {
    let (before, after): (BTreeSet<_>, BTreeSet<_>) = (recorded.lines().collect(), now.lines().collect());
    let removed = before.difference(&after).map(|line| format!("- {line}"));
    let added = after.difference(&before).map(|line| format!("+ {line}"));
    (recorded != now).then(|| removed.chain(added).collect::<Vec<_>>().join("\n"))
}

/// Returns the public items of each published crate with all features, and the third-party items in them.
fn apis() -> Result<Vec<Record>> {
    let (mut records, mut third_party) = (Vec::new(), BTreeSet::new());
    let built = target_dir().join("public-api");
    let published = published()?;
    let own: Vec<_> = published.iter().map(|name| name.replace('-', "_")).collect();
    for name in published {
        // Without implementations that are derived or apply to every type. rustdoc's JSON needs nightly.
        let mut api = Command::new("rustup");
        let line = "run nightly cargo public-api -sss --all-features -p";
        api.current_dir(root()).args(line.split(' ')).arg(&name);
        // The calling cargo's variables would select its own tool chain.
        api.env_remove("CARGO").env_remove("RUSTC").env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTDOC");
        let output = api.arg("--target-dir").arg(&built).output().context("cannot run rustup")?;
        ensure!(
            output.status.success(),
            "cargo public-api {name}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let items = String::from_utf8(output.stdout)?;
        third_party.extend(roots(&items, &own).map(|item| format!("{name} {item}")));
        let items = items
            .replace(&format!("{}::", name.replace('-', "_")), "")
            .replace("core::option::Option", "Option");
        records.push((name, items.replace("core::result::Result", "Result")));
    }
    let lines: Vec<_> = third_party.into_iter().map(|line| line + "\n").collect();
    records.push((THIRD_PARTY.to_owned(), lines.concat()));
    Ok(records)
}

/// Returns the third-party paths in a list of public items.
fn roots<'a>(items: &'a str, own: &'a [String]) -> impl Iterator<Item = &'a str> {
    let is_part_of_path = |letter: char| letter.is_alphanumeric() || letter == '_' || letter == ':';
    let paths = items.split(move |letter| !is_part_of_path(letter));
    let paths = paths.map(|path| path.trim_end_matches(':')).filter(|path| path.contains("::"));
    paths.filter(move |path| {
        let root = path.split("::").next().unwrap_or_default();
        let is_own = own.iter().any(|own| own == root);
        !is_own && !["", "core", "alloc", "std"].contains(&root) && root.starts_with(char::is_lowercase)
    })
}

/// Returns the help of each command and subcommand of both programs.
fn command_lines() -> Vec<Record> {
    [wsg_tool::command(), wsg_sim::server::command()]
        .into_iter()
        .map(|command| {
            let name = command.get_name().to_owned();
            let mut text = String::new();
            // The width of a terminal must not matter.
            describe(&mut command.term_width(100), &name, &mut text);
            (format!("command-{name}"), text)
        })
        .collect()
}

fn describe(command: &mut clap::Command, path: &str, text: &mut String) {
    let help = command.render_long_help().to_string();
    let lines: Vec<_> = help.lines().map(str::trim_end).collect();
    text.push_str(&format!("$ {path} --help\n{}\n\n", lines.join("\n").trim_end()));
    for subcommand in command.get_subcommands_mut() {
        let path = format!("{path} {}", subcommand.get_name());
        let mut subcommand = subcommand.clone().term_width(100);
        describe(&mut subcommand, &path, text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_lines_are_those_of_the_record() {
        for (name, now) in command_lines() {
            assert!(now.contains("--help") && now.lines().count() > 50, "{name}");
            let recorded = fs::read_to_string(root().join(FOLDER).join(&name).with_extension("txt")).unwrap();
            let difference = difference(&recorded, &now);
            assert_eq!(difference, None, "changed: run `cargo xtask api --update`, and see CONTRIBUTING.md");
        }
    }

    #[test]
    fn a_difference_names_added_and_removed_lines_and_a_new_order() {
        assert_eq!(difference("a\nb\n", "a\nb\n"), None);
        assert_eq!(difference("a\nb\n", "b\nc\n").unwrap(), "- a\n+ c");
        assert!(difference("a\nb\n", "b\na\n").is_some());
    }

    #[test]
    fn paths_of_other_crates_are_third_party() {
        let items = "pub fn own::f(a: embedded_can::Id, b: core::option::Option<own::T>) -> Self::Error\n\
                     impl<F: nb::Error> own::T<F>::g(F::Id)\n";
        let own = ["own".to_owned()];
        assert_eq!(roots(items, &own).collect::<Vec<_>>(), ["embedded_can::Id", "nb::Error"]);
    }
}
