//! Each gate shown to fail when it should: one line is changed in a copy of the tree, the gate is run there, and must say what
//! is wrong. What was run stands in docs/figures.md.

use std::{
    fs,
    hash::{DefaultHasher, Hash, Hasher},
    path::{Path, PathBuf},
    process::Stdio,
};

use anyhow::{Context, Result, bail, ensure};

use crate::{figures, process, tool, workspace::Workspace};

/// A change of one line, and what a gate says of it.
struct Sabotage {
    gate: &'static str,
    /// What the change stands for.
    what: &'static str,
    file: &'static str,
    line: &'static str,
    instead: &'static str,
    /// Arguments to cargo.
    command: &'static [&'static str],
    /// What it must say, beside failing.
    says: &'static str,
}

const PARSER: &str = "protocol/src/frame/parser.rs";
const TRACK: &str = "protocol/src/session/track.rs";
const REPEAT: &str = "let repeat = is_repeatable && self.sent < attempts;";
const CONTROLLER: &str = "protocol/src/fieldbus/controller.rs";
const EDGES: &str = "image.flags.difference(previous.flags)";

const fn smoke(test: &'static str) -> [&'static str; 9] {
    ["test", "-q", "-p", "host-tests", "--test", "fuzz_smoke", test, "--", "--exact"]
}

