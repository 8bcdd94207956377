//! Third-party Modbus masters, for tests: `mbpoll` (Debian), `pymodbus`, `minimalmodbus`, `modbus-tk` (PyPI, versions in
//! `requirements.txt`), `jsmodbus` (npm, `package-lock.json`); and from PyPI `canopen`, a master of CANopen, and `dcf-tools`, which
//! reads EDS files.
//!
//! `cargo xtask test` installs them, and leaves out the tests of those that it cannot have, by the name: a test that
//! needs one has `mbpoll`, `pymodbus`, `minimalmodbus`, `modbus_tk`, `jsmodbus` or `canopen` in its own. Run without it, such a test fails.

use std::path::PathBuf;
use std::process::{Command, Output};

/// The environment variable that says where the Python is that has them.
pub const PYTHON_VARIABLE: &str = "WSG_MODBUS_PYTHON";

/// The environment variable that says in which folder Node.js finds them.
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

/// What a program said, on either output.
#[must_use]
pub fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}
