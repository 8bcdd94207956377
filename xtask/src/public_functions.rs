//! The public functions of the crates for boards, as rustdoc finds them, against those that the probe `functions` names. Both
//! sides are the compiler's, so a function counts for its own type only, whatever others are called.

use std::{collections::BTreeMap, fs};

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use crate::{
    matrix, process,
    workspace::{TARGET_CRATES, Workspace},
};

/// Functions by path, such as `wsg_protocol::frame::parser::FrameParser::push`, and how many there are of it: `new` may be
/// there for two kinds of one generic type.
pub(crate) type Functions = BTreeMap<String, usize>;

/// Those of all crates.
pub(crate) fn of_crates(workspace: &Workspace) -> Result<Functions> {
    let mut all = Functions::new();
    for (package, folder) in TARGET_CRATES {
        let features = matrix::features(&workspace.root.join(folder).join("Cargo.toml"))?;
        all.extend(of_crate(workspace, package, &features.join(","))?);
    }
    Ok(all)
}

/// Those of a crate, with these features.
fn of_crate(workspace: &Workspace, package: &str, features: &str) -> Result<Functions> {
    let target_dir = workspace.target_dir.join("functions");
    let mut rustdoc = workspace.cargo("rustdoc");
    rustdoc.args(["--quiet", "-p", package, "--lib", "--no-default-features", "--features", features]);
    rustdoc.arg("--target-dir").arg(&target_dir).args(["--", "-Z", "unstable-options"]);
    rustdoc.args(["--output-format", "json", "--document-hidden-items"]);
    // rustdoc's JSON is not stable: another compiler may give another form, which is then said and not passed over.
    process::run(rustdoc.env("RUSTC_BOOTSTRAP", "1"))?;
    let path = target_dir.join(format!("doc/{}.json", package.replace('-', "_")));
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let functions = of_rustdoc(&serde_json::from_str(&text)?);
    ensure!(
        !functions.is_empty(),
        "rustdoc's JSON has another form: no function of {package} is found in it"
    );
    Ok(functions)
}

/// Those that the probe names.
pub(crate) fn of_probe(workspace: &Workspace) -> Result<Functions> {
    let mut probe = workspace.cargo("run");
    probe.args(["--quiet", "-p", "wsg-probes"]);
    probe.args(["--features", "every-function", "--bin", "functions"]);
    Ok(counted(process::output(&mut probe)?.lines().map(path_of)))
}

/// Those of the crates that the probe lacks.
pub(crate) fn missing(of_crates: &Functions, of_probe: &Functions) -> Vec<String> {
    let lacks = |(path, count): &(&String, &usize)| of_probe.get(*path).is_none_or(|there| there < *count);
    of_crates.iter().filter(lacks).map(|(path, _)| path.clone()).collect()
}

fn counted(paths: impl Iterator<Item = String>) -> Functions {
    let mut functions = Functions::new();
    for path in paths {
        *functions.entry(path).or_default() += 1;
    }
    functions
}

/// What is written in the crate and can be called: functions, methods, and methods of traits for its types. Left out: what is
/// derived, comes with every type or is made by `bitflags`, async functions, `Display`, `Debug` and `defmt::Format`, and `Hash`,
/// by which only the exploration on the host tells states apart.
fn of_rustdoc(crate_docs: &Value) -> Functions {
    let items = &crate_docs["index"];
    let path_of = |id: &Value| {
        let words = crate_docs["paths"][id.to_string()]["path"].as_array()?;
        Some(words.iter().filter_map(Value::as_str).collect::<Vec<_>>().join("::"))
    };
    let each = || items.as_object().into_iter().flat_map(|items| items.values());
    let is_of_flags = |item: &&Value| item["inner"]["impl"]["trait"]["path"] == "Flags";
    let flags: Vec<&Value> = each().filter(is_of_flags).map(|item| &item["span"]).collect();
    let is_listed = |item: &Value| {
        let is_for_the_host = ["fmt", "format", "hash"].iter().any(|name| item["name"] == *name);
        let is_async = item["inner"]["function"]["header"]["is_async"] == true;
        !item["inner"]["function"].is_null()
            && !is_for_the_host
            && !is_async
            && !flags.contains(&&item["span"])
    };
    let free = each().filter(|item| is_listed(item)).filter_map(|item| path_of(&item["id"]));
    let is_derived = |item: &Value| item["attrs"].to_string().contains("automatically_derived");
    let is_blanket = |item: &Value| !item["inner"]["impl"]["blanket_impl"].is_null();
    let implementations = each().filter(|item| !is_derived(item) && !is_blanket(item));
    let methods = implementations.flat_map(|item| {
        let implementation = &item["inner"]["impl"];
        let of = path_of(&implementation["for"]["resolved_path"]["id"]);
        let its = implementation["items"].as_array().into_iter().flatten();
        let its = its.map(|id| &items[id.to_string()]).filter(|item| is_listed(item));
        its.filter_map(move |item| Some(format!("{}::{}", of.as_ref()?, item["name"].as_str()?)))
    });
    counted(free.chain(methods))
}

