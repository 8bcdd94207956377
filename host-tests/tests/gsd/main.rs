//! Checks the device files docs/WSGB5555.gsd, GSDML and EDS against the tables, and parses them with third-party parsers.
//!
//! `WSG_UPDATE_DOCS=1 cargo test -p host-tests --test gsd` updates the files.

mod eds;
mod gsdml;

use bus_profibus::{Baud, Gsd, GsdFacts};
use document::{hold_file, read, root};
use host_tests::device_files::{FOLDERS, GSD, GSD_BITMAPS, VENDOR};
use wsg_fieldbus::profibus::PROFILE;
use wsg_fieldbus::{Diagnosis, InputImage, OutputImage};

const FILE: &str = "docs/WSGB5555.gsd";

/// Supported rates: 9.6 kbit/s to 1.5 Mbit/s.
const RATES: [Baud; 7] =
    [Baud::K9_6, Baud::K19_2, Baud::K45_45, Baud::K93_75, Baud::K187_5, Baud::K500, Baud::M1_5];

/// Returns the SYSSTATE flags that trigger a diagnosis, by their bits.
fn diagnosis_bits() -> Vec<(u16, &'static str)> {
    let bits = Diagnosis::TRIGGERS.iter_names();
    bits.map(|(name, flag)| (flag.bits().trailing_zeros() as u16, name)).collect()
}

fn facts<'a>(diagnosis_bits: &'a [(u16, &'static str)]) -> GsdFacts<'a> {
    GsdFacts {
        vendor: VENDOR,
        model: "wsg-bridge",
        revision: "1.0",
        hardware_release: "1.0",
        software_release: concat!("V", env!("CARGO_PKG_VERSION")),
        // Drives: the family of the original gripper in configuration tools (fieldbus, 2.1).
        family: 1,
        rates: &RATES,
        auto_baud: true,
        // 1 ms, in units of 100 us: a turn of the bridge.
        min_slave_interval: 10,
        module: "8 bytes out, 12 bytes in",
        max_diagnosis_len: Diagnosis::LEN as u8,
        bitmaps: Some(GSD_BITMAPS),
        diagnosis_bits,
    }
}

#[test]
fn gsd_file_is_that_of_the_tables() {
    let bits = diagnosis_bits();
    let text = Gsd { facts: facts(&bits), profile: &PROFILE }.to_string();
    FOLDERS.iter().for_each(|folder| hold_file(&format!("{folder}/{GSD}"), &text));
}

/// Checks the catalogue path (fieldbus, 2.1), PROFIBUS DP -> Drives -> Weiss Robotics GmbH & Co. KG, and the bitmaps.
#[test]
fn gsd_file_has_the_catalogue_path_and_bitmaps_of_the_manual() {
    let text = read(FILE);
    for line in [
        "Slave_Family = 1",
        "Vendor_Name = \"Weiss Robotics GmbH & Co. KG\"",
        "Bitmap_Device = \"WSG_R\"",
        "Bitmap_Diag = \"WSG_D\"",
        "Bitmap_SF = \"WSG_S\"",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}");
    }
}

#[test]
fn parser_of_profirust_reads_what_the_tables_say() {
    let gsd = gsd_parser::parse_from_file(root().join(FILE));
    assert_eq!((gsd.ident_number, gsd.gsd_revision), (0x5555, 1));
    assert_eq!((gsd.vendor.as_str(), gsd.model.as_str()), (VENDOR, "wsg-bridge"));
    assert!(!gsd.modular_station);
    assert!(gsd.fail_safe && gsd.auto_baud_supported);
    assert!(!gsd.freeze_mode_supported && !gsd.sync_mode_supported && !gsd.set_slave_addr_supported);
    let [module] = &gsd.available_modules[..] else { panic!("{:?}", gsd.available_modules) };
    assert_eq!(module.config, PROFILE.config);
    assert_eq!((OutputImage::LEN, InputImage::LEN), (8, 12));
    assert_eq!(usize::from(gsd.max_diag_data_length), Diagnosis::LEN);
    let speeds = gsd_parser::SupportedSpeeds::all()
        - gsd_parser::SupportedSpeeds::B31250
        - gsd_parser::SupportedSpeeds::B3000000
        - gsd_parser::SupportedSpeeds::B6000000
        - gsd_parser::SupportedSpeeds::B12000000;
    assert_eq!(gsd.supported_speeds, speeds);
    assert_eq!((gsd.max_tsdr.b9600, gsd.max_tsdr.b500000, gsd.max_tsdr.b1500000), (60, 100, 150));
    let bits: Vec<_> = gsd.unit_diag.bits.iter().map(|(bit, it)| (*bit as u16, it.text.as_str())).collect();
    let mut expected = diagnosis_bits();
    expected.sort_unstable();
    assert_eq!(bits, expected);
}
