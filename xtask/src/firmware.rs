//! The firmware image: one function builds it, so that what is tested, measured and flashed is byte for byte
//! the same.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use sha2::{Digest, Sha256};

use crate::{process, setup::ThumbToolchain, workspace::Workspace};

/// The package of the firmware.
pub(crate) const PACKAGE: &str = "wsg-bridge-fw";

/// The environment variable that tells the emulator tests which image to boot.
pub(crate) const IMAGE_VARIABLE: &str = "WSG_FIRMWARE_ELF";

/// The environment variables that change what the image is built with: an image for another bus has another name.
const BUS_VARIABLES: [&str; 7] = [
    "WSG_BUS_RATE",
    "WSG_BUS_FORMAT",
    "WSG_BUS_UNIT",
    "WSG_CAN_RATE",
    "WSG_CAN_ID",
    "WSG_CAN_NODE",
    "WSG_CAN_MASTER",
];

const PROFILE: &str = "firmware";

/// What can be on CAN, and the variable that tells the emulator tests which image has it there. Such an image is flashed
/// as it is, and tested with [`OVER_SLCAN`], because no emulator has CAN.
pub(crate) const CAN: [(&str, &str); 3] = [
    ("can-gripper", "WSG_FIRMWARE_ELF_CAN_GRIPPER"),
    ("can-plc", "WSG_FIRMWARE_ELF_CAN_PLC"),
    ("can-gripper,can-plc", "WSG_FIRMWARE_ELF_CAN_BOTH"),
];

/// The feature that puts CAN on a serial line.
pub(crate) const OVER_SLCAN: &str = "can-over-slcan";

/// The features of a list with commas.
pub(crate) fn features(list: &str) -> Vec<String> {
    list.split(',').map(str::to_owned).collect()
}

/// A board that the firmware runs on.
pub(crate) struct Board {
    /// The binary's name, and the image's.
    pub(crate) name: &'static str,
    /// The feature that brings the board's dependencies.
    pub(crate) feature: &'static str,
    /// The microcontroller's name for probe-rs.
    pub(crate) chip: &'static str,
}

/// The default board.
pub(crate) const BOARD: Board =
    Board { name: "b-l475e-iot01a", feature: "board-b-l475e-iot01a", chip: "STM32L475VG" };

/// A built image.
pub(crate) struct Image {
    /// The ELF file, apart from cargo's own output, which the next build replaces.
    pub(crate) path: PathBuf,
    /// SHA-256 of the file, in hex.
    pub(crate) sha256: String,
}

/// Builds the default board's image, with `features` beside the board's own.
pub(crate) fn build(workspace: &Workspace, toolchain: &ThumbToolchain, features: &[String]) -> Result<Image> {
    let mut cargo = toolchain.cargo(workspace, "build");
    cargo.args(selection(features));
    process::run(&mut cargo)?;
    let built = toolchain.output_dir(workspace, PROFILE).join(BOARD.name);
    let bus: Vec<String> =
        BUS_VARIABLES.iter().filter_map(|name| Some(setting(name, &std::env::var(name).ok()?))).collect();
    keep(&built, &workspace.target_dir.join("firmware").join(file_name(&[features, &bus].concat())))
}

/// Cargo's arguments that choose the firmware's binary and profile.
pub(crate) fn selection(features: &[String]) -> Vec<String> {
    selection_for(features, PROFILE)
}

/// The same with another profile.
pub(crate) fn selection_for(features: &[String], profile: &str) -> Vec<String> {
    let features = [&[BOARD.feature.to_owned()], features].concat().join(",");
    ["-p", PACKAGE, "--bin", BOARD.name, "--features", &features, "--profile", profile]
        .map(str::to_owned)
        .to_vec()
}

/// A variable of the build and its value, as a part of the image's name.
fn setting(variable: &str, value: &str) -> String {
    format!("{}={value}", variable.trim_start_matches("WSG_").to_lowercase())
}

/// An image with more features is another image: it must not take the place of the one that is tested.
fn file_name(features: &[String]) -> String {
    let mut name = BOARD.name.to_owned();
    for feature in features {
        name.push('+');
        name.push_str(&feature.replace('/', "-"));
    }
    name + ".elf"
}

fn keep(built: &Path, kept: &Path) -> Result<Image> {
    let bytes = fs::read(built).with_context(|| format!("cannot read the image {}", built.display()))?;
    let write = || {
        fs::create_dir_all(kept.parent().unwrap_or(Path::new(".")))?;
        // Renamed into place: an emulator or a probe that reads the old image now must not see half of each.
        let fresh = kept.with_extension(format!("elf.{}", std::process::id()));
        fs::write(&fresh, &bytes)?;
        fs::rename(&fresh, kept)
    };
    write().with_context(|| format!("cannot write the image {}", kept.display()))?;
    let sha256 = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Image { path: kept.to_owned(), sha256 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_with_more_features_has_a_name_of_its_own() {
        assert_eq!(file_name(&[]), "b-l475e-iot01a.elf");
        assert_eq!(
            file_name(&["defmt".into(), "heapless/defmt".into()]),
            "b-l475e-iot01a+defmt+heapless-defmt.elf"
        );
    }

    #[test]
    fn images_for_other_buses_have_names_that_tell_them_apart() {
        assert_eq!(file_name(&[setting("WSG_BUS_UNIT", "5")]), "b-l475e-iot01a+bus_unit=5.elf");
        assert_ne!(setting("WSG_BUS_UNIT", "5"), setting("WSG_CAN_NODE", "5"));
    }

    #[test]
    fn the_board_feature_is_always_among_the_features() {
        assert!(selection(&["defmt".into()]).contains(&"board-b-l475e-iot01a,defmt".to_owned()));
        assert!(selection(&[]).contains(&"board-b-l475e-iot01a".to_owned()));
    }

    #[test]
    fn a_kept_image_is_the_built_one_and_is_named_by_its_hash() {
        let dir = std::env::temp_dir().join(format!("wsg-xtask-image-{}", std::process::id()));
        fs::create_dir_all(&dir).unwrap();
        fs::write(dir.join("built"), "abc").unwrap();

        let image = keep(&dir.join("built"), &dir.join("firmware/kept.elf")).unwrap();
        let kept = fs::read(&image.path).unwrap();

        fs::remove_dir_all(&dir).unwrap();
        assert_eq!(kept, b"abc");
        // FIPS 180-2, appendix B.1.
        assert_eq!(image.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
