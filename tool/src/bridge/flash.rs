//! Writes an image to the board with probe-rs (like `cargo xtask flash`), with st-flash, or by copying it to the board's drive.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use sha2::{Digest, Sha256};

/// Start address of the flash of the default board.
const FLASH: &str = "0x08000000";

/// Files that identify the drive of a board: that of an ST-Link, and that of the RP2040 boot ROM.
const MARKS: [&str; 2] = ["MBED.HTM", "INFO_UF2.TXT"];

#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// Image to write: .elf (probe-rs), .bin (the board's drive or st-flash) or .uf2 (the board's drive)
    image: PathBuf,
    /// Method to use; by default chosen by the type of the file
    #[arg(long, value_enum)]
    with: Option<With>,
    /// The board's drive, if it is not detected
    #[arg(long, value_name = "FOLDER")]
    drive: Option<PathBuf>,
    /// Microcontroller, as named by probe-rs
    #[arg(long, default_value = "STM32L475VG")]
    chip: String,
    /// Write without asking for confirmation
    #[arg(long, short)]
    pub(crate) yes: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum With {
    /// Debug probe, by probe-rs; supports .elf
    ProbeRs,
    /// ST-Link, by st-flash; supports .bin
    StFlash,
    /// Copy to the board's drive; supports .bin and .uf2
    Drive,
}

/// A checked flash operation, ready to run.
pub(crate) struct Plan {
    image: PathBuf,
    way: Way,
    /// The confirmation question, without the question mark.
    pub(crate) question: String,
}

enum Way {
    /// Programs to run in sequence.
    Programs(Vec<Command>),
    Copy(PathBuf),
}

impl Plan {
    /// Checks the image and selects a method.
    ///
    /// # Errors
    /// The image is invalid, or the program or drive to write it is missing.
    pub(crate) fn new(arguments: &Arguments) -> Result<Self> {
        let image = &arguments.image;
        let bytes = fs::read(image).with_context(|| format!("cannot read {}", image.display()))?;
        let kind = image.extension().and_then(|kind| kind.to_str()).unwrap_or_default().to_ascii_lowercase();
        check(&bytes, &kind).with_context(|| format!("{} is not valid firmware", image.display()))?;
        let with = match (arguments.with, kind.as_str()) {
            (None | Some(With::ProbeRs), "elf") => With::ProbeRs,
            (None | Some(With::Drive), "uf2") | (Some(With::Drive), "bin") => With::Drive,
            (Some(With::StFlash), "bin") => With::StFlash,
            (None, _) if arguments.drive.is_some() || !drives().is_empty() => With::Drive,
            (None, _) => With::StFlash,
            (Some(_), _) => bail!("the method given by --with does not support .{kind} files; see --help"),
        };
        let path = image.as_os_str();
        let (way, by) = match with {
            With::ProbeRs => {
                require("probe-rs", "cargo install probe-rs-tools --locked")?;
                let mut download = Command::new("probe-rs");
                download.args(["download", "--chip", &arguments.chip]).arg(path);
                let mut reset = Command::new("probe-rs");
                reset.args(["reset", "--chip", &arguments.chip]);
                (Way::Programs(vec![download, reset]), format!("with probe-rs for {}", arguments.chip))
            }
            With::StFlash => {
                require(
                    "st-flash",
                    "sudo apt install stlink-tools; or copy the firmware to the board's drive with --drive FOLDER",
                )?;
                let mut write = Command::new("st-flash");
                write.args(["--reset", "write"]).arg(path).arg(FLASH);
                (Way::Programs(vec![write]), "with st-flash".to_owned())
            }
            With::Drive => {
                let drive = match (&arguments.drive, &drives()[..]) {
                    (Some(drive), _) if drive.is_dir() => drive.clone(),
                    (Some(drive), _) => bail!("folder {} not found", drive.display()),
                    (None, [drive]) => drive.clone(),
                    (None, []) => bail!("no board drive found; connect the USB cable or pass --drive FOLDER"),
                    (None, _) => bail!("more than one board drive found; select one with --drive FOLDER"),
                };
                let by = format!("by copying to {}", drive.display());
                (Way::Copy(drive.join(image.file_name().unwrap_or(path))), by)
            }
        };
        let sum: String = Sha256::digest(&bytes).iter().take(4).map(|byte| format!("{byte:02x}")).collect();
        let question = format!(
            "The bridge will restart. Write {} ({} bytes, SHA-256 {sum}...) {by}",
            image.display(),
            bytes.len()
        );
        Ok(Self { image: image.clone(), way, question })
    }

