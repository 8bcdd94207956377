//! Third-party Modbus masters, for tests: `mbpoll` (Debian), `pymodbus`, `minimalmodbus`, `modbus-tk` (PyPI, versions in
//! `requirements.txt`), `jsmodbus` (npm, `package-lock.json`); and from PyPI `canopen`, a master of CANopen, `pyprofibus`, one of
//! PROFIBUS, and `dcf-tools`, which reads EDS files.
//!
//! `cargo xtask test` installs them, and leaves out the tests of those that it cannot have, by the name: a test that
//! needs one has `mbpoll`, `pymodbus`, `minimalmodbus`, `modbus_tk`, `jsmodbus`, `canopen` or `pyprofibus` in its own. Run without it, such a test fails.

use std::path::PathBuf;
use std::process::{Command, Output};

/// The environment variable that says where the Python is that has them.
pub const PYTHON_VARIABLE: &str = "WSG_MODBUS_PYTHON";

/// The environment variable that says in which folder Node.js finds them, and the emulator of the Pico.
pub const NODE_VARIABLE: &str = "WSG_MODBUS_NODE";

/// Runs a Python script with the masters' Python.
///
/// # Panics
/// Without the environment variable, or when that Python cannot be started.
#[must_use]
pub fn python(script: &str, arguments: &[&str]) -> Output {
    let Some(python) = std::env::var_os(PYTHON_VARIABLE).map(PathBuf::from) else {
        panic!("{PYTHON_VARIABLE} names no Python that has the masters: run `cargo xtask test`");
    };
    let run = Command::new(&python).args(["-c", script]).args(arguments).output();
    run.unwrap_or_else(|error| panic!("{} does not start: {error}", python.display()))
}

/// Runs a script of Node.js with the masters' packages.
///
/// # Panics
/// Without the environment variable, or when there is no Node.js.
#[must_use]
pub fn node(script: &str, arguments: &[&str]) -> Output {
    let Some(packages) = std::env::var_os(NODE_VARIABLE) else {
        panic!("{NODE_VARIABLE} names no folder that has the masters: run `cargo xtask test`");
    };
    let run = Command::new("node").args(["-e", script]).args(arguments).env("NODE_PATH", packages).output();
    run.unwrap_or_else(|error| panic!("node does not start: {error}"))
}

/// Runs `mbpoll`.
///
/// # Panics
/// When it is not installed.
#[must_use]
pub fn mbpoll(arguments: &[&str]) -> Output {
    let run = Command::new("mbpoll").args(arguments).output();
    run.unwrap_or_else(|error| panic!("mbpoll does not start ({error}): run `cargo xtask test`"))
}

/// `mbpoll` asks again where this machine was too busy; `sleep` waits for the end of a motion instead, as long as that takes.
const PASTED_BEFORE: &str = r#"
mbpoll() {
  for again in 1 2 3 4 5; do
    said=$(command mbpoll -o 5 "$@" 2>&1)
    case $said in
    *"timed out"* | *"Invalid CRC"*) ;;
    *) printf '%s\n' "$said"; return ;;
    esac
  done
  printf '%s\n' "$said"
}
sleep() {
  while status=$(WAIT) && case $status in *26*) ;; *) false ;; esac; do :; done
}
"#;

/// Pastes the commands of a text with Markdown into a shell: those blocks that have `word` in them, as they are, but for `changes`.
/// `status` reads the status code. Returns what was said.
///
/// # Panics
/// When the text has no such block, a change finds nothing, or there is no shell.
#[must_use]
pub fn paste(text: &str, word: &str, changes: &[(&str, &str)], status: &str) -> String {
    let blocks = text.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
    let mut pasted: String = blocks.filter(|block| block.contains(word)).collect();
    assert!(!pasted.is_empty(), "no block has {word}");
    for (from, to) in changes {
        assert!(pasted.contains(from), "no block has {from}");
        pasted = pasted.replace(from, to);
    }
    let script = format!("{}{pasted}", PASTED_BEFORE.replace("WAIT", status));
    said(&Command::new("sh").args(["-c", &script]).output().expect("there is a shell"))
}

/// What a program said, on either output.
#[must_use]
pub fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}
