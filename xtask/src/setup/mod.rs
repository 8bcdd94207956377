//! Prerequisites of the other commands: finds them, installs missing ones if permitted, or prints the commands to install them.
//!
//! If everything is present, set-up changes nothing and only queries the programs.

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

/// Provides a tool chain for the thumb targets.
pub(crate) fn thumb(workspace: &Workspace) -> Result<ThumbToolchain> {
    run(workspace, false)
}

/// Provides the tool chain like [`thumb`], and QEMU.
pub(crate) fn thumb_and_qemu(workspace: &Workspace) -> Result<ThumbToolchain> {
    run(workspace, true)
}

/// Provides all prerequisites of build, demo and test.
pub(crate) fn all(workspace: &Workspace) -> Result<()> {
    thumb_and_qemu(workspace)?;
    match &masters(workspace).missing[..] {
        [] => println!("setup: all prerequisites are present"),
        missing => println!("setup: test will skip checks that need {}", missing.join(", ")),
    }
    Ok(())
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
            "the installed qemu-system-arm lacks the machine {}; put a newer one, such as QEMU 10, on PATH",
            MACHINE
        );
    }
    match toolchain.or_else(|| rust_target::find(workspace)) {
        Some(toolchain) => Ok(toolchain),
        None => bail!(
            "the installed Rust packages cannot build for {}, which requires Rust {} or newer; if rustup can reach its server, run: {}",
            rust_target::TRIPLES.join(" and "),
            rust_target::MINIMUM_RUST,
            rust_target::RUSTUP_LINE
        ),
    }
}

fn how_to_install(wanted: &[apt::Packages], rustup_would_do: bool) -> String {
    let mut text = String::from("Run as root, then try again:");
    for line in apt::shell_lines(wanted) {
        text.push_str("\n  ");
        text.push_str(&line);
    }
    if rustup_would_do && rust_target::rustup_may_be_called() {
        text.push_str(&format!(
            "\nIf rustup can reach its server, run this instead of installing the Rust packages:\n  {}",
            rust_target::RUSTUP_LINE
        ));
    }
    text
}

/// Reports a failure that does not prevent the remaining steps.
fn report(outcome: Result<()>) {
    if let Err(error) = outcome {
        eprintln!("{error:#}; continuing without it");
    }
}

/// Returns why packages cannot be installed, or `None` if they can.
fn obstacle_to_installing() -> Option<&'static str> {
    if installing_is_forbidden() {
        Some("WSG_NO_INSTALL=1 forbids installation")
    } else if process::answer(Command::new("apt-get").arg("--version")).is_none() {
        Some("this system has no apt-get (the commands below are for Debian)")
    } else if process::answer(Command::new("id").arg("-u")).is_none_or(|id| id.trim() != "0") {
        Some("installation requires root")
    } else {
        None
    }
}

/// Returns whether `WSG_NO_INSTALL` forbids installation.
pub(crate) fn installing_is_forbidden() -> bool {
    is_set("WSG_NO_INSTALL")
}

/// Returns whether an environment switch is set. `0` and the empty string count as not set.
fn is_set(switch: &str) -> bool {
    std::env::var(switch).is_ok_and(|value| !value.is_empty() && value != "0")
}
