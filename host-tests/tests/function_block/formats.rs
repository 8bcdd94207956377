//! Generates the files that PLC programming systems import, from docs/*.st: PLCopen XML (TC6 version 2.01) and Siemens SCL.
//! Both are parsed again and compared with their sources.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use document::{hold_file, read};
use host_tests::masters;
use roxmltree::{Document, Node};

use super::structured_text::Unit;

/// The sources. A block follows the blocks that it calls.
pub(crate) const SOURCES: [&str; 3] =
    ["docs/FB_WSG_GRIP.st", "docs/PRG_WSG_MODBUS.st", "docs/PRG_WSG_DEMO.st"];
const XML: &str = "docs/wsg-blocks.xml";
pub(crate) const SCL: &str = "docs/wsg-blocks.scl";

/// Sections of variables, and their elements in PLCopen XML.
const SECTIONS: [(&str, &str); 3] =
    [("VAR_INPUT", "inputVars"), ("VAR_OUTPUT", "outputVars"), ("VAR", "localVars")];
/// Block kinds, and their names in PLCopen XML.
const KINDS: [(&str, &str); 2] = [("FUNCTION_BLOCK", "functionBlock"), ("PROGRAM", "program")];
const ELEMENTARY: [&str; 7] = ["BOOL", "BYTE", "WORD", "DWORD", "INT", "UINT", "TIME"];
/// Functions whose parameters have names in SCL.
const SHIFTS: [&str; 3] = ["SHL", "SHR", "ROL"];

/// A line of a declaration, such as `Speed : UINT := 5000;   (* 1/100 mm/s *)`.
pub(crate) struct Declaration<'a> {
    pub(crate) name: &'a str,
    pub(crate) kind: &'a str,
    pub(crate) initial: Option<&'a str>,
    pub(crate) comment: Option<&'a str>,
}

impl<'a> Declaration<'a> {
    /// Parses a line. Returns `None` for a line without a declaration.
    pub(crate) fn of(line: &'a str) -> Option<Self> {
        let (declared, rest) = line.split_once(';')?;
        let (name, kind) = declared.split_once(" : ")?;
        let (kind, initial) =
            kind.split_once(" := ").map_or((kind, None), |(kind, value)| (kind, Some(value)));
        Some(Self { name: name.trim(), kind, initial, comment: comment(rest) })
    }
}

/// Returns the text of a comment.
fn comment(text: &str) -> Option<&str> {
    Some(text.trim().strip_prefix("(*")?.strip_suffix("*)")?.trim())
}

/// A source, divided into its parts.
pub(crate) struct Source<'a> {
    pub(crate) comment: &'a str,
    kind: &'a str,
    pub(crate) name: &'a str,
    /// Lines of each section of variables.
    pub(crate) sections: Vec<(&'a str, Vec<&'a str>)>,
    pub(crate) body: &'a str,
}

impl<'a> Source<'a> {
    pub(crate) fn of(text: &'a str) -> Self {
        let (head, rest) = text.split_once("*)\n").expect("the end of a comment");
        let (first, rest) = rest.split_once('\n').expect("a block");
        let (kind, name) = first.split_once(' ').expect("kind and name");
        let (declared, body) = rest.rsplit_once("END_VAR\n\n").expect("variables, a blank line, a body");
        let body = body.strip_suffix(&format!("END_{kind}\n")).expect("the end of the block");
        let mut sections: Vec<(&str, Vec<&str>)> = Vec::new();
        for line in declared.lines().filter(|line| *line != "END_VAR") {
            if SECTIONS.iter().any(|(word, _)| *word == line) {
                sections.push((line, Vec::new()));
            } else {
                sections.last_mut().expect("a section").1.push(line);
            }
        }
        let comment = head.strip_prefix("(*").expect("a comment first").trim();
        Self { comment, kind, name, sections, body }
    }

