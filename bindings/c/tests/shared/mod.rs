//! What the tests of the two headers share: generation, compilers, and the recorded ABI.
//!
//! The folder `abi` of a crate has two files for each version: the header without comments, and a record of its sizes, offsets, values
//! and functions in C. The record does not compile with a header that differs, unless `WSG_ABI_VERSION` differs, too.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A generated header.
pub(crate) struct Header {
    /// Its name without the extension.
    pub(crate) name: &'static str,
    /// The folder of its crate.
    pub(crate) folder: &'static str,
}

const LANGUAGES: [(&str, &str); 4] = [("c", "c89"), ("c", "c99"), ("c", "c11"), ("c++", "c++17")];

impl Header {
    fn path(&self) -> PathBuf {
        Path::new(self.folder).join("include").join(self.name).with_extension("h")
    }

    /// A file of the recorded ABI, with the extension `c` or `h`.
    fn record(&self, extension: &str) -> PathBuf {
        let version = env!("CARGO_PKG_VERSION").rsplit_once('.').unwrap().0;
        Path::new(self.folder).join(format!("abi/{}-{version}.{extension}", self.name))
    }

    /// Checks that the header is the output of cbindgen with this text after the first lines.
    pub(crate) fn is_generated(&self, preamble: String) {
        let mut config = cbindgen::Config::from_file(Path::new(self.folder).join("cbindgen.toml")).unwrap();
        config.after_includes = Some(preamble);
        let bindings =
            cbindgen::Builder::new().with_crate(self.folder).with_config(config).generate().unwrap();
        let mut text = Vec::new();
        bindings.write(&mut text);
        let text = in_c89(&with_short_comments(&String::from_utf8(text).unwrap()));
        if is_update() {
            fs::write(self.path(), &text).unwrap();
        }
        let committed = fs::read_to_string(self.path()).unwrap_or_default();
        assert!(committed == text, "{} is outdated; update it with WSG_UPDATE_DOCS=1", self.path().display());
    }

    /// Checks that the record contains the whole header. Adds new names on request. Never changes or removes a recorded name.
    pub(crate) fn is_recorded(&self) {
        let code = without_comments(&fs::read_to_string(self.path()).unwrap());
        let (path, checks) = (self.record("c"), self.checks(&code));
        if is_update() && !path.exists() {
            fs::write(self.record("h"), code).unwrap();
        }
        let recorded = fs::read_to_string(&path).unwrap_or_default();
        for line in recorded.lines() {
            assert!(
                checks.contains(line),
                "the ABI has changed: `{line}` of {} no longer holds; increase WSG_ABI_VERSION and the minor version",
                path.display()
            );
        }
        if is_update() {
            fs::write(&path, &checks).unwrap();
        }
        let committed = fs::read_to_string(&path).unwrap_or_default();
        assert!(committed == checks, "{} lacks new names; update it with WSG_UPDATE_DOCS=1", path.display());
    }

    /// Returns the record of a header without comments.
    fn checks(&self, code: &str) -> String {
        // Macro, expressions to evaluate, and the text before them.
        let mut lines: Vec<(String, Vec<String>)> = Vec::new();
        let mut functions = String::new();
        let mut members: Vec<&str> = Vec::new();
        for line in code.lines() {
            let words: Vec<&str> = line.split([' ', ';', ',', '[']).filter(|word| !word.is_empty()).collect();
            match words[..] {
                ["#define", name, _, ..] | [name, "=", _] if !name.starts_with("WSG_VERSION") => {
                    lines.push((format!("VALUE({name}"), vec![name.to_owned()]));
                }
                ["typedef", "struct" | "union", "{"] => members.clear(),
                ["}", name] if name.ends_with("_t") => {
                    lines.push((format!("SIZE({name}"), vec![format!("sizeof({name})")]));
                    for member in &members {
                        let size = format!("sizeof((({name} *)0)->{member})");
                        let values = vec![size, format!("offsetof({name}, {member})")];
                        lines.push((format!("FIELD({name}, {member}"), values));
                    }
                }
                _ if line.starts_with("    ") && line.ends_with(';') && !line.contains(')') => {
                    let declared = line.split(['[', ';']).next().unwrap();
                    members.push(declared.rsplit([' ', '*']).next().unwrap());
                }
                _ if !line.starts_with(['#', '}']) && !line.contains("typedef") && !line.contains('{') => {
                    functions += line.trim();
                    functions += if line.ends_with(';') { "\n" } else { " " };
                }
                _ => {}
            }
        }
        let expressions: Vec<&str> =
            lines.iter().flat_map(|(_, values)| values).map(String::as_str).collect();
        let [on_32, on_64] = ["-m32", "-m64"].map(|option| self.values(option, &expressions));
        let mut values = on_32.into_iter().zip(on_64);
        let mut text = format!(
            "/* The recorded ABI: sizes, offsets and values on 32 and on 64 bits, and functions. Generated: do not edit. */\n\
             #include \"{}.h\"\n#include \"abi.h\"\n#if WSG_ABI_VERSION == {}\n",
            self.name,
            self.values("-m64", &["WSG_ABI_VERSION"])[0]
        );
        for (call, expressions) in &lines {
            text += call;
            for (on_32, on_64) in values.by_ref().take(expressions.len()) {
                write!(text, ", {on_32}, {on_64}").unwrap();
            }
            text += ");\n";
        }
        for function in functions.lines() {
            let (head, parameters) = function.trim_end_matches(';').split_at(function.find('(').unwrap());
            let (result, name) = head.split_at(head.rfind([' ', '*']).unwrap() + 1);
            writeln!(text, "FUNCTION({}, {name}, {parameters})", result.trim_end()).unwrap();
        }
        text + "#endif\n"
    }

