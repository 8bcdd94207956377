//! The firmware image. A single function builds it, so that the same bytes are tested, measured and flashed.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use boards::{BOARDS, Board};
use sha2::{Digest, Sha256};

use crate::{
    process,
    settings::{self, Change},
    setup::ThumbToolchain,
};

/// Package of the board-independent bridge library.
pub(crate) const BRIDGE: &str = "wsg-bridge-fw";

/// Environment variable that names the image for the emulator tests.
pub(crate) const IMAGE_VARIABLE: &str = "WSG_FIRMWARE_ELF";

/// Profile of the released images.
pub(crate) const PROFILE: &str = "firmware";

/// Images for the emulator tests: environment variable and settings, the defaults first.
///
/// The others put gripper, PLC or both on CAN at different rates, disable the bus, or select the lowest PROFIBUS rate. A busy
/// host pauses emulator or master at times, so PROFIBUS has that rate, and both buses a long time-out: the first image after a
/// silent second would give no edge.
pub(crate) const CHOICES: [(&str, &[(&str, u16)]); 6] = [
    (IMAGE_VARIABLE, &[]),
    ("WSG_FIRMWARE_ELF_CAN_GRIPPER", &[("GRIPPER_LINE", 1), ("CAN_RATE", 1000)]),
    ("WSG_FIRMWARE_ELF_CAN_PLC", &[("PLC_BUS", 2), ("CAN_RATE", 250), ("BUS_TIMEOUT", 60_000)]),
    ("WSG_FIRMWARE_ELF_CAN_BOTH", &[("GRIPPER_LINE", 1), ("PLC_BUS", 2), ("BUS_TIMEOUT", 60_000)]),
    ("WSG_FIRMWARE_ELF_NO_BUS", &[("PLC_BUS", 0)]),
    ("WSG_FIRMWARE_ELF_PROFIBUS", &[("PLC_BUS", 3), ("PROFIBUS_RATE", 96), ("BUS_TIMEOUT", 60_000)]),
];

/// A variant of the image. The default has no additional features or settings.
#[derive(Default, clap::Args)]
pub(crate) struct Variant {
    /// Board to build for (pico also builds a UF2 file)
    #[arg(long, value_name = "NAME", value_parser = Board::named, default_value = Board::default_name())]
    pub(crate) board: &'static Board,
    /// Additional features. Such an image gets a separate name
    #[arg(long, value_name = "X", value_delimiter = ',')]
    pub(crate) features: Vec<String>,
    /// Change a default setting (docs/registers.md)
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = Change::parse)]
    pub(crate) settings: Vec<Change>,
}

/// The feature of a board's crate that makes it a program.
const FIRMWARE: &str = "firmware";

/// The feature with which an image links only if no panic is reachable. Additional features, such as logging, may panic.
const PANIC_FREE: &str = "prove-panic-free";

/// A built firmware image and its hash.
pub(crate) struct Image {
    /// The board that the image is for.
    pub(crate) board: &'static Board,
    /// Copy of the ELF file, because the next build overwrites cargo's output.
    pub(crate) path: PathBuf,
    /// SHA-256 of the ELF file in hex.
    pub(crate) sha256: String,
}

/// Builds a board's image.
pub(crate) fn build(toolchain: &ThumbToolchain<'_>, variant: &Variant) -> Result<Image> {
    let board = variant.board;
    let mut cargo = toolchain.cargo("build", board.triple);
    cargo.args(selection(board, &variant.features, PROFILE));
    process::run(&mut cargo)?;
    let built = toolchain.output_dir(board.triple, PROFILE).join(board.name);
    let mut elf = fs::read(&built).with_context(|| format!("cannot read the image {}", built.display()))?;
    settings::apply(&mut elf, &variant.settings)?;
    let kept = toolchain.workspace.target_dir.join("firmware").join(file_name(variant));
    if board.takes_uf2 {
        keep(board, &footprint::uf2(&elf)?, &kept.with_extension("uf2"))?;
    }
    keep(board, &elf, &kept)
}

/// Builds a board's default image, linked for slot A of the boot loader.
pub(crate) fn build_for_slot(toolchain: &ThumbToolchain<'_>, board: &'static Board) -> Result<Image> {
    let features = ["slot", PANIC_FREE].map(str::to_owned).to_vec();
    build(toolchain, &Variant { board, features, settings: Vec::new() })
}