const ALL: [Sabotage; 21] = [
    Sabotage {
        gate: "panics",
        what: "an `unwrap` in the parser",
        file: PARSER,
        line: "self.store.body.get(..size as usize)?",
        instead: "self.store.body.get(..size as usize).unwrap()",
        command: &["xtask", "panics"],
        says: "a panic can be reached: protocol, every public function",
    },
    Sabotage {
        gate: "panics",
        what: "a public function that no probe calls",
        file: PARSER,
        line: "    /// What has been refused so far.",
        instead: "    /// A new one.\n    pub fn brand_new(&self) {}\n\n    /// What has been refused so far.",
        command: &["xtask", "panics"],
        says: "FrameParser::brand_new",
    },
    Sabotage {
        gate: "size",
        what: "3 KiB of text in the parser",
        file: PARSER,
        line: "        let count = match found {",
        instead: "        core::hint::black_box(&[0x5A_u8; 3072]);\n        let count = match found {",
        command: &["xtask", "size"],
        says: "past the limit: parser and encoder, flash with table, parser and encoder, flash with `small-table`",
    },
    Sabotage {
        gate: "size",
        what: "16 KiB of text in the firmware",
        file: TRACK,
        line: REPEAT,
        instead: "core::hint::black_box(&[0x5A_u8; 16 * 1024]);\n        let repeat = is_repeatable && self.sent < attempts;",
        command: &["xtask", "size"],
        says: "past the limit: firmware image, flash",
    },
    Sabotage {
        gate: "size",
        what: "four bytes more in the parser",
        file: PARSER,
        line: "const TAIL_LEN: usize = 2;",
        instead: "const TAIL_LEN: usize = 6;",
        command: &["xtask", "size"],
        says: "the parser's memory is N + 16 bytes",
    },
    Sabotage {
        gate: "stack",
        what: "2000 bytes deeper",
        file: TRACK,
        line: REPEAT,
        instead: "core::hint::black_box([0_u8; 2000]);\n        let repeat = is_repeatable && self.sent < attempts;",
        command: &["xtask", "stack"],
        says: "past the limit: worst-case stack, walked, worst-case stack, painted in the emulator",
    },
    Sabotage {
        gate: "bench",
        what: "the bulk path goes byte by byte",
        file: PARSER,
        line: "                rest = self.take_run(rest);\n",
        instead: "",
        command: &["xtask", "bench"],
        says: "slower than host-tests/probes/baseline.txt by more than 2 %: O3/bulk-path/",
    },
    Sabotage {
        gate: "fuzz, frames",
        what: "a dropped check: any checksum is right",
        file: PARSER,
        line: "let accepted = received == self.checksum_or_next",
        instead: "let accepted = received != 0x1234",
        command: &smoke("frames_60_000_cases"),
        says: "frames_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, session",
        what: "a motion is sent again",
        file: TRACK,
        line: REPEAT,
        instead: "let repeat = self.sent < attempts;",
        command: &smoke("session_60_000_cases"),
        says: "session_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, controller",
        what: "levels for edges",
        file: CONTROLLER,
        line: EDGES,
        instead: "image.flags",
        command: &smoke("controller_60_000_cases"),
        says: "controller_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, bridge",
        what: "levels for edges",
        file: CONTROLLER,
        line: EDGES,
        instead: "image.flags",
        command: &smoke("bridge_60_000_cases"),
        says: "bridge_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, bridge",
        what: "wires and bus both command",
        file: "bridge-fw/src/arbiter.rs",
        line: "if wires.flags.intersects(MOTIONS) || stopped {",
        instead: "if stopped {",
        command: &smoke("bridge_60_000_cases"),
        says: "without an edge",
    },
    Sabotage {
        gate: "fuzz, bridge",
        what: "a dropped check: any checksum on the bus is right",
        file: "protocol/src/modbus/rtu/receiver.rs",
        line: "frame.len() > CRC_LEN && crc(frame) == 0",
        instead: "frame.len() > CRC_LEN && crc(frame) != 0x1234",
        command: &smoke("bridge_60_000_cases"),
        says: "an answer to no request for this unit",
    },
    Sabotage {
        gate: "fuzz, bridge on CAN",
        what: "what waits for the link is not overtaken by FAST STOP",
        file: "bridge-fw/src/bridge.rs",
        line: "        while link.write_ready().unwrap_or(false) {",
        instead: "        while self.sending.is_none() || link.write_ready().unwrap_or(false) {",
        command: &smoke("bridge_can_60_000_cases"),
        says: "FAST STOP does not leave",
    },
    Sabotage {
        gate: "fuzz, bridge on CAN",
        what: "the bus goes, and the controller keeps what it was given",
        file: "bridge-fw/src/can/bus.rs",
        line: "    fn forget(&mut self) {\n        self.controller.abort();",
        instead: "    fn forget(&mut self) {",
        command: &smoke("bridge_can_60_000_cases"),
        says: "bridge_can_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, typed",
        what: "a dropped check: a motion's width may be no number",
        file: "protocol/src/field.rs",
        line: "value.is_finite()",
        instead: "true",
        command: &smoke("typed_60_000_cases"),
        says: "typed_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, GCL",
        what: "the line after one that is too long is lost",
        file: "protocol/src/gcl/line.rs",
        line: "            if skipping {\n                self.reset();\n            }\n",
        instead: "",
        command: &smoke("gcl_60_000_cases"),
        says: "gcl_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, MODBUS",
        what: "an answer to a broadcast",
        file: "protocol/src/modbus/rtu/server.rs",
        line: "if broadcast || len == 0 {",
        instead: "if len == 0 {",
        command: &smoke("modbus_60_000_cases"),
        says: "modbus_60_000_cases",
    },
    Sabotage {
        gate: "fuzz, CAN",
        what: "a dropped check: any checksum is right",
        file: "protocol/src/can/reassembler.rs",
        line: "checksum::push_slice(checksum::START, covered).to_le_bytes() != *received",
        instead: "checksum::push_slice(checksum::START, covered).to_le_bytes() == [1, 2]",
        command: &smoke("can_60_000_cases"),
        says: "can_60_000_cases",
    },
    Sabotage {
        gate: "faults, driver",
        what: "a motion is sent again",
        file: TRACK,
        line: REPEAT,
        instead: "let repeat = self.sent < attempts;",
        command: &["test", "-q", "-p", "host-tests", "--test", "faults", "driver"],
        says: "left 2 times",
    },
    Sabotage {
        gate: "faults, scenarios",
        what: "a motion is sent again",
        file: TRACK,
        line: REPEAT,
        instead: "let repeat = self.sent < attempts;",
        command: &["test", "-q", "-p", "host-tests", "--test", "faults", "lost_byte_in_the_command"],
        says: "[GripPart, GripPart",
    },
];

