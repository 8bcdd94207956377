//! What a delivered file is made of: the licences of everything linked into it, and flags that keep the paths of this
//! machine out of it.

use std::{
    collections::{BTreeMap, BTreeSet},
    env,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};
use document::root;
use serde_json::Value;

/// Crates with sources in C that their build script compiles into a program.
const LINKED_BY_BUILD: [&str; 1] = ["lua-src"];

/// Parts of the standard library in every program.
const STANDARD: &str = "  Rust's standard library (an image contains only core and compiler_builtins): MIT OR Apache-2.0 (by the Rust \
                        project's contributors; parts of compiler_builtins: Apache-2.0 WITH LLVM-exception)\n";

/// Beginnings of the names of licence and notice files.
const FILES: [&str; 4] = ["LICENSE", "COPYING", "UNLICENSE", "NOTICE"];

/// A crate in a program.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Part {
    name: String,
    version: String,
    licence: String,
    authors: String,
    folder: PathBuf,
}

/// Lists all crates in an image, in libraries or in programs with their licences, followed by the licence texts. Each
/// selection has cargo's arguments for packages, features and target.
///
/// # Errors
/// Fails when cargo fails or a crate has no licence.
pub fn licences(selections: &[&str]) -> Result<String> {
    text_of(&parts(selections)?)
}

/// Returns rustc's flags that shorten the paths of this machine in everything that it builds, so that two machines
/// build the same file.
#[must_use]
pub fn path_flags(target_dir: &Path) -> Vec<String> {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from).or_else(|| Some(env::home_dir()?.join(".cargo")));
    // rustc uses the last match, and the target folder may lie within the checkout.
    let places = [(Some(root()), "."), (Some(target_dir.to_owned()), "target"), (home, "cargo")];
    let known = places.into_iter().filter_map(|(place, name)| Some((place?, name)));
    known.map(|(place, name)| format!("--remap-path-prefix={}={name}", place.display())).collect()
}

/// Sets the flags of a build to [`path_flags`] and `more`.
pub fn remove_paths(cargo: &mut Command, target_dir: &Path, more: &[&str]) {
    let mut flags = path_flags(target_dir);
    flags.extend(more.iter().map(|flag| (*flag).to_owned()));
    cargo.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\u{1f}"));
}

fn text_of(parts: &[Part]) -> Result<String> {
    let mut text = String::from(
        "This software is licensed under the MIT licence or the Apache License 2.0, at your option. The texts follow.\n\n\
         It contains these third-party parts. Where \"OR\" appears, either licence applies, at your option.\n\n",
    );
    let mut used: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut texts = |name: &str, folder: &Path| -> Result<bool> {
        let found = licence_files(folder)?;
        let has_some = !found.is_empty();
        for file in found {
            used.entry(file).or_default().insert(name.to_owned());
        }
        Ok(has_some)
    };
    texts("this project", &root())?;
    for part in parts {
        let name = format!("{} {}", part.name, part.version);
        write!(text, "  {name}: {}", part.licence)?;
        if !texts(&name, &part.folder)? {
            let by = if part.authors.is_empty() { "" } else { &format!("by {}; ", part.authors) };
            write!(text, " ({by}provides no licence text, the standard text follows)")?;
        }
        text.push('\n');
    }
    text.push_str(STANDARD);
    for (licence, names) in used {
        let names: Vec<_> = names.into_iter().collect();
        write!(text, "\n{}\n{}\n\n{licence}\n", "=".repeat(80), names.join(", "))?;
    }
    Ok(text)
}

/// Returns the third-party crates, sorted by name.
fn parts(selections: &[&str]) -> Result<Vec<Part>> {
    let mut linked = BTreeSet::new();
    for selection in selections {
        // Only `cargo tree` applies features and leaves out build-time dependencies.
        let crates = |edges: &str| -> Result<Vec<(String, String)>> {
            let mut tree = vec!["tree", "--prefix", "none", "--format", "{p}", "--edges", edges];
            tree.extend(selection.split(' '));
            let tree = cargo(&tree)?;
            let crates = tree.lines().filter_map(|line| line.split_once(" v"));
            Ok(crates.map(|(name, rest)| (name.to_owned(), word(rest).to_owned())).collect())
        };
        linked.extend(crates("normal,no-proc-macro")?);
        let mut by_build = crates("normal,build,no-proc-macro")?;
        by_build.retain(|(name, _)| LINKED_BY_BUILD.contains(&name.as_str()));
        linked.extend(by_build);
    }
    let metadata: Value = serde_json::from_str(&cargo(&["metadata", "--format-version", "1"])?)?;
    let packages = metadata["packages"].as_array().context("cargo metadata lists no packages")?;
    let mut parts = Vec::new();
    for package in packages {
        let field = |name: &str| package[name].as_str().unwrap_or_default();
        // Packages without a source belong to this project.
        if package["source"].is_null()
            || !linked.contains(&(field("name").to_owned(), field("version").to_owned()))
        {
            continue;
        }
        ensure!(!field("license").is_empty(), "{} declares no licence", field("name"));
        let authors = package["authors"].as_array().into_iter().flatten().filter_map(Value::as_str);
        parts.push(Part {
            name: field("name").to_owned(),
            version: field("version").to_owned(),
            licence: field("license").to_owned(),
            authors: authors.collect::<Vec<_>>().join(", "),
            folder: Path::new(field("manifest_path")).parent().unwrap_or(Path::new("")).to_owned(),
        });
    }
    parts.sort();
    Ok(parts)
}

