//! Runs the `wsg` binary.
#![allow(dead_code, reason = "each test uses only a part")]

use std::io::Write;
use std::process::{Command, Output, Stdio};

/// Runs `wsg` with input on standard input and additional environment variables.
pub(crate) fn wsg_with(arguments: &[&str], input: &[u8], environment: &[(&str, &str)]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_wsg"))
        .args(arguments)
        .envs(environment.iter().copied())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // Ignored: the program may exit without reading its input.
    let _ = child.stdin.take().expect("standard input is piped").write_all(input);
    child.wait_with_output().expect("the program exits")
}

pub(crate) fn wsg(arguments: &[&str], input: &[u8]) -> Output {
    wsg_with(arguments, input, &[])
}

/// Returns standard output followed by standard error.
pub(crate) fn printed(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}
