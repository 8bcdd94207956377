//! Checks that the modules of a crate do not import each other in a circle, and that no crate includes files of another.
//!
//! Reads `use` declarations and inline paths that begin with `crate::` or `super::`, and follows re-exports to the module
//! that defines the name. An import counts for every module around it too, so two siblings form a circle even if only
//! their submodules import each other. A module and its own submodules may import each other, and unit tests may import
//! anything.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use document::{files, root};

/// Known circles, by the names of their modules. This list may only shrink.
const KNOWN: &[&str] = &[];

/// The segments of a path. A module's path is relative to the crate root.
type Names = Vec<String>;
/// The imports of one module: the names that `use` binds, with their paths, and all paths in order.
type Imports = (BTreeMap<String, Names>, Vec<Names>);

#[test]
fn modules_of_every_crate_are_free_of_circles() {
    let (workspace, files) = (root(), files("rs"));
    let is_root =
        |file: &Path| matches!(file.file_stem().and_then(|stem| stem.to_str()), Some("lib" | "main"));
    let roots: Vec<&Path> =
        files.iter().filter(|file| is_root(file)).filter_map(|file| file.parent()).collect();
    assert!(roots.len() > 10, "{roots:?}");

    let mut found = BTreeMap::new();
    for root in &roots {
        // A binary below `src` is its own crate.
        let is_ours = |file: &&PathBuf| {
            roots.iter().filter(|root| file.starts_with(root)).max_by_key(|root| root.as_os_str().len())
                == Some(root)
        };
        let sources = files.iter().filter(is_ours).filter_map(|file| {
            let module = module_of(file.strip_prefix(root).unwrap())?;
            Some((module, fs::read_to_string(file).unwrap()))
        });
        for (circle, why) in circles(sources.collect()) {
            found.insert(circle, format!("{}:\n{why}", root.strip_prefix(&workspace).unwrap().display()));
        }
    }
    let new: Vec<String> = found
        .iter()
        .filter(|(circle, _)| !KNOWN.contains(&circle.as_str()))
        .map(|(circle, why)| format!("{circle}, in {why}"))
        .collect();
    assert!(new.is_empty(), "modules import each other: {}", new.join("\n"));
    for circle in KNOWN {
        assert!(found.contains_key(*circle), "remove `{circle}` from KNOWN: the circle no longer exists");
    }
}

/// A package has only the files of its folder: on a registry, and in the source distribution for Python. The programs of this
/// repository are in neither.
#[test]
fn packages_include_no_file_of_other_folders() {
    let workspace = root();
    let packages: Vec<PathBuf> = files("toml")
        .iter()
        .filter(|file| file.ends_with("Cargo.toml"))
        .filter_map(|file| file.parent().map(Path::to_owned))
        .filter(|folder| *folder != workspace)
        .filter(|folder| !["host-tests", "xtask"].iter().any(|name| folder.starts_with(workspace.join(name))))
        .collect();
    let (mut found, mut count) = (Vec::new(), 0);
    for file in files("rs") {
        let around = packages.iter().filter(|folder| file.starts_with(folder.join("src")));
        let Some(package) = around.max_by_key(|folder| folder.as_os_str().len()) else { continue };
        let text = fs::read_to_string(&file).unwrap();
        for included in text.split("include").skip(1) {
            let path = ["_str!(\"", "_bytes!(\"", "!(\""].iter().find_map(|call| included.strip_prefix(call));
            let Some((path, _)) = path.and_then(|path| path.split_once('"')) else { continue };
            count += 1;
            let mut whole = file.parent().unwrap().to_owned();
            for part in path.split('/') {
                if part == ".." {
                    whole.pop()
                } else {
                    whole.push(part);
                    true
                };
            }
            if !whole.starts_with(package) {
                found.push(format!("{}: {path}", file.display()));
            }
        }
    }
    assert!(count > 10 && found.is_empty(), "{count}: {found:?}");
}

/// Returns the circles of a crate that consists of these files.
fn planted<const N: usize>(files: [(&str, &str); N]) -> Vec<String> {
    let sources = files
        .iter()
        .filter_map(|(file, text)| Some((module_of(Path::new(file))?, text.to_string())))
        .collect();
    circles(sources).into_iter().map(|(circle, _)| circle).collect()
}