/// Runs them all, those of this gate alone if one is named, and writes the table.
pub(crate) fn run(workspace: &Workspace, gate: Option<&str>) -> Result<()> {
    let tree = place_of_copy(workspace);
    let build = workspace.target_dir.join("sabotage");
    copy_of(workspace, &tree)?;
    let chosen: Vec<&Sabotage> = ALL.iter().filter(|it| gate.is_none_or(|gate| it.gate == gate)).collect();
    ensure!(!chosen.is_empty(), "no gate of this name; docs/figures.md lists them");
    for sabotage in &chosen {
        let file = tree.join(sabotage.file);
        let intact = read(&file)?;
        write(&file, &sabotage.change(&intact)?)?;
        let said = fails(workspace, &tree, &build, sabotage.command);
        write(&file, &intact)?;
        let said = said.with_context(|| format!("{}: {}", sabotage.gate, sabotage.what))?;
        if !said.contains(sabotage.says) {
            bail!(
                "{}: {}: it fails, but does not say `{}`: {said}",
                sabotage.gate,
                sabotage.what,
                sabotage.says
            );
        }
        println!("  {}: {}: fails and says so", sabotage.gate, sabotage.what);
    }
    println!("sabotage: {} changes, each noticed by its gate", chosen.len());
    if gate.is_none() {
        figures::write_part(workspace, "sabotage", &table())?;
    }
    Ok(())
}

impl Sabotage {
    /// The source with the change.
    fn change(&self, source: &str) -> Result<String> {
        let count = source.matches(self.line).count();
        ensure!(count == 1, "{}: `{}` is there {count} times, and must be once", self.file, self.line);
        Ok(source.replace(self.line, self.instead))
    }
}

fn table() -> String {
    let mut text = "| gate | the change | the command says |\n|---|---|---|\n".to_owned();
    for Sabotage { gate, what, file, command, says, .. } in &ALL {
        text += &format!("| {gate} | {what} (`{file}`) | `cargo {}`: `{says}` |\n", command.join(" "));
    }
    text
}

/// Runs cargo in the tree; what it said, if it failed.
fn fails(workspace: &Workspace, tree: &Path, target_dir: &Path, arguments: &[&str]) -> Result<String> {
    let mut cargo = workspace.cargo();
    cargo
        .args(arguments)
        .current_dir(tree)
        .env("CARGO_TARGET_DIR", target_dir)
        .env_remove("CARGO_MANIFEST_DIR");
    cargo.env("RUST_BACKTRACE", "0");
    eprintln!("+ {}", process::shell_line(&cargo));
    let output = cargo.stdin(Stdio::null()).output().context("cannot run cargo")?;
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said).into_owned();
    ensure!(!output.status.success(), "the gate does not notice it");
    Ok(said)
}

/// Outside the workspace, whose `.cargo` would add its linker flags to those of the copy; the same one in each run, so
/// that cargo need not build it anew.
fn place_of_copy(workspace: &Workspace) -> PathBuf {
    let mut hasher = DefaultHasher::new();
    workspace.root.hash(&mut hasher);
    std::env::temp_dir().join(format!("wsg-sabotage-{:016x}", hasher.finish()))
}

/// A copy of what git knows or would take up, so that no change ever touches the tree that people work in.
fn copy_of(workspace: &Workspace, tree: &Path) -> Result<()> {
    let mut git =
        tool::plain(workspace, &["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]);
    let files = process::output(&mut git)?;
    for name in files.split('\0').filter(|name| !name.is_empty()) {
        let from = workspace.root.join(name);
        // Removed, and not yet committed.
        if !from.is_file() {
            continue;
        }
        let bytes = fs::read(&from).with_context(|| format!("cannot read {name}"))?;
        let to: PathBuf = tree.join(name);
        // What has not changed keeps its time, so that cargo need not build it anew.
        if fs::read(&to).is_ok_and(|there| there == bytes) {
            continue;
        }
        let folder = to.parent().context("a file lies in a folder")?;
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        fs::write(&to, bytes).with_context(|| format!("cannot write {}", to.display()))?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gate that is never seen to fail may check nothing: the lines that are changed must stay those of the sources.
    #[test]
    fn every_line_that_is_changed_is_there_once() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        for sabotage in &ALL {
            let source = read(&root.join(sabotage.file)).unwrap();
            let changed = sabotage.change(&source).unwrap();
            assert_ne!(changed, source, "{}", sabotage.what);
        }
    }

    #[test]
    fn the_document_lists_every_change() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let document = read(&root.join("docs/figures.md")).unwrap();
        assert!(document.contains(&table()), "run `cargo xtask sabotage`");
    }
}
