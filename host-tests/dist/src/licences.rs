//! Licences of everything linked into programs and libraries. `dist-c` contains this module as well.

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

/// Beginnings of the names of licence and notice files.
const FILES: [&str; 4] = ["LICENSE", "COPYING", "UNLICENSE", "NOTICE"];

/// A linked crate.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Part {
    name: String,
    version: String,
    licence: String,
    authors: String,
    /// Source folder.
    folder: PathBuf,
}

/// Lists all crates in the programs with their licences, followed by the licence texts. Each selection has cargo's arguments for the
/// package, features and target of a program.
///
/// # Errors
/// Fails when cargo fails or a crate has no licence.
pub(crate) fn text(what: &str, selections: &[&str]) -> Result<String> {
    text_of(what, &parts(selections)?)
}

fn text_of(what: &str, parts: &[Part]) -> Result<String> {
    let mut text = format!(
        "This folder is licensed under the MIT licence or the Apache License 2.0, at your option. The texts follow.\n\n\
         {what} these third-party parts. Where \"OR\" appears, either licence applies, at your option.\n\n"
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
            write!(text, " (by {}; provides no licence text, the standard text follows)", part.authors)?;
        }
        text.push('\n');
    }
    text.push_str(
        "  standard library and compiler_builtins of Rust: MIT OR Apache-2.0 (by the Rust project's contributors; parts of \
         compiler_builtins: Apache-2.0 WITH LLVM-exception)\n",
    );
    for (licence, names) in used {
        let names: Vec<_> = names.into_iter().collect();
        write!(text, "\n{}\n{}\n\n{licence}\n", "=".repeat(80), names.join(", "))?;
    }
    Ok(text)
}

/// Returns the third-party crates in the programs, sorted by name.
fn parts(selections: &[&str]) -> Result<Vec<Part>> {
    let mut linked: BTreeSet<(String, String)> = BTreeSet::new();
    for selection in selections {
        // Only `cargo tree` applies the features and leaves out build-time dependencies.
        let mut tree = vec!["tree", "--prefix", "none", "--edges", "normal,no-proc-macro", "--format", "{p}"];
        tree.extend(selection.split(' '));
        let parts = cargo(&tree)?;
        let parts = parts.lines().filter_map(|line| line.split_once(" v"));
        linked.extend(parts.map(|(name, rest)| (name.to_owned(), word(rest).to_owned())));
    }
    // The crate of Lua's C code, which is compiled by a build-time dependency.
    let has_lua = linked.iter().any(|(name, _)| name == "mlua-sys");
    let metadata: Value = serde_json::from_str(&cargo(&["metadata", "--format-version", "1"])?)?;
    let packages = metadata["packages"].as_array().context("cargo metadata lists no packages")?;
    let mut parts = Vec::new();
    for package in packages {
        let field = |name: &str| package[name].as_str().unwrap_or_default();
        // Packages without a source belong to this project.
        let is_linked = linked.contains(&(field("name").to_owned(), field("version").to_owned()));
        if package["source"].is_null() || !(is_linked || has_lua && field("name") == "lua-src") {
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
    fn a_text_shared_by_two_parts_appears_once() {
        let folder = env::temp_dir().join(format!("wsg-dist-licences-{}", std::process::id()));
        let part = |name: &str, text: &str| {
            let folder = folder.join(name);
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join("LICENSE-X"), text).unwrap();
            let [name, version, licence, authors] = [name, "1.0", "X", "unknown"].map(str::to_owned);
            Part { name, version, licence, authors, folder }
        };

        let text =
            text_of("It contains", &[part("a", "do as you like\n"), part("b", "do as you like\r\n\r\n")])
                .unwrap();

        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(text.matches("do as you like").count(), 1);
        assert!(text.contains("\na 1.0, b 1.0\n"), "{text}");
    }
}
