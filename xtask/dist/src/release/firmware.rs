//! The folders for PLC engineers, tried in the emulators.

use std::{fs, process::Command};

use anyhow::{Context, Result, ensure};
use boards::{BOARDS, Board};
use wsg_update::{BOOT_LEN, Check, Keys, Rules, Target};

use super::{Release, VERSION, cargo, programs, sbom, trial};
use crate::{LINUX, START, UPDATES, archive, board_names, contents, program::run_program};

pub(super) fn make(release: &mut Release) -> Result<()> {
    run_program(cargo("build --quiet --locked -p host-tests --bin demo"), "")?;
    let programs = programs::for_plc_engineers(release)?;
    for board in &BOARDS {
        release.xtask(&format!("build --board {}", board.name))?;
        release.xtask(&format!("build --updates --board {}", board.name))?;
        let built = |ending: &str| {
            let file = release.target_dir.join(format!("firmware/{}{ending}", board.name));
            fs::read(&file).with_context(|| format!("{}", file.display()))
        };
        let folder = format!("wsg-bridge-{VERSION}-{}", board.name);
        let mut more = programs.clone();
        for ending in endings(board) {
            more.push((format!("{UPDATES}/{folder}{ending}"), built(ending)?));
        }
        let files = contents(board, built(".elf")?, more)?;
        let files: Vec<_> = files.iter().map(|(name, bytes)| (format!("{folder}/{name}"), bytes)).collect();
        let archive = archive::zip(&files)?;
        let name = format!("{folder}.zip");
        let trial = is_used(release, board, &folder, &archive)?;
        release.add(&name, &archive, trial)?;
        sbom::add(release, &folder, &format!("boards/{}", board.name), board.triple, "boot,slot")?;
    }
    Ok(())
}

/// Returns how the names of the files for updates end: for the drive of a board, and for `wsg bridge PORT update`.
const fn endings(board: &Board) -> [&'static str; 2] {
    [if board.takes_uf2 { "-install.uf2" } else { "-install.bin" }, ".update"]
}

/// Unpacks the archive, checks its sums and that it describes this board, checks the signed image, and grips with the image without
/// boot loader in the emulator.
fn is_used(release: &Release, board: &Board, folder: &str, archive: &[u8]) -> Result<String> {
    let place = release.folder(board.name)?;
    trial::unzip(&place, archive)?;
    let place = place.join(folder);
    run_program(Command::new("sha256sum").current_dir(&place).args(["--quiet", "-c", "SHA256SUMS"]), "")?;
    let read = |name: &str| fs::read_to_string(place.join(name)).with_context(|| name.to_owned());
    board_names::check(board, &read("manual.html")?, &read(START)?)?;
    trial::grip(&[], &place.join(LINUX), "")?;
    let signed = endings(board).map(|ending| fs::read(place.join(format!("{UPDATES}/{folder}{ending}"))));
    let [install, update] = signed;
    let signature = is_signed(board, &install?, &update?)?;
    if board.emulated.is_none() {
        return Ok(format!("sums; wsg grips on wsg-sim; firmware linked only: no emulator; {signature}"));
    }
    let mut demo = trial::isolated(&[], &release.target_dir.join("debug/demo"), &place);
    demo.args(["--speed-up", "8", "--elf"]).arg(place.join("wsg-bridge.elf"));
    run_program(demo, "")?;
    Ok(format!("sums; wsg grips on wsg-sim; demonstration in the emulator; {signature}"))
}

/// Checks the signed image as the boot loader does, and that the file for the drive ends with it. Returns a text about the key.
fn is_signed(board: &Board, install: &[u8], update: &[u8]) -> Result<&'static str> {
    Check::whole(&mut &*update, Rules { target: Target::of(board.name), keys: Keys::BUILT_IN, counter: 0 })?;
    // Blocks of UF2 have 256 bytes after a head of 32.
    let flash: Vec<u8> = if board.takes_uf2 {
        install.chunks(512).filter_map(|block| block.get(32..288)).flatten().copied().collect()
    } else {
        install.to_vec()
    };
    let in_slot = flash.get(BOOT_LEN as usize..).and_then(|slot| slot.get(..update.len()));
    ensure!(in_slot == Some(update), "slot A in the file for the drive differs from the signed image");
    Ok(if Keys::BUILT_IN.contain_test_key() {
        "TEST KEY: anybody can sign updates"
    } else {
        "updates signed with your key"
    })
}

#[cfg(test)]
mod tests {
    use wsg_update::sign::{self, SigningKey};
    use wsg_update::{Manifest, Version};

    use super::*;

    #[test]
    fn damaged_update_or_another_one_in_the_file_for_the_drive_is_found() {
        for board in &BOARDS {
            let target = Target::of(board.name);
            let manifest =
                Manifest { target, version: Version([1; 3]), length: 0, counter: 0, successor: None };
            let update = sign::file(&[7; 1_000], manifest, &SigningKey::from_bytes(&[2; 32])).unwrap();
            let for_drive = |update: &[u8]| {
                let flash = [&vec![0xFF; BOOT_LEN as usize], update].concat();
                if board.takes_uf2 { footprint::uf2_of(&[(0x1000_0000, &flash)]).unwrap() } else { flash }
            };
            let install = for_drive(&update);
            assert_eq!(is_signed(board, &install, &update).unwrap(), "TEST KEY: anybody can sign updates");

            let mut damaged = update.clone();
            damaged[500] ^= 1;
            assert!(is_signed(board, &for_drive(&damaged), &damaged).is_err());
            assert!(is_signed(board, &for_drive(&damaged), &update).is_err());
            assert!(is_signed(board, &install[..1_024], &update).is_err());
            let other = BOARDS.iter().find(|other| other.takes_uf2 == board.takes_uf2 && *other != board);
            assert!(other.is_none_or(|other| is_signed(other, &install, &update).is_err()));
        }
    }
}
