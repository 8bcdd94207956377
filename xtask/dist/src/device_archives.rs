//! Archives of device files for installation in PLC engineering tools (fieldbus, 2.1 and 3.1).

use std::fs;

use anyhow::{Context, Result};
use document::root;
use host_tests::device_files::{GSD, GSD_BITMAPS, GSDML, GSDML_BITMAP, VENDOR};

use crate::archive::zip;
use crate::bitmap::{Lamp, gripper};

pub(crate) const GSD_ARCHIVE: &str = "WSGB5555.zip";
pub(crate) const GSDML_ARCHIVE: &str = "GSDML-WSG.zip";

const INSTALL: &str = "\
TIA Portal (STEP 7), the GSD file of wsg-bridge:

1. Unpack this archive into a folder.
2. Open the project view.
3. Options -> Manage general station description files (GSD).
4. Select the folder, then WSGB5555.gsd, and install it.

The device is in the hardware catalogue under
Other field devices -> PROFIBUS DP -> Drives -> VENDOR -> wsg-bridge
";

/// Returns both archives with their names.
///
/// # Errors
/// Fails when a device file cannot be read.
pub(crate) fn archives() -> Result<[(&'static str, Vec<u8>); 2]> {
    let device_file =
        |name: &str| fs::read(root().join("docs").join(name)).with_context(|| format!("docs/{name}"));
    let bitmaps = GSD_BITMAPS.map(|name| format!("{name}.bmp"));
    let [normal, diagnosis, special] = bitmaps.each_ref().map(String::as_str);
    let install = INSTALL.replace("VENDOR", VENDOR).replace('\n', "\r\n");
    let gsd = zip(&[
        (GSD, device_file(GSD)?),
        (normal, gripper(Lamp::Green)),
        (diagnosis, gripper(Lamp::Red)),
        (special, gripper(Lamp::Yellow)),
        ("install.txt", install.into_bytes()),
    ])?;
    let symbol = format!("{GSDML_BITMAP}.bmp");
    let gsdml = zip(&[(GSDML, device_file(GSDML)?), (&symbol, gripper(Lamp::Green))])?;
    Ok([(GSD_ARCHIVE, gsd), (GSDML_ARCHIVE, gsdml)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::tests::unzip;

    /// Fieldbus, 2.1 and 3.1, with this project's device file names.
    #[test]
    fn archives_hold_the_files_of_the_manual_and_are_reproducible() {
        let made = archives().unwrap();
        let [gsd, gsdml] = made.each_ref().map(|(_, archive)| unzip(archive));
        let names = |files: &[(String, Vec<u8>)]| -> Vec<String> {
            files.iter().map(|(name, _)| name.clone()).collect()
        };
        assert_eq!(names(&gsd), ["WSGB5555.gsd", "WSG_R.bmp", "WSG_D.bmp", "WSG_S.bmp", "install.txt"]);
        assert_eq!(names(&gsdml), [GSDML, "GSDML-02A2-0001-WSG.bmp"]);
        assert_eq!(gsd[0].1, fs::read(root().join("docs").join(GSD)).unwrap());
        assert_eq!(gsdml[0].1, fs::read(root().join("docs").join(GSDML)).unwrap());
        assert!(made == archives().unwrap());
    }

    #[test]
    fn archives_hold_every_bitmap_that_their_device_files_name() {
        for (name, archive) in archives().unwrap() {
            let files = unzip(&archive);
            let text = String::from_utf8_lossy(&files[0].1);
            let bitmaps: Vec<&str> = text
                .lines()
                .filter(|line| line.starts_with("Bitmap_") || line.contains("GraphicFile="))
                .filter_map(|line| line.rsplit('"').nth(1))
                .collect();
            assert_eq!(bitmaps.len(), if name == GSD_ARCHIVE { 3 } else { 1 }, "{name}");
            for bitmap in bitmaps {
                let found = files.iter().find(|(file, _)| *file == format!("{bitmap}.bmp"));
                assert!(found.is_some_and(|(_, bytes)| bytes.starts_with(b"BM")), "{bitmap}");
            }
        }
    }

    #[test]
    fn instructions_have_the_catalogue_path_of_the_manual() {
        let [(_, gsd), _] = archives().unwrap();
        let text = String::from_utf8(unzip(&gsd).pop().unwrap().1).unwrap();
        assert!(
            text.contains("PROFIBUS DP -> Drives -> Weiss Robotics GmbH & Co. KG -> wsg-bridge\r\n"),
            "{text}"
        );
    }
}