    fn declarations(&self) -> impl Iterator<Item = Declaration<'a>> {
        self.sections.iter().flat_map(|(_, lines)| lines).filter_map(|line| Declaration::of(line))
    }

    fn xml(&self) -> String {
        let kind = KINDS.iter().find(|(word, _)| *word == self.kind).expect("a kind").1;
        let mut xml = format!("      <pou name=\"{}\" pouType=\"{kind}\">\n        <interface>\n", self.name);
        for (word, lines) in &self.sections {
            let section = SECTIONS.iter().find(|(other, _)| other == word).expect("a section").1;
            writeln!(xml, "          <{section}>").unwrap();
            for variable in lines.iter().filter_map(|line| Declaration::of(line)) {
                let Declaration { name, kind, initial, comment } = variable;
                let kind = match ELEMENTARY.contains(&kind) {
                    true => format!("<{kind}/>"),
                    false => format!("<derived name=\"{kind}\"/>"),
                };
                writeln!(xml, "            <variable name=\"{name}\">\n              <type>{kind}</type>")
                    .unwrap();
                if let Some(value) = initial {
                    writeln!(
                        xml,
                        "              <initialValue><simpleValue value=\"{value}\"/></initialValue>"
                    )
                    .unwrap();
                }
                if let Some(comment) = comment {
                    writeln!(xml, "              <documentation>{}</documentation>", xhtml(comment)).unwrap();
                }
                xml.push_str("            </variable>\n");
            }
            writeln!(xml, "          </{section}>").unwrap();
        }
        let (body, comment) = (xhtml(self.body), xhtml(self.comment));
        write!(
            xml,
            "        </interface>\n        <body>\n          <ST>{body}</ST>\n        </body>\n        \
             <documentation>{comment}</documentation>\n      </pou>\n"
        )
        .unwrap();
        xml
    }

    fn scl(&self, blocks: &BTreeSet<&str>) -> String {
        let mut scl = format!(
            "(* {} *)\nFUNCTION_BLOCK \"{}\"\n{{ S7_Optimized_Access := 'TRUE' }}\nVERSION : 0.1\n",
            self.comment, self.name
        );
        for (word, lines) in &self.sections {
            writeln!(scl, "{word}").unwrap();
            for line in lines {
                let line = match Declaration::of(line) {
                    Some(Declaration { kind: "TON", .. }) => line.replace(
                        " : TON;",
                        " {InstructionName := 'TON_TIME'; LibVersion := '1.0'} : TON_TIME;",
                    ),
                    Some(Declaration { kind, .. }) if blocks.contains(kind) => {
                        line.replace(&format!(" : {kind};"), &format!(" : \"{kind}\";"))
                    }
                    _ => (*line).to_owned(),
                };
                writeln!(scl, "{line}").unwrap();
            }
            scl.push_str("END_VAR\n");
        }
        let names: BTreeSet<_> = self.declarations().map(|variable| variable.name).collect();
        write!(scl, "\nBEGIN\n{}END_FUNCTION_BLOCK\n", scl_body(self.body, &names)).unwrap();
        scl
    }
}

/// Returns an element with this text. Lines of a body keep their indentation.
fn xhtml(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    format!("<xhtml xmlns=\"http://www.w3.org/1999/xhtml\">{text}</xhtml>")
}

/// Returns statements in SCL: `#` before each variable of the block, and the names of the shift functions' parameters.
fn scl_body(body: &str, variables: &BTreeSet<&str>) -> String {
    let mut scl = String::new();
    // For each open parenthesis, whether it belongs to a shift function.
    let mut open: Vec<bool> = Vec::new();
    let mut rest = body;
    let mut word = "";
    while let Some(first) = rest.chars().next() {
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '#';
        let len = if rest.starts_with("(*") {
            rest.find("*)").expect("the end of a comment") + 2
        } else if is_word(first) {
            rest.find(|c| !is_word(c)).unwrap_or(rest.len())
        } else {
            first.len_utf8()
        };
        let (part, after) = rest.split_at(len);
        let is_parameter = !open.is_empty() && after.starts_with(" :=");
        match part {
            "(" => {
                open.push(SHIFTS.contains(&word));
                scl.push_str(if SHIFTS.contains(&word) { "(IN := " } else { "(" });
            }
            ")" => {
                open.pop();
                scl.push(')');
            }
            "," if open.last() == Some(&true) => scl.push_str(", N :="),
            _ => {
                if variables.contains(part) && !is_parameter && !scl.ends_with('.') {
                    scl.push('#');
                }
                scl.push_str(part);
            }
        }
        word = if is_word(first) { part } else { "" };
        rest = after;
    }
    scl
}

fn texts() -> [String; 3] {
    SOURCES.map(read)
}

fn xml() -> String {
    let texts = texts();
    let version = env!("CARGO_PKG_VERSION");
    let pous: String = texts.iter().map(|text| Source::of(text).xml()).collect();
    let coordinates: String = ["fbd", "ld", "sfc"]
        .map(|language| format!("      <{language}><scaling x=\"1\" y=\"1\"/></{language}>\n"))
        .concat();
    format!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\">\n  \
         <fileHeader companyName=\"\" productName=\"wsg-bridge\" productVersion=\"{version}\" \
         creationDateTime=\"2026-11-25T00:00:00\"/>\n  <contentHeader name=\"wsg-blocks\">\n    \
         <coordinateInfo>\n{coordinates}    </coordinateInfo>\n  </contentHeader>\n  <types>\n    <dataTypes/>\n    \
         <pous>\n{pous}    </pous>\n  </types>\n  <instances>\n    <configurations/>\n  </instances>\n</project>\n"
    )
}

fn scl() -> String {
    let texts = texts();
    let sources: Vec<_> = texts.iter().map(|text| Source::of(text)).collect();
    let blocks = sources.iter().map(|source| source.name).collect();
    let parts: Vec<_> = sources.iter().map(|source| source.scl(&blocks)).collect();
    parts.join("\n")
}

/// Returns the units of the sources.
fn units() -> Vec<Unit> {
    texts().iter().map(|text| Unit::parse(text)).collect()
}

#[test]
fn scl_source_has_the_variables_and_statements_of_the_blocks() {
    hold_file(SCL, &scl());
    assert_eq!(Unit::parse_scl(&read(SCL)), units());
}

