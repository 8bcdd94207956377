//! Third-party masters for tests, installed by `cargo xtask test`. `mbpoll` comes from Debian, `jsmodbus` and `modbus-serial`
//! from npm (`package-lock.json`). `pymodbus`, `minimalmodbus`, `modbus-tk`, `canopen`, `pyprofibus` and the EDS reader
//! `dcf-tools` come from PyPI (`requirements.txt`), as do `xmlschema`, which validates PLCopen XML, and `blark`, which parses
//! Structured Text, `eds-pie`, which reads EDS files of EtherNet/IP, and its scanners and clients `ethernetip`, `pycomm3` and `cpppo`;
//! `cryptography` checks signatures.
//! Its scanner `cm-ethernetip` has an environment of its own; `st-ethernet-ip` comes from npm.
//!
//! A test that requires one has `mbpoll`, `pymodbus`, `minimalmodbus`, `modbus_tk`, `jsmodbus`, `modbus_serial`, `canopen`,
//! `pyprofibus`, `xmlschema`, `blark`, `eds_pie`, `pypi_ethernetip`, `cm_ethernetip`, `st_ethernet_ip`, `pycomm3`, `cpppo` or `cryptography` in its
//! name. It fails without it; `cargo xtask test` skips it.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Environment variable with the path of the Python that has the masters.
pub const PYTHON_VARIABLE: &str = "WSG_MODBUS_PYTHON";

/// Environment variable with the folder of the Node.js packages, including the Pico's emulator.
pub const NODE_VARIABLE: &str = "WSG_MODBUS_NODE";

/// Runs a Python script with the Python that has the masters.
///
/// # Panics
/// Panics without the environment variable, or when Python cannot be started.
#[must_use]
pub fn python(script: &str, arguments: &[&str]) -> Output {
    run_python(&python_path(), script, arguments)
}

/// Runs a Python script with the Python of another virtual environment next to that of the masters.
///
/// # Panics
/// Panics without the environment variable, or when Python cannot be started.
#[must_use]
pub fn python_of(environment: &str, script: &str, arguments: &[&str]) -> Output {
    let masters = python_path();
    let [program, folder, own] =
        [0, 1, 2].map(|level| masters.ancestors().nth(level).expect("a virtual environment"));
    let [program, folder] = [program, folder].map(|path| path.file_name().expect("a name"));
    run_python(&own.with_file_name(environment).join(folder).join(program), script, arguments)
}

fn python_path() -> PathBuf {
    std::env::var_os(PYTHON_VARIABLE).map(PathBuf::from).unwrap_or_else(|| {
        panic!("{PYTHON_VARIABLE} does not name a Python with the masters: run `cargo xtask test`")
    })
}

fn run_python(python: &Path, script: &str, arguments: &[&str]) -> Output {
    let run = Command::new(python).args(["-c", script]).args(arguments).output();
    run.unwrap_or_else(|error| panic!("{} does not start: {error}", python.display()))
}

/// Runs a Node.js script with the masters' packages.
///
/// # Panics
/// Panics without the environment variable or Node.js.
#[must_use]
pub fn node(script: &str, arguments: &[&str]) -> Output {
    let Some(packages) = std::env::var_os(NODE_VARIABLE) else {
        panic!("{NODE_VARIABLE} does not name a folder with the masters: run `cargo xtask test`");
    };
    let run = Command::new("node").args(["-e", script]).args(arguments).env("NODE_PATH", packages).output();
    run.unwrap_or_else(|error| panic!("node does not start: {error}"))
}

/// Polls unit 1 once with `mbpoll` and zero-based references. Returns the output.
///
/// # Panics
/// Panics when it is not installed, or receives no intact answer.
#[must_use]
pub fn mbpoll(arguments: &[&str]) -> String {
    // `-o`: the longest time-out in seconds. A busy host may run neither server nor master for seconds.
    let always = ["-a", "1", "-0", "-1", "-q", "-o", "10"];
    let run = Command::new("mbpoll").args(always).args(arguments).output();
    let printed = printed(
        &run.unwrap_or_else(|error| panic!("mbpoll does not start ({error}): run `cargo xtask test`")),
    );
    assert!(!printed.contains("timed out") && !printed.contains("Invalid CRC"), "{arguments:?}: {printed}");
    printed
}

/// Polls unit 1 at this terminal once with [`mbpoll`]: 8N1 at this rate in bit/s. Writes `values`, or reads without them.
#[must_use]
pub fn poll(terminal: &str, baud: u32, arguments: &[&str], values: &[&str]) -> String {
    let line = ["-m", "rtu", "-b", &baud.to_string(), "-P", "none"];
    mbpoll(&[&line, arguments, &[terminal], values].concat())
}

/// Gives `mbpoll` its longest time-out, and makes `sleep` wait until the motion has completed.
const PASTED_BEFORE: &str = r#"
mbpoll() {
  command mbpoll -o 10 "$@" 2>&1
}
sleep() {
  while status=$(WAIT) && case $status in *26*) ;; *) false ;; esac; do :; done
}
"#;

/// Runs the shell blocks of a Markdown text that contain `word`, with `changes` applied. `status` reads the status
/// code. Returns the output.
///
/// # Panics
/// Panics when no block contains `word`, a change does not apply, or no shell is installed.
#[must_use]
pub fn paste(text: &str, word: &str, changes: &[(&str, &str)], status: &str) -> String {
    let blocks = text.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
    let mut pasted: String = blocks.filter(|block| block.contains(word)).collect();
    assert!(!pasted.is_empty(), "no block contains {word}");
    for (from, to) in changes {
        assert!(pasted.contains(from), "no block contains {from}");
        pasted = pasted.replace(from, to);
    }
    let script = format!("{}{pasted}", PASTED_BEFORE.replace("WAIT", status));
    printed(&Command::new("sh").args(["-c", &script]).output().expect("sh can be started"))
}

/// Returns a program's standard output and standard error.
#[must_use]
pub fn printed(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}
