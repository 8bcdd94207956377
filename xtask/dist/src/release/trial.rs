//! Uses files as their users do: in a folder of their own, without Rust on the path.

use std::{
    env, fs,
    io::{BufRead, BufReader, Cursor},
    path::Path,
    process::{Child, Command, Stdio},
};

use anyhow::{Context, Result};
use zip::ZipArchive;

use crate::program::run_program;

/// Variable with the emulator of the Pico.
const EMULATOR: &str = "WSG_MODBUS_NODE";
/// Limit for each program, in seconds.
const LIMIT: &str = "300";

/// Returns a program, started by the words of `launcher`, that sees only the programs of the system. It ends after
/// [`LIMIT`].
pub(super) fn isolated(launcher: &[&str], program: &Path, folder: &Path) -> Command {
    let mut command = Command::new("timeout");
    command.env_clear().env("PATH", "/usr/bin:/bin").env("HOME", folder).current_dir(folder);
    command.envs(env::var_os(EMULATOR).map(|value| (EMULATOR, value)));
    // For Wine: no messages, and no dialogue that offers to install Mono.
    command.env("WINEDEBUG", "-all").env("WINEDLLOVERRIDES", "mscoree=");
    command.arg(LIMIT).args(launcher).arg(program);
    command
}

/// Unpacks a ZIP archive into a folder, with the right to run of its programs.
pub(super) fn unzip(folder: &Path, archive: &[u8]) -> Result<()> {
    Ok(ZipArchive::new(Cursor::new(archive))?.extract(folder)?)
}

/// Unpacks a TAR archive into a folder.
pub(super) fn untar(folder: &Path, archive: &[u8]) -> Result<()> {
    fs::write(folder.join("archive"), archive)?;
    run_program(Command::new("tar").current_dir(folder).args(["-xzf", "archive"]), "")?;
    Ok(fs::remove_file(folder.join("archive"))?)
}

/// A virtual gripper with a part of 20 mm.
pub(super) struct Sim {
    child: Child,
    /// Its TCP address.
    pub(super) address: String,
}

impl Sim {
    /// Starts `wsg-sim` and waits for its address.
    pub(super) fn start(launcher: &[&str], program: &Path, folder: &Path) -> Result<Self> {
        let mut sim = isolated(launcher, program, folder);
        sim.args(["--tcp", "127.0.0.1:0", "--part", "20", "--time-scale", "10"]);
        let mut child =
            sim.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().context("cannot run wsg-sim")?;
        let mut lines = BufReader::new(child.stdout.take().context("stdout is piped")?).lines();
        let address = lines.find_map(|line| Some(line.ok()?.strip_prefix("tcp ")?.to_owned()));
        Ok(Self { child, address: address.context("wsg-sim printed no address")? })
    }
}

impl Drop for Sim {
    fn drop(&mut self) {
        // `timeout` passes SIGTERM to the program. Errors mean that it has already ended.
        let _ = Command::new("kill").arg(self.child.id().to_string()).status();
        let _ = self.child.wait();
    }
}

/// Grips with `wsg` on `wsg-sim`; `ending` is the extension of both.
pub(super) fn grip(launcher: &[&str], folder: &Path, ending: &str) -> Result<()> {
    let sim = Sim::start(launcher, &folder.join(format!("wsg-sim{ending}")), folder)?;
    let address = format!("tcp://{}", sim.address);
    for (line, expected) in
        [("home", "done"), ("grip 20 100 --force 40", "a part is held"), ("release 60 200", "done")]
    {
        let mut wsg = isolated(launcher, &folder.join(format!("wsg{ending}")), folder);
        run_program(wsg.args(["gripper", &address]).args(line.split(' ')), expected)?;
    }
    Ok(())
}