fn word(text: &str) -> &str {
    text.split(' ').next().unwrap_or_default()
}

/// Returns the licence texts in a folder, each in a file or in a subfolder of licences.
fn licence_files(folder: &Path) -> Result<Vec<String>> {
    let mut texts = Vec::new();
    let entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    for path in entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<Vec<_>, _>>()? {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        if !FILES.iter().any(|file| name.starts_with(file)) {
            continue;
        }
        if path.is_dir() {
            for entry in fs::read_dir(&path)? {
                texts.push(fs::read_to_string(entry?.path())?);
            }
        } else {
            texts.push(fs::read_to_string(&path)?);
        }
    }
    // Lua's own notice ends its header.
    if let Ok(header) = fs::read_to_string(folder.join("lua-5.1.5/lua.h")) {
        let notice = header.rfind("* Copyright (C)").context("lua.h has no copyright notice")?;
        let notice = header[notice..].split("\n***").next().unwrap_or_default();
        texts.push(notice.replace("\n* ", "\n").replace("\n*\n", "\n\n").replace("* Copy", "Copy"));
    }
    Ok(texts.iter().map(|text| tidy(text)).collect())
}

/// Normalizes line endings and blank edges, so that equal texts of two crates compare equal.
fn tidy(text: &str) -> String {
    let lines: Vec<_> = text.lines().map(str::trim_end).collect();
    lines.join("\n").trim_matches('\n').to_owned()
}

fn cargo(arguments: &[&str]) -> Result<String> {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    let output =
        cargo.current_dir(root()).arg("--locked").args(arguments).output().context("cannot run cargo")?;
    let what = arguments.first().unwrap_or(&"");
    ensure!(output.status.success(), "cargo {what}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).with_context(|| format!("the output of cargo {what} is not UTF-8"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_of_the_image_is_named_and_has_a_text() {
        let text =
            licences(&["--package wsg-b-l475e-iot01a --features firmware --target thumbv7em-none-eabihf"]);
        let text = text.unwrap();

        for part in ["cortex-m ", "heapless ", "embedded-io ", "stm32-metapac ", "crc "] {
            assert!(text.contains(&format!("\n  {part}")), "{part}");
        }
        // Used only at build time or only on the host.
        for other in ["syn ", "proptest ", "anyhow ", "object "] {
            assert!(!text.contains(&format!("\n  {other}")), "{other}");
        }
        assert!(text.contains("Permission is hereby granted") && text.contains("Apache License"));
        assert!(!text.contains(root().to_str().unwrap()));
    }

    #[test]
    fn programs_name_the_library_in_c_that_a_build_script_compiles() {
        let text = licences(&["--package wsg-python"]).unwrap();
        assert!(text.contains("\n  lua-src ") && text.contains("Lua.org, PUC-Rio"));
        assert!(text.contains("\n  pyo3 "));
        assert!(!text.contains("\n  cc "));
    }

    #[test]
    fn a_text_shared_by_two_parts_appears_once() {
        let folder = env::temp_dir().join(format!("wsg-dist-licences-{}", std::process::id()));
        let part = |name: &str, text: &str| {
            let folder = folder.join(name);
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join("LICENSE-X"), text).unwrap();
            let [name, version, licence, authors] = [name, "1.0", "X", "unknown"].map(str::to_owned);
            Part { name, version, licence, authors, folder }
        };

        let text = text_of(&[part("a", "do as you like\n"), part("b", "do as you like\r\n\r\n")]).unwrap();

        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(text.matches("do as you like").count(), 1);
        assert!(text.contains("\na 1.0, b 1.0\n"), "{text}");
    }
}
