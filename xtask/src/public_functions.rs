//! The public functions of a crate, by its sources: what a probe has to call so that every one of them is kept.

use std::{collections::BTreeSet, fs, path::Path};

use anyhow::{Context, Result};

/// A public function: the type it belongs to, if the sources say which, and its name.
pub(crate) type Function = (Option<String>, String);

/// All public functions in a folder of sources, tests left out.
pub(crate) fn of_folder(folder: &Path) -> Result<BTreeSet<Function>> {
    let mut functions = BTreeSet::new();
    let entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    for entry in entries {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && name != "tests" {
            functions.extend(of_folder(&path)?);
        } else if name.ends_with(".rs") && !name.ends_with("tests.rs") {
            let source =
                fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
            functions.extend(of_source(&source));
        }
    }
    Ok(functions)
}

/// Those that `program` does not call.
pub(crate) fn missing_in(functions: &BTreeSet<Function>, program: &str) -> Vec<String> {
    let program = &without_type_arguments(program);
    let calls = |(of, name): &Function| {
        let by_type = of.as_ref().is_some_and(|of| program.contains(&format!("{of}::{name}")));
        let by_any_type =
            of.is_none() && (program.contains(&format!("::{name}")) || is_called(name, program));
        by_type || by_any_type || program.contains(&format!(".{name}("))
    };
    let named =
        |(of, name): &Function| of.as_ref().map_or_else(|| name.clone(), |of| format!("{of}::{name}"));
    functions.iter().filter(|function| !calls(function)).map(named).collect()
}

/// Whether the program calls a function of this very name.
fn is_called(name: &str, program: &str) -> bool {
    program.match_indices(&format!("{name}(")).any(|(at, _)| {
        let before = program.get(..at).unwrap_or_default();
        !before.ends_with(|c: char| c.is_alphanumeric() || c == '_') && !before.ends_with("fn ")
    })
}

/// `A::<B>::c` becomes `A::c`.
fn without_type_arguments(program: &str) -> String {
    let mut text = String::new();
    let mut rest = program;
    while let Some((before, behind)) = rest.split_once("::<") {
        text.push_str(before);
        let mut depth = 1;
        let end = behind.find(|c| {
            depth += i32::from(c == '<') - i32::from(c == '>');
            depth == 0
        });
        rest = end.map_or("", |end| &behind[end + 1..]);
    }
    text + rest
}

fn of_source(source: &str) -> BTreeSet<Function> {
    let mut of = None;
    let mut functions = BTreeSet::new();
    for line in source.lines().take_while(|line| line.trim() != "#[cfg(test)]") {
        let text = line.trim_start();
        if text.starts_with("impl") && text.ends_with('{') {
            of = implemented_type(text);
        } else if line == "}" {
            of = None;
        }
        let signature = ["pub fn ", "pub const fn ", "pub async fn ", "pub $($async)? fn "]
            .iter()
            .find_map(|it| text.strip_prefix(it));
        let name: Option<String> =
            signature.map(|it| it.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect());
        functions.extend(name.map(|name| (of.clone(), name)));
    }
    functions
}

/// The type of `impl<'a> Type<'a> {`; none where a macro puts it in.
fn implemented_type(line: &str) -> Option<String> {
    let header = line.rsplit(" for ").next().unwrap_or(line).trim_start_matches("impl").trim_start();
    let header = if header.starts_with('<') {
        // Parameters may hold `>` only as part of bounds with parameters of their own: count them.
        let mut depth = 0_i32;
        let end = header.char_indices().find_map(|(at, c)| {
            depth += i32::from(c == '<') - i32::from(c == '>');
            (depth == 0).then_some(at + 1)
        });
        header.get(end?..)?.trim_start()
    } else {
        header
    };
    let name: String = header.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    (!name.is_empty()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: &str = "pub fn free() {}
impl<'a, W: Into<u8>> Parser<W> {
    pub const fn new() -> Self { Self }
    fn private(&self) {}
    pub(crate) fn inner(&self) {}
    pub fn push(&mut self, byte: u8) {}
}
macro_rules! codes { ($type:ident) => {
        impl $type {
            pub const fn code(self) -> u8 { 0 }
        }
} }
#[cfg(test)]
mod tests { pub fn helper() {} }
";

    #[test]
    fn public_functions_are_found_with_their_types() {
        let some = |of: &str, name: &str| (Some(of.to_owned()), name.to_owned());
        let none = |name: &str| (None, name.to_owned());

        let expected = [some("Parser", "new"), some("Parser", "push"), none("code"), none("free")];
        assert_eq!(of_source(SOURCE), BTreeSet::from(expected));
    }

    #[test]
    fn a_function_that_the_program_does_not_call_is_named() {
        let functions = of_source(SOURCE);

        assert_eq!(missing_in(&functions, "x::free(); Parser::new(); p.push(1); s.code()"), [""; 0]);
        assert_eq!(
            missing_in(&functions, "x::free(); Parser::<A<B>>::new(); p.push::<C>(1); s.code()"),
            [""; 0]
        );
        assert_eq!(
            missing_in(&functions, "x::free(); Other::new(); s.code()"),
            ["Parser::new", "Parser::push"]
        );
        assert_eq!(missing_in(&of_source("pub fn crc() {}"), "keep(&crc(1))"), [""; 0]);
        assert_eq!(missing_in(&of_source("pub fn crc() {}"), "fn crc() {} my_crc()"), ["crc"]);
    }
}
