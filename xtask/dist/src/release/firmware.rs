//! The folders for PLC engineers, tried in the emulators.

use std::{fs, process::Command};

use anyhow::{Context, Result};
use boards::{BOARDS, Board};

use super::{Release, VERSION, cargo, programs, sbom, trial};
use crate::{LINUX, START, archive, board_names, contents, program::run_program};

pub(super) fn make(release: &mut Release) -> Result<()> {
    run_program(cargo("build --quiet --locked -p host-tests --bin demo"), "")?;
    let programs = programs::for_plc_engineers(release)?;
    for board in &BOARDS {
        release.xtask(&format!("build --board {}", board.name))?;
        let elf = release.target_dir.join(format!("firmware/{}.elf", board.name));
        let elf = fs::read(&elf).with_context(|| format!("{}", elf.display()))?;
        let files = contents(board, elf, programs.clone())?;
        let folder = format!("wsg-bridge-{VERSION}-{}", board.name);
        let files: Vec<_> = files.iter().map(|(name, bytes)| (format!("{folder}/{name}"), bytes)).collect();
        let archive = archive::zip(&files)?;
        let name = format!("{folder}.zip");
        let trial = is_used(release, board, &folder, &archive)?;
        release.add(&name, &archive, trial)?;
        sbom::add(release, &folder, &format!("boards/{}", board.name), board.triple, "firmware")?;
    }
    Ok(())
}

/// Unpacks the archive, checks its sums and that it describes this board, and grips with its image in the emulator.
fn is_used(release: &Release, board: &Board, folder: &str, archive: &[u8]) -> Result<&'static str> {
    let place = release.folder(board.name)?;
    trial::unzip(&place, archive)?;
    let place = place.join(folder);
    run_program(Command::new("sha256sum").current_dir(&place).args(["--quiet", "-c", "SHA256SUMS"]), "")?;
    let read = |name: &str| fs::read_to_string(place.join(name)).with_context(|| name.to_owned());
    board_names::check(board, &read("manual.html")?, &read(START)?)?;
    trial::grip(&[], &place.join(LINUX), "")?;
    if board.emulated.is_none() {
        return Ok("sums; wsg grips on wsg-sim; firmware linked only: no emulator");
    }
    let mut demo = trial::isolated(&[], &release.target_dir.join("debug/demo"), &place);
    demo.args(["--speed-up", "8", "--elf"]).arg(place.join("wsg-bridge.elf"));
    run_program(demo, "")?;
    Ok("sums; wsg grips on wsg-sim; demonstration in the emulator")
}
