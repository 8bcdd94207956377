//! The virtual gripper where its users are: on Windows, as Wine runs it; and all that `cargo test` builds, checked for Windows and
//! macOS. Nothing for macOS is linked or run: there is neither an SDK nor a machine.

use std::{
    fs,
    process::{Command, Stdio},
};

use anyhow::{Result, bail};

use crate::{
    process,
    setup::{self, CLIPPY, Program},
    workspace::Workspace,
};

/// The tests that need Wine, by the beginning of their names: `test` leaves them out.
pub(crate) const TESTS: &str = "wine::";

const WINDOWS: &str = "x86_64-pc-windows-gnu";
const TARGETS: [&str; 3] = [WINDOWS, "x86_64-apple-darwin", "aarch64-apple-darwin"];
const C_COMPILER: &str = "x86_64-w64-mingw32-gcc";

/// What runs programs for Windows, and what makes them.
const FROM_DEBIAN: [Program; 2] =
    [("Wine", "wine", "wine"), ("C compiler for Windows", C_COMPILER, "gcc-mingw-w64-x86-64-win32")];

/// Checks everything for each target, and runs the tests with Wine.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    for target in TARGETS {
        if !setup::has_target(workspace, target) && !setup::rustup(workspace, &["target", "add", target]) {
            bail!("NOT CHECKED: {target}. rustup could not bring it");
        }
    }
    if let Some(missing) = setup::lacking(&FROM_DEBIAN).first() {
        bail!("NOT CHECKED: wsg-sim on Windows. There is no {missing}");
    }
    if !CLIPPY.provide(workspace) {
        bail!("NOT CHECKED: Windows and macOS. There is no clippy");
    }
    for target in TARGETS {
        let mut clippy = workspace.cargo("clippy");
        if target != WINDOWS {
            // Without an SDK the C of Lua cannot be compiled, and is not: this compiler is content with anything.
            let target = target.replace('-', "_");
            clippy.env(format!("CC_{target}"), "true").env(format!("AR_{target}"), "true");
        }
        process::run(clippy.args(["--all-targets", "--target", target, "--", "-D", "warnings"]))?;
    }
    let mut build = workspace.cargo("build");
    process::run(build.args(["-p", "wsg-sim", "--target", WINDOWS]))?;
    let folder = workspace.target_dir.join(WINDOWS).join("debug");
    let mut library = Command::new(C_COMPILER);
    library.args(["-shared", "-o"]).arg(folder.join("bcryptprimitives.dll"));
    process::run(library.arg(workspace.root.join("xtask/src/platforms.c")).arg("-ladvapi32"))?;

    let tests = || {
        let mut cargo = workspace.cargo("test");
        cargo.args(["-p", "host-tests", "--test", "end_to_end"]);
        cargo
    };
    process::run(tests().arg("--no-run"))?;
    let (exe, prefix) = (folder.join("wsg-sim.exe"), workspace.target_dir.join("wine"));
    fs::create_dir_all(&prefix)?;
    let with_wine = |command: &mut Command| {
        command.env("WINEPREFIX", &prefix).env("WINEDEBUG", "-all");
        // No dialogue that offers to install Mono.
        command.env("WINEDLLOVERRIDES", "mscoree=").env("WSG_SIM_EXE", &exe).env_remove("DISPLAY");
        process::run(command)
    };
    // The server of all these programs is there before them, since several that start it at once may fail; it ends by `-k`, or a
    // minute after the last of them. At its end it lists all that it holds.
    let end = || with_wine(Command::new("wineserver").arg("-k"));
    // One that an interrupted run has left.
    let _ = end();
    let mut server = Command::new("wineserver");
    with_wine(server.arg("-p60").stdout(Stdio::null()).stderr(Stdio::null()))?;
    let outcome = with_wine(Command::new("wine").arg(&exe).arg("--version"))
        .and_then(|()| with_wine(tests().args([TESTS, "--", "--include-ignored"])));
    end()?;
    outcome?;
    println!("platforms: wsg-sim.exe runs, and everything compiles for {}", TARGETS.join(", "));
    Ok(())
}
