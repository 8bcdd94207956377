//! Prerequisites of the other commands: finds them, installs missing ones if permitted, or prints the commands to install them.
//!
//! If everything is present, set-up changes nothing and only queries the programs.

mod apt;
mod component;
mod masters;
mod rust_target;

use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use boards::MACHINE;

pub(crate) use component::{CLIPPY, RUSTFMT};
pub(crate) use masters::{
    FOR_C, Masters, NODE_VARIABLE, PYTHON_PACKAGE, PYTHON_VARIABLE, Program, ROS2_PACKAGE, lacking,
    provide as masters, python, ros2, set_up_emulator, zig,
};
pub(crate) use rust_target::{MINIMUM_RUST, TRIPLE, ThumbToolchain, provide_target, rustup};

use apt::Packages;

use crate::{process, workspace::Workspace};

/// Provides a tool chain for the thumb targets.
pub(crate) fn thumb(workspace: &Workspace) -> Result<ThumbToolchain<'_>> {
    run(workspace, false)
}

/// Provides the tool chain like [`thumb`], and QEMU.
pub(crate) fn thumb_and_qemu(workspace: &Workspace) -> Result<ThumbToolchain<'_>> {
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

fn run(workspace: &Workspace, with_qemu: bool) -> Result<ThumbToolchain<'_>> {
    let mut lacks = Vec::new();
    let mut wanted = Vec::new();
    let mut toolchain = rust_target::find(workspace);
    if toolchain.is_none() && rust_target::rustup(workspace, &rust_target::RUSTUP_ARGUMENTS) {
        toolchain = rust_target::find(workspace);
    }
    if toolchain.is_none() {
        lacks.push(format!("a Rust tool chain for {}", rust_target::TRIPLES.join(" and ")));
        wanted.push(rust_target::packages(workspace));
    }
    if with_qemu && !has_machine() {
        lacks.push(format!("QEMU with the machine {MACHINE}"));
        wanted.push(Packages::qemu()?);
    }
    let lacks = lacks.join(" and ");
    if !wanted.is_empty() {
        if let Some(obstacle) = obstacle_to_installing() {
            bail!("missing: {lacks}; {obstacle}. {}", how_to_install(&wanted, toolchain.is_none()));
        }
        apt::install(&wanted).with_context(|| format!("cannot install {lacks}"))?;
    }
    ensure!(
        !with_qemu || has_machine(),
        "the installed qemu-system-arm lacks the machine {MACHINE}; put a newer one, such as QEMU 10, on PATH"
    );
    toolchain.or_else(|| rust_target::find(workspace)).with_context(|| {
        format!(
            "the installed Rust packages cannot build for {}, which requires Rust {MINIMUM_RUST} or newer; if rustup can reach \
             its server, run: {}",
            rust_target::TRIPLES.join(" and "),
            rustup_line()
        )
    })
}

/// Returns whether the `qemu-system-arm` on PATH supports the machine. It lists each machine in a line, by name and description.
fn has_machine() -> bool {
    process::answer(Command::new("qemu-system-arm").args(["-machine", "help"]))
        .is_some_and(|help| help.contains(&format!("\n{MACHINE} ")))
}

fn how_to_install(wanted: &[Packages], rustup_would_do: bool) -> String {
    let as_root = format!("Run as root, then try again:\n  {}", apt::shell_lines(wanted).join("\n  "));
    if rustup_would_do && rust_target::rustup_may_be_called() {
        return format!(
            "If rustup can reach its server, this replaces the Rust packages and needs no root:\n  {}\n{as_root}",
            rustup_line()
        );
    }
    as_root
}

/// Returns the command that adds the targets if rustup can reach its server.
fn rustup_line() -> String {
    format!("rustup {}", rust_target::RUSTUP_ARGUMENTS.join(" "))
}

/// Reports a failure that does not prevent the remaining steps. Returns whether there was none.
fn report(outcome: Result<()>) -> bool {
    if let Err(error) = &outcome {
        eprintln!("{error:#}; continuing without it");
    }
    outcome.is_ok()
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
