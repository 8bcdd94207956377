//! Runs other programs and checks their output.

use std::{borrow::BorrowMut, process::Command};

use anyhow::{Context, Result, ensure};

/// Runs a program and returns its output, which must contain `expected`.
pub(crate) fn run_program(mut command: impl BorrowMut<Command>, expected: &str) -> Result<String> {
    let command = command.borrow_mut();
    let line = format!("{command:?}");
    let line = line.rsplit('\u{1f}').next().unwrap_or_default();
    println!("+ {line}");
    let output = command.output().with_context(|| format!("cannot run {line}"))?;
    let printed = String::from_utf8_lossy(&[&output.stdout[..], &output.stderr].concat()).into_owned();
    ensure!(output.status.success(), "{line} failed ({}): {}", output.status, printed.trim());
    ensure!(printed.contains(expected), "{line} printed no {expected:?}: {}", printed.trim());
    Ok(printed)
}