    /// Evaluates constant expressions with the header, for a word size.
    fn values(&self, option: &str, expressions: &[&str]) -> Vec<String> {
        let mut source = format!("#include \"{}.h\"\nvoid values(void) {{\n", self.name);
        for expression in expressions {
            writeln!(source, "__asm__ volatile(\"VALUE %c0\" : : \"i\"((int)({expression})));").unwrap();
        }
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-values{option}.c", self.name));
        fs::write(&file, source + "}\n").unwrap();
        let mut gcc = Command::new("gcc");
        gcc.args(["-S", "-ffreestanding", option, "-o", "-"]).args(self.include_options()).arg(file);
        let output = gcc.output().unwrap();
        assert!(output.status.success(), "{}", printed(&output));
        let text = printed(&output);
        text.lines().filter_map(|line| line.trim().strip_prefix("VALUE ")).map(str::to_owned).collect()
    }

    fn include_options(&self) -> [String; 4] {
        // `wsg_host.h` includes `wsg.h`; `abi.h` is here.
        ["include", "../c/include", "../c/tests/shared", "tests"]
            .map(|folder| format!("-I{}/{folder}", self.folder))
    }

    /// Compiles the header and its record in each language with all warnings as errors.
    pub(crate) fn compiles(&self, compiler: &str, arguments: &[&str]) {
        for (language, standard) in LANGUAGES {
            let mut command = Command::new(compiler);
            command.args(["-x", language, &format!("-std={standard}"), "-fsyntax-only"]).args(arguments);
            command.args(["-Wall", "-Wextra", "-Wpedantic", "-Werror"]).args(self.include_options());
            let hpp = self.path().with_extension("hpp");
            if language == "c++" && hpp.exists() && !arguments.contains(&"-ffreestanding") {
                command.arg("-include").arg(hpp);
            }
            for record in fs::read_dir(Path::new(self.folder).join("abi")).unwrap() {
                let path = record.unwrap().path();
                if path.extension().is_some_and(|extension| extension == "c") {
                    command.arg(path);
                }
            }
            let output = command.output().unwrap_or_else(|error| panic!("{compiler}: {error}"));
            assert!(output.status.success(), "{compiler} as {standard}:\n{}", printed(&output));
        }
    }
}

fn is_update() -> bool {
    std::env::var_os("WSG_UPDATE_DOCS").is_some()
}

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned()
}

/// Puts each comment of one line on a line with its delimiters.
fn with_short_comments(text: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    for line in text.lines() {
        if line.trim() == "*/"
            && let [.., begin, only] = &mut lines[..]
            && begin.trim() == "/*"
        {
            *begin = format!("{begin} {} */", only.trim());
            lines.pop();
        } else {
            lines.push(line.to_owned());
        }
    }
    lines.join("\n") + "\n"
}

/// Removes what C89 does not have: a comma after the last enumerator, and comments of C++.
fn in_c89(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let convert = |(at, line): (usize, &&str)| {
        let is_last = lines.get(at + 1).is_some_and(|next| next.starts_with('}'));
        let line = line.strip_suffix(',').filter(|_| is_last).unwrap_or(line);
        match line.split_once("//") {
            Some((code, comment)) => format!("{code}/* {} */\n", comment.trim()),
            None => format!("{line}\n"),
        }
    };
    lines.iter().enumerate().map(convert).collect()
}

/// Removes comments and empty lines.
fn without_comments(header: &str) -> String {
    let mut code = String::new();
    for part in header.split("/*") {
        code += part.split_once("*/").map_or(part, |(_, code)| code);
    }
    let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default().trim_end());
    lines.filter(|line| !line.is_empty()).map(|line| line.to_owned() + "\n").collect()
}
