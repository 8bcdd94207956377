//! What the other commands need on this machine: found out, installed where it may be, else named exactly.
//!
//! A machine that has everything is left alone: then set-up only asks the programs that are there.

mod apt;
mod component;
mod masters;
mod qemu;
mod rust_target;

use std::process::Command;

use anyhow::{Context, Result, bail};

pub(crate) use component::{CLIPPY, RUSTFMT};
pub(crate) use masters::{
    Masters, NODE_VARIABLE, PYTHON_VARIABLE, Program, lacking, provide as masters, tell_emulator,
};
pub(crate) use rust_target::{MINIMUM_RUST, TRIPLE, ThumbToolchain, has_target, rustup};

use crate::{board::MACHINE, process, workspace::Workspace};

/// What the thumb target's builds need.
pub(crate) fn thumb(workspace: &Workspace) -> Result<ThumbToolchain> {
    run(workspace, false)
}

/// What [`thumb`] gives, and the emulator.
pub(crate) fn thumb_and_qemu(workspace: &Workspace) -> Result<ThumbToolchain> {
    run(workspace, true)
}

fn run(workspace: &Workspace, with_qemu: bool) -> Result<ThumbToolchain> {
    let mut lacks = Vec::new();
    let mut wanted = Vec::new();
    let mut toolchain = rust_target::find(workspace);
    if toolchain.is_none() && rust_target::add_by_rustup(workspace) {
        toolchain = rust_target::find(workspace);
    }
    if toolchain.is_none() {
        lacks.push(format!("a Rust tool chain for {}", rust_target::TRIPLES.join(" and ")));
        wanted.push(rust_target::packages(workspace));
    }
    if with_qemu && !qemu::has_machine() {
        lacks.push(format!("QEMU with the machine {}", MACHINE));
        wanted.push(qemu::packages()?);
    }
    let lacks = lacks.join(" and ");
    if !wanted.is_empty() {
        if let Some(obstacle) = obstacle_to_installing() {
            bail!("missing: {lacks}; {obstacle}. {}", how_to_install(&wanted, toolchain.is_none()));
        }
        apt::install(&wanted).with_context(|| format!("cannot install {lacks}"))?;
    }
    if with_qemu && !qemu::has_machine() {
        bail!(
            "the qemu-system-arm that was installed lacks the machine {}; put one that has it (QEMU 10 does) on PATH",
            MACHINE
        );
    }
    match toolchain.or_else(|| rust_target::find(workspace)) {
        Some(toolchain) => Ok(toolchain),
        None => bail!(
            "the Rust packages that were installed cannot build for {}: Rust {} or newer is needed; where rustup reaches its server, type: {}",
            rust_target::TRIPLES.join(" and "),
            rust_target::MINIMUM_RUST,
            rust_target::RUSTUP_LINE
        ),
    }
}

fn how_to_install(wanted: &[apt::Packages], rustup_would_do: bool) -> String {
    let mut text = String::from("Type as root, then start again:");
    for line in apt::shell_lines(wanted) {
        text.push_str("\n  ");
        text.push_str(&line);
    }
    if rustup_would_do && rust_target::rustup_may_be_called() {
        text.push_str(&format!(
            "\nWhere rustup reaches its server this does instead of the Rust packages:\n  {}",
            rust_target::RUSTUP_LINE
        ));
    }
    text
}

/// Tells of a failure without which the rest goes on.
fn report(outcome: Result<()>) {
    if let Err(error) = outcome {
        eprintln!("{error:#}: going on without");
    }
}

/// Why packages may not be installed here; `None` where they may.
fn obstacle_to_installing() -> Option<&'static str> {
    if installing_is_forbidden() {
        Some("WSG_NO_INSTALL=1 forbids installing")
    } else if process::answer(Command::new("apt-get").arg("--version")).is_none() {
        Some("this system has no apt-get to install it with (the commands below are Debian's)")
    } else if process::answer(Command::new("id").arg("-u")).is_none_or(|id| id.trim() != "0") {
        Some("only root may install")
    } else {
        None
    }
}

/// Whether `WSG_NO_INSTALL` says so.
pub(crate) fn installing_is_forbidden() -> bool {
    is_set("WSG_NO_INSTALL")
}

/// `0` and the empty string count as not set, so that a switch can be turned off in one place.
fn is_set(switch: &str) -> bool {
    std::env::var(switch).is_ok_and(|value| !value.is_empty() && value != "0")
}