    /// Writes the image.
    ///
    /// # Errors
    /// The program or the copy failed; the board may then hold an incomplete image.
    pub(crate) fn run(self) -> Result<()> {
        match self.way {
            Way::Programs(programs) => {
                for mut program in programs {
                    let name = program.get_program().to_string_lossy().into_owned();
                    let status = program.status().with_context(|| format!("cannot start {name}"))?;
                    if !status.success() {
                        bail!(
                            "{name} failed ({status}); see its output above. The firmware may be incomplete; flash it again"
                        );
                    }
                }
            }
            Way::Copy(to) => {
                copy(&self.image, &to)
                    .with_context(|| format!("cannot copy to {}; flash it again", to.display()))?;
            }
        }
        Ok(())
    }
}

/// Checks that these bytes look like an image of a type: `elf`, `uf2` or `bin`.
fn check(bytes: &[u8], kind: &str) -> Result<()> {
    let word = |at: usize| bytes.get(at..)?.first_chunk().copied().map(u32::from_le_bytes);
    match kind {
        "elf" if bytes.starts_with(b"\x7FELF") => Ok(()),
        "elf" => bail!("not an ELF file"),
        "uf2" if bytes.starts_with(b"UF2\n") => Ok(()),
        "uf2" => bail!("not a UF2 file"),
        // The first words of a vector table: initial stack pointer and reset vector.
        "bin" => match (word(0), word(4)) {
            (Some(0x1000_0000..=0x2FFF_FFFF), Some(0x0800_0000..=0x08FF_FFFF)) => Ok(()),
            _ => bail!("no vector table for this board at the start"),
        },
        _ => bail!("expected a .elf, .bin or .uf2 file"),
    }
}

fn require(program: &str, how: &str) -> Result<()> {
    let mut asked = Command::new(program);
    asked.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if asked.status().is_err() {
        bail!("{program} not found; install it with: {how}");
    }
    Ok(())
}

/// Returns the mounted drives of boards.
fn drives() -> Vec<PathBuf> {
    let is_board = |folder: &PathBuf| MARKS.iter().any(|mark| folder.join(mark).is_file());
    let mounted = fs::read_to_string("/proc/self/mounts").unwrap_or_default();
    let mounts = mounted.lines().filter_map(|line| line.split(' ').nth(1));
    // Spaces are escaped.
    let mounts = mounts.map(|folder| PathBuf::from(folder.replace("\\040", " ")));
    let volumes = fs::read_dir("/Volumes").into_iter().flatten().flatten().map(|entry| entry.path());
    let letters = ('D'..='Z').filter(|_| cfg!(windows)).map(|letter| PathBuf::from(format!("{letter}:\\")));
    mounts.chain(volumes).chain(letters).filter(is_board).collect()
}

fn copy(from: &Path, to: &Path) -> io::Result<()> {
    let (mut from, mut file) = (File::open(from)?, File::create(to)?);
    io::copy(&mut from, &mut file)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_of_another_type_is_rejected() {
        assert!(check(b"\x7FELF...", "elf").is_ok());
        assert!(check(&[0, 0x80, 1, 0x20, 0x89, 1, 0, 8], "bin").is_ok());
        assert!(check(b"UF2\nWQ]\x9E", "uf2").is_ok());
        for (bytes, kind) in
            [(&b"\x7FELF...."[..], "bin"), (b"", "bin"), (b"UF2", "uf2"), (b"x", "elf"), (b"\x7FELF", "hex")]
        {
            assert!(check(bytes, kind).is_err(), "{kind}");
        }
    }

    #[test]
    fn chip_and_programs_match_cargo_xtask_flash() {
        assert_eq!(boards::BOARDS[0].chip, "STM32L475VG");
        let xtask = Path::new(env!("CARGO_MANIFEST_DIR")).join("../xtask/src/commands.rs");
        let flash = fs::read_to_string(xtask).unwrap();
        assert!(flash.contains("[\"download\", \"--chip\"") && flash.contains("[\"reset\", \"--chip\""));
        assert!(flash.contains("cargo install probe-rs-tools --locked"));
    }
}