/// Builds a board's boot loader, which links only if no panic is reachable and 32 KiB suffice.
pub(crate) fn boot_loader(toolchain: &ThumbToolchain<'_>, board: &'static Board) -> Result<Image> {
    let name = format!("boot-{}", board.name);
    let mut cargo = toolchain.cargo("build", board.triple);
    let features = format!("boot,{PANIC_FREE}");
    cargo.args(["-p", &format!("wsg-{}", board.name), "--bin", &name, "--features", &features]);
    process::run(cargo.args(["--profile", PROFILE]))?;
    let built = toolchain.output_dir(board.triple, PROFILE).join(&name);
    let elf = fs::read(&built).with_context(|| format!("cannot read the boot loader {}", built.display()))?;
    keep(board, &elf, &toolchain.workspace.target_dir.join("firmware").join(name + ".elf"))
}

/// Builds the default images of all boards, the default board's first.
pub(crate) fn build_all(toolchain: &ThumbToolchain<'_>) -> Result<Vec<Image>> {
    BOARDS.iter().map(|board| build(toolchain, &Variant { board, ..Variant::default() })).collect()
}

/// Builds the static library for C programs on a target. A program with a panic path fails to link with it.
pub(crate) fn c_library(toolchain: &ThumbToolchain<'_>, triple: &str) -> Result<PathBuf> {
    let options = "-p wsg-c --lib --crate-type staticlib --features static-library --profile c-library";
    process::run(toolchain.cargo("rustc", triple).args(options.split(' ')))?;
    Ok(toolchain.output_dir(triple, "c-library").join("libwsg.a"))
}

/// Returns cargo's arguments that select the firmware's binary, features and profile.
pub(crate) fn selection(board: &Board, features: &[String], profile: &str) -> Vec<String> {
    let features = if features.is_empty() { PANIC_FREE } else { &features.join(",") };
    let features = format!("{FIRMWARE},{features}");
    ["-p", &format!("wsg-{}", board.name), "--bin", board.name, "--features", &features, "--profile", profile]
        .map(str::to_owned)
        .to_vec()
}

/// Returns the file name of a variant, which must not overwrite the tested image.
fn file_name(Variant { board, features, settings }: &Variant) -> String {
    let mut name = board.name.to_owned();
    for part in features.iter().cloned().chain(settings.iter().map(Change::to_string)) {
        name.push('+');
        name.push_str(&part.replace('/', "-"));
    }
    name + ".elf"
}

/// Writes a file for a board.
pub(crate) fn keep(board: &'static Board, bytes: &[u8], kept: &Path) -> Result<Image> {
    let write = || {
        fs::create_dir_all(kept.parent().unwrap_or(Path::new(".")))?;
        // Replace the file atomically, because an emulator or a probe may be reading the old image.
        let fresh = kept.with_extension(format!("fresh.{}", std::process::id()));
        fs::write(&fresh, bytes)?;
        fs::rename(&fresh, kept)
    };
    write().with_context(|| format!("cannot write the image {}", kept.display()))?;
    let sha256 = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Image { board, path: kept.to_owned(), sha256 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_variant_has_a_distinct_file_name() {
        assert_eq!(file_name(&Variant::default()), "b-l475e-iot01a.elf");
        let features = vec!["defmt".into(), "heapless/defmt".into()];
        let settings = vec![Change::new("UNIT", 5).unwrap()];
        assert_eq!(
            file_name(&Variant { features, settings, ..Variant::default() }),
            "b-l475e-iot01a+defmt+heapless-defmt+UNIT=5.elf"
        );
    }

    #[test]
    fn a_kept_image_is_the_built_one_and_is_named_by_its_hash() {
        let dir = std::env::temp_dir().join(format!("wsg-xtask-image-{}", std::process::id()));

        let image = keep(<&Board>::default(), b"abc", &dir.join("firmware/kept.elf")).unwrap();
        let kept = fs::read(&image.path).unwrap();

        fs::remove_dir_all(&dir).unwrap();
        assert_eq!(kept, b"abc");
        // FIPS 180-2, appendix B.1.
        assert_eq!(image.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