#[test]
fn plcopen_xml_has_the_variables_and_statements_of_the_blocks() {
    hold_file(XML, &xml());
    let text = read(XML);
    let document = Document::parse(&text).expect("well-formed");
    let pous = document.descendants().filter(|node| node.tag_name().name() == "pou");
    assert_eq!(pous.map(unit_of).collect::<Vec<_>>(), units());
}

/// Rebuilds the structured text of a POU, and parses it.
fn unit_of(pou: Node<'_, '_>) -> Unit {
    let child = |node: Node<'_, '_>, name: &str| -> String {
        let mut found = node.descendants().filter(|node| node.tag_name().name() == name);
        found
            .next()
            .expect("the element")
            .descendants()
            .filter_map(|node| node.text())
            .next()
            .unwrap()
            .to_owned()
    };
    let kind = KINDS.iter().find(|(_, name)| pou.attribute("pouType") == Some(name)).unwrap().0;
    let mut text = format!("{kind} {}\n", pou.attribute("name").unwrap());
    for section in pou.descendants() {
        let Some((word, _)) = SECTIONS.iter().find(|(_, name)| section.tag_name().name() == *name) else {
            continue;
        };
        writeln!(text, "{word}").unwrap();
        for variable in section.children().filter(Node::is_element) {
            let of = |name: &str| variable.descendants().find(|node| node.tag_name().name() == name);
            let kind = of("type").and_then(|node| node.first_element_child()).unwrap();
            let kind = kind.attribute("name").unwrap_or(kind.tag_name().name());
            write!(text, "{} : {kind}", variable.attribute("name").unwrap()).unwrap();
            if let Some(value) = of("simpleValue") {
                write!(text, " := {}", value.attribute("value").unwrap()).unwrap();
            }
            text.push_str(";\n");
        }
        text.push_str("END_VAR\n");
    }
    write!(text, "{}END_{kind}", child(pou, "ST")).unwrap();
    Unit::parse(&text)
}

/// Validates a document with PLCopen's schema, which the package `plcrex` contains. Prints the first error.
const VALIDATE: &str = r#"
import importlib.metadata, sys, xmlschema
files = importlib.metadata.files("plcrex")
schema = xmlschema.XMLSchema([str(file.locate()) for file in files if file.name == "tc6_xml_v201.xsd"][0])
error = next(schema.iter_errors(sys.argv[1]), None)
print("valid" if error is None else f"{error.path}: {error.reason}")
"#;

#[test]
#[ignore = "needs xmlschema: run `cargo xtask test`"]
fn xmlschema_finds_plcopen_xml_valid() {
    let root = document::root();
    let verdict = |text: &str| {
        let file = std::env::temp_dir().join(format!("wsg-blocks-{}.xml", std::process::id()));
        std::fs::write(&file, text).unwrap();
        let output = masters::python(VALIDATE, &[file.to_str().unwrap()]);
        std::fs::remove_file(&file).unwrap();
        masters::printed(&output)
    };
    let text = std::fs::read_to_string(root.join(XML)).unwrap();
    assert_eq!(verdict(&text), "valid\n");
    // The schema applies: it finds a type that does not exist, and a missing attribute.
    for (from, to) in [("<BOOL/>", "<BOOLEAN/>"), (" productName=\"wsg-bridge\"", "")] {
        let verdict = verdict(&text.replacen(from, to, 1));
        assert_ne!(verdict, "valid\n", "{from}");
        assert!(!verdict.contains("Traceback"), "{verdict}");
    }
}

/// Parses Structured Text with `blark`, whose grammar is that of TwinCAT 3. Prints its first error. `blark` reads project files with
/// `lxml`, whose machine code depends on the version of Python. A mock stands for it, because the text needs none of it.
pub(crate) const PARSE: &str = r#"
import sys, unittest.mock
sys.modules["lxml"] = sys.modules["lxml.etree"] = unittest.mock.MagicMock()
from blark.parse import parse_source_code
error = parse_source_code(sys.argv[1]).exception
print(str(error).splitlines()[0] if error else "valid")
"#;

#[test]
#[ignore = "needs blark: run `cargo xtask test`"]
fn blark_parses_structured_text() {
    let verdict = |text: &str| masters::printed(&masters::python(PARSE, &[text]));
    for source in SOURCES {
        let text = read(source);
        assert_eq!(verdict(&text), "valid\n", "{source}");
        // It finds an unfinished section, and the assignment of another language.
        for (from, to) in [("END_VAR", ""), (" := ", " = ")] {
            let verdict = verdict(&text.replacen(from, to, 1));
            assert!(verdict.starts_with("No terminal matches"), "{source}, {from}: {verdict}");
        }
    }
    // The requests of TwinCAT to a gateway.
    let page = read("docs/gateway.md");
    let (_, requests) = page.split_once("```iecst\n").expect("a block");
    let (requests, _) = requests.split_once("```").expect("its end");
    assert_eq!(verdict(&format!("PROGRAM P\n{requests}END_PROGRAM\n")), "valid\n");
}