/// The path in a function's name as the compiler gives it: `a::T<X>::f`, `a::<impl b::T<X>>::f` or `<a::T<X> as Trait>::f`.
fn path_of(name: &str) -> String {
    let at = if name.starts_with('<') { Some(0) } else { name.find("<impl ") };
    let Some(at) = at else { return without_parameters(name) };
    let (of, function) = name.split_at(at + length_of_parameters(&name[at..]));
    let of = without_parameters(&of[at + 1..of.len() - 1]);
    let of = of.trim_start_matches("impl ").split(" as ").next().unwrap_or_default();
    format!("{of}{}", without_parameters(function))
}

/// Without each `<...>`.
fn without_parameters(name: &str) -> String {
    let mut rest = name;
    let mut path = String::new();
    while let Some(at) = rest.find('<') {
        path.push_str(&rest[..at]);
        rest = &rest[at + length_of_parameters(&rest[at..])..];
    }
    path + rest
}

/// The length of the `<...>` that the text begins with. The `>` of `->` closes nothing.
fn length_of_parameters(text: &str) -> usize {
    let mut depth = 0_i32;
    let mut before = ' ';
    let end = text.find(|c| {
        depth += i32::from(c == '<') - i32::from(c == '>' && before != '-');
        before = c;
        depth == 0
    });
    end.map_or(text.len(), |end| end + 1)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn functions(names: &[&str]) -> Functions {
        counted(names.iter().map(|name| path_of(name)))
    }

    #[test]
    fn a_path_is_read_from_each_form_of_a_name() {
        assert_eq!(path_of("p::checksum::update"), "p::checksum::update");
        assert_eq!(path_of("p::frame::Parser<64>::push"), "p::frame::Parser::push");
        assert_eq!(path_of("p::Server::push<fn(&[u8]) -> a::B<usize>>"), "p::Server::push");
        assert_eq!(path_of("p::other::<impl p::frame::Parser<64>>::push<X>"), "p::frame::Parser::push");
        assert_eq!(path_of("<p::Frames<a::B<'_>> as core::Iterator<X>>::next"), "p::Frames::next");
    }

    #[test]
    fn a_function_of_the_same_name_of_another_type_does_not_count() {
        let of_crate = functions(&["p::types::SystemLimits::push", "p::frame::Parser::push"]);

        assert_eq!(
            missing(&of_crate, &functions(&["p::frame::Parser<64>::push", "p::frame::Parser<8>::push"])),
            ["p::types::SystemLimits::push"]
        );
        assert_eq!(missing(&of_crate, &of_crate), [""; 0]);
    }

    #[test]
    fn of_two_implementations_both_must_be_named() {
        let of_crate = functions(&["p::Driver<p::Binary>::new", "p::Driver<p::Gcl>::new"]);

        assert_eq!(missing(&of_crate, &functions(&["p::Driver<p::Binary>::new"])), ["p::Driver::new"]);
    }

    #[test]
    fn what_is_written_in_the_crate_is_found_with_its_type() {
        let function = |id: u32, name: &str, is_async: bool, line: u32| {
            let function = json!({"header": {"is_async": is_async}});
            json!({"id": id, "name": name, "attrs": [], "span": line, "inner": {"function": function}})
        };
        let implementation = |of: u32, of_trait: Value, items: Value, attrs: Value| {
            let inner = json!({"for": {"resolved_path": {"id": of}}, "trait": of_trait, "items": items});
            json!({"attrs": attrs, "span": 90, "inner": {"impl": inner}})
        };
        let found = of_rustdoc(&json!({
            "paths": {"1": {"path": ["p", "update"]}, "2": {"path": ["p", "frame", "Parser"]}},
            "index": {
                "1": function(1, "update", false, 1),
                "3": function(3, "push", false, 3),
                "4": function(4, "wait", true, 4),
                "5": function(5, "clone", false, 5),
                "6": function(6, "bits", false, 90),
                "7": function(7, "fmt", false, 7),
                "8": function(8, "next", false, 8),
                "10": implementation(2, json!(null), json!([3, 4, 6]), json!([])),
                "11": implementation(2, json!({"path": "Clone"}), json!([5]), json!(["automatically_derived"])),
                "12": implementation(2, json!({"path": "Flags"}), json!([]), json!([])),
                "13": implementation(2, json!({"path": "Iterator"}), json!([7, 8]), json!([])),
            },
        }));

        assert_eq!(found, functions(&["p::update", "p::frame::Parser::push", "p::frame::Parser::next"]));
    }
}
