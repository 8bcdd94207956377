//! `wsg` as a program.
#![allow(dead_code, reason = "every test uses a part of it")]

use std::io::Write;
use std::process::{Command, Output, Stdio};

/// Runs it with this on its standard input.
pub(crate) fn wsg_with(arguments: &[&str], input: &[u8], environment: &[(&str, &str)]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_wsg"))
        .args(arguments)
        .envs(environment.iter().copied())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    // It may end without reading.
    let _ = child.stdin.take().expect("it is piped").write_all(input);
    child.wait_with_output().expect("it ends")
}

pub(crate) fn wsg(arguments: &[&str], input: &[u8]) -> Output {
    wsg_with(arguments, input, &[])
}

/// What it said, on either output.
pub(crate) fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}