#[test]
fn circle_is_found_however_it_is_written() {
    let root = ("lib.rs", "mod a;\nmod b;\npub use b::B;\n");
    for import in [
        "use crate::b::B;",
        "use super::{\n    b::{B},\n    x,\n};",
        "use crate::B;",
        "fn a() -> crate::b::B {",
    ] {
        assert_eq!(planted([root, ("a.rs", import), ("b.rs", "use super::a;")]), ["a, b"], "{import}");
        assert!(planted([root, ("a.rs", import), ("b.rs", "// Not `crate::a`.")]).is_empty());
    }
    assert_eq!(
        planted([root, ("a.rs", "use crate::b;"), ("b.rs", "use crate::c;"), ("c.rs", "use crate::a;")]),
        ["a, b, c"]
    );
}

#[test]
fn circle_by_way_of_submodules_is_found() {
    let (root, a, b) = (("lib.rs", ""), ("a.rs", "mod x;"), ("b/mod.rs", "mod y;"));
    let files = [root, a, b, ("a/x.rs", "use crate::b;"), ("b/y.rs", "use super::super::a;")];
    assert_eq!(planted(files), ["a, b"]);
    let files = [root, a, ("a/x.rs", "use super::y;"), ("a/y.rs", "use crate::a::x;")];
    assert_eq!(planted(files), ["x, y"]);
}

#[test]
fn parents_children_and_tests_may_import_what_they_need() {
    let a = "mod x;\nuse x::X;\nuse crate::A;\n#[cfg(test)]\nmod tests {\n    use crate::b;\n}\n";
    let files = [
        ("lib.rs", "mod a;\nmod b;\npub use a::A;"),
        ("a.rs", a),
        ("a/x.rs", "use super::A;\nmod inside {\n    use super::X;\n}\n"),
        ("a/tests.rs", "use crate::b;"),
        ("b.rs", "use crate::a;"),
    ];
    assert!(planted(files).is_empty());
}

/// Returns the path of the module in a file, or `None` for unit tests.
fn module_of(file: &Path) -> Option<Names> {
    let mut names: Names = file.with_extension("").iter().map(|name| name.to_string_lossy().into()).collect();
    if names.iter().any(|name| name == "tests" || name.ends_with("_tests")) {
        return None;
    }
    names.pop_if(|last| ["lib", "main", "mod"].contains(&last.as_str()));
    Some(names)
}

/// Returns the circles among a crate's modules, each with the imports that form it.
fn circles(sources: BTreeMap<Names, String>) -> Vec<(String, String)> {
    let modules: BTreeMap<Names, Imports> =
        sources.into_iter().map(|(module, text)| (module, imports(&text))).collect();
    // By parent: which of its children import which, with the first such import.
    let mut siblings: BTreeMap<&[String], BTreeMap<(&str, &str), String>> = BTreeMap::new();
    for (from, (_, paths)) in &modules {
        for path in paths {
            let Some(to) = resolve(&modules, from, path, 0) else { continue };
            let common = from.iter().zip(&to).take_while(|(one, other)| one == other).count();
            // The key of the map outlives this iteration.
            let (to, _) = modules.get_key_value(&to).unwrap();
            if let (Some(one), Some(other)) = (from.get(common), to.get(common)) {
                let why = format!("  {} imports {}", from.join("::"), path.join("::"));
                siblings.entry(&from[..common]).or_default().entry((one, other)).or_insert(why);
            }
        }
    }
    let mut circles = vec![];
    for edges in siblings.values() {
        let reach = |from| {
            let mut seen = BTreeSet::new();
            let mut next = vec![from];
            while let Some(at) = next.pop() {
                next.extend(
                    edges.keys().filter(|(from, to)| *from == at && seen.insert(*to)).map(|edge| edge.1),
                );
            }
            seen
        };
        let reached: BTreeMap<&str, BTreeSet<&str>> =
            edges.keys().map(|(from, _)| (*from, reach(*from))).collect();
        let mut reported = BTreeSet::new();
        for (module, to) in &reached {
            let circle: Vec<&str> = to
                .iter()
                .copied()
                .filter(|it| reached.get(it).is_some_and(|it| it.contains(module)))
                .collect();
            if circle.is_empty() || !reported.insert(circle.clone()) {
                continue;
            }
            let inside = |edge: &(&str, &str)| circle.contains(&edge.0) && circle.contains(&edge.1);
            let why: Names =
                edges.iter().filter(|(edge, _)| inside(edge)).map(|(_, why)| why.clone()).collect();
            circles.push((circle.join(", "), why.join("\n")));
        }
    }
    circles
}

