//! Runs the virtual gripper and the demonstration for Windows under Wine, and checks everything that `cargo test` builds for Windows and macOS. Nothing is
//! linked or run for macOS, because there is neither an SDK nor a machine.

use std::{
    fs,
    process::{Command, Stdio},
};

use anyhow::{Result, bail, ensure};

use crate::{
    process,
    setup::{self, CLIPPY, Program},
    workspace::Workspace,
};

/// Name prefix of the tests that need Wine. `test` skips them.
pub(crate) const TESTS: &str = "wine::";

pub(crate) const WINDOWS: &str = "x86_64-pc-windows-gnu";
const TARGETS: [&str; 3] = [WINDOWS, "x86_64-apple-darwin", "aarch64-apple-darwin"];
const C_COMPILER: &str = "x86_64-w64-mingw32-gcc";

/// The C compiler for Windows.
pub(crate) const MINGW: Program = ("C compiler for Windows", C_COMPILER, "gcc-mingw-w64-x86-64-win32");
/// Wine, and the C compiler for Windows.
pub(crate) const FROM_DEBIAN: [Program; 2] = [("Wine", "wine", "wine"), MINGW];

/// Checks everything for each target, and runs the tests with Wine.
pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    for target in TARGETS {
        ensure!(
            setup::provide_target(workspace, target),
            "NOT CHECKED: {target}. rustup could not install it"
        );
    }
    if let Some(missing) = setup::lacking(&FROM_DEBIAN).first() {
        bail!("NOT CHECKED: wsg-sim on Windows. {missing} is missing");
    }
    ensure!(CLIPPY.provide(workspace), "NOT CHECKED: Windows and macOS. clippy is missing");
    for target in TARGETS {
        let mut clippy = workspace.cargo("clippy --all-targets --target");
        clippy.args([target, "--", "-D", "warnings"]);
        if target != WINDOWS {
            // Without an SDK, Lua's C code cannot be compiled. `true` as the compiler skips it.
            let target = target.replace('-', "_");
            clippy.env(format!("CC_{target}"), "true").env(format!("AR_{target}"), "true");
        }
        process::run(&mut clippy)?;
    }
    process::run(workspace.cargo("build -p wsg-sim -p host-tests --bins --target").arg(WINDOWS))?;
    let folder = workspace.target_dir.join(WINDOWS).join("debug");
    let mut library = Command::new(C_COMPILER);
    library.args(["-shared", "-o"]).arg(folder.join("bcryptprimitives.dll"));
    process::run(library.arg(workspace.root.join("xtask/src/platforms.c")).arg("-ladvapi32"))?;

    let tests = || workspace.cargo("test -p host-tests -p dist-c --test end_to_end --test archive");
    process::run(tests().arg("--no-run"))?;
    let (exe, prefix) = (folder.join("wsg-sim.exe"), workspace.target_dir.join("wine"));
    fs::create_dir_all(&prefix)?;
    let with_wine = |command: &mut Command| {
        command.env("WINEPREFIX", &prefix).env("WINEDEBUG", "-all");
        // Suppress the dialogue that offers to install Mono.
        command.env("WINEDLLOVERRIDES", "mscoree=").env("WSG_SIM_EXE", &exe).env_remove("DISPLAY");
        process::run(command)
    };
    // Start the Wine server first, because programs that start it simultaneously may fail. It exits on `-k`, or a minute after the
    // last program, and then lists all objects that it holds.
    let end = || with_wine(Command::new("wineserver").arg("-k"));
    // Stop a server left by an interrupted run.
    let _ = end();
    let mut server = Command::new("wineserver");
    with_wine(server.arg("-p60").stdout(Stdio::null()).stderr(Stdio::null()))?;
    // The demonstration runs the bridge's library there.
    let demo = folder.join("demo.exe");
    let outcome = with_wine(Command::new("wine").arg(&exe).arg("--version"))
        .and_then(|()| with_wine(Command::new("wine").arg(demo).args(["--speed-up", "8"])))
        .and_then(|()| with_wine(tests().args([TESTS, "--", "--include-ignored"])));
    end()?;
    outcome?;
    println!(
        "platforms: wsg-sim.exe and the demonstration run, and everything compiles for {}",
        TARGETS.join(", ")
    );
    Ok(())
}