/// Returns the module that a path leads to, or `None` if it leaves the crate.
fn resolve(modules: &BTreeMap<Names, Imports>, from: &[String], path: &[String], depth: u8) -> Option<Names> {
    let mut at = from.to_vec();
    for (n, name) in path.iter().enumerate() {
        match name.as_str() {
            "crate" => at.clear(),
            "self" => {}
            "super" => drop(at.pop()),
            _ => {
                at.push(name.clone());
                if modules.contains_key(&at) {
                    continue;
                }
                at.pop();
                let passed_on = modules.get(&at)?.0.get(name).filter(|_| depth < 8);
                let beyond =
                    passed_on.and_then(|to| resolve(modules, &at, &[to, &path[n + 1..]].concat(), depth + 1));
                return beyond.or((n > 0).then_some(at));
            }
        }
    }
    Some(at)
}

/// Parses the imports of a module.
fn imports(text: &str) -> Imports {
    let (mut bound, mut paths) = (BTreeMap::new(), vec![]);
    let mut lines = text.lines().map(|line| line.split("//").next().unwrap_or_default().trim_end());
    // In an inline module, `super` is the file's module.
    let mut is_inline = false;
    let mut before = "";
    while let Some(line) = lines.next() {
        if line.contains("mod ") && line.ends_with('{') && !line.starts_with(' ') {
            is_inline = true;
            if before == "#[cfg(test)]" {
                lines.by_ref().find(|line| *line == "}");
                is_inline = false;
            }
        }
        is_inline &= line != "}";
        before = line;
        let code = line.trim_start();
        let is_visibility =
            |start: &str| start.is_empty() || (start.starts_with("pub") && !start.contains(" "));
        let is_use = code.split("use ").next().is_some_and(|start| is_visibility(start.trim_end()));
        let mut found = vec![];
        if is_use && code.contains("use ") {
            let mut statement = code.split_once("use ").unwrap().1.to_owned();
            while !statement.ends_with(';') {
                statement += lines.next().expect("the end of a use").trim_start();
            }
            expand(&[], statement.trim_end_matches(';'), &mut found);
            if !is_inline {
                bound.extend(found.iter().cloned());
            }
        } else {
            for head in ["crate::", "super::"] {
                let starts_a_path = |at: &usize| !code[..*at].ends_with(':');
                let starts = code.match_indices(head).map(|(at, _)| at).filter(starts_a_path);
                found.extend(starts.map(|at| {
                    let end = |c: char| !(c.is_alphanumeric() || c == '_' || c == ':');
                    let path = code[at..].split(end).next().unwrap_or_default();
                    (String::new(), path.split("::").map(str::to_owned).collect())
                }));
            }
        }
        for (_, mut path) in found {
            if is_inline && path[0] == "super" {
                path[0] = "self".to_owned();
            }
            paths.push(path);
        }
    }
    (bound, paths)
}

/// Expands a `use` tree into the names that it binds, with their paths.
fn expand(before: &[String], tree: &str, found: &mut Vec<(String, Names)>) {
    let (path, group) = match tree.split_once('{') {
        Some((path, group)) => (path, group.trim().strip_suffix('}')),
        None => (tree, None),
    };
    let (path, other_name) = path.split_once(" as ").map_or((path, None), |(path, name)| (path, Some(name)));
    let mut names = before.to_vec();
    names.extend(
        path.split("::").map(str::trim).filter(|name| !name.is_empty() && *name != "*").map(str::to_owned),
    );
    let Some(group) = group else {
        names.pop_if(|last| last == "self" && !before.is_empty());
        let bound = other_name.map(str::to_owned).or(names.last().cloned());
        found.extend(bound.map(|bound| (bound, names)));
        return;
    };
    let mut depth = 0;
    let is_between = |c: char| {
        depth += i32::from(c == '{') - i32::from(c == '}');
        c == ',' && depth == 0
    };
    group
        .split(is_between)
        .map(str::trim)
        .filter(|tree| !tree.is_empty())
        .for_each(|tree| expand(&names, tree, found));
}
