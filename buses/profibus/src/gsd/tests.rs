//! Compares the GSD file line by line.

use super::*;
use std::string::ToString;
use std::vec::Vec;

static PROFILE: Profile = Profile {
    ident: 0x12AB,
    config: &[0xA7, 0x9B],
    sync: true,
    freeze: false,
    fail_safe: true,
    set_address: false,
};

const FACTS: GsdFacts<'_> = GsdFacts {
    vendor: "maker",
    model: "device",
    revision: "A",
    hardware_release: "B",
    software_release: "C",
    family: 3,
    rates: &Baud::ALL,
    auto_baud: true,
    min_slave_interval: 300,
    module: "8 out, 12 in",
    max_diagnosis_len: 16,
    bitmaps: Some(["DEV_R", "DEV_D", "DEV_S"]),
    diagnosis_bits: &[(4, "hot"), (20, "cold")],
};

const FILE: [&str; 52] = [
    "#Profibus_DP",
    "GSD_Revision = 1",
    "Vendor_Name = \"maker\"",
    "Model_Name = \"device\"",
    "Revision = \"A\"",
    "Ident_Number = 0x12AB",
    "Protocol_Ident = 0",
    "Station_Type = 0",
    "FMS_supp = 0",
    "Hardware_Release = \"B\"",
    "Software_Release = \"C\"",
    "9.6_supp = 1",
    "19.2_supp = 1",
    "45.45_supp = 1",
    "93.75_supp = 1",
    "187.5_supp = 1",
    "500_supp = 1",
    "1.5M_supp = 1",
    "3M_supp = 1",
    "6M_supp = 1",
    "12M_supp = 1",
    "MaxTsdr_9.6 = 60",
    "MaxTsdr_19.2 = 60",
    "MaxTsdr_45.45 = 60",
    "MaxTsdr_93.75 = 60",
    "MaxTsdr_187.5 = 60",
    "MaxTsdr_500 = 100",
    "MaxTsdr_1.5M = 150",
    "MaxTsdr_3M = 250",
    "MaxTsdr_6M = 450",
    "MaxTsdr_12M = 800",
    "Redundancy = 0",
    "Repeater_Ctrl_Sig = 0",
    "24V_Pins = 0",
    "Bitmap_Device = \"DEV_R\"",
    "Bitmap_Diag = \"DEV_D\"",
    "Bitmap_SF = \"DEV_S\"",
    "Freeze_Mode_supp = 0",
    "Sync_Mode_supp = 1",
    "Auto_Baud_supp = 1",
    "Set_Slave_Add_supp = 0",
    "Fail_Safe = 1",
    "User_Prm_Data_Len = 0",
    "Min_Slave_Intervall = 300",
    "Slave_Family = 3",
    "Max_Diag_Data_Len = 16",
    "Unit_Diag_Bit(4) = \"hot\"",
    "Unit_Diag_Bit(20) = \"cold\"",
    "Modular_Station = 0",
    "Module = \"8 out, 12 in\" 0xA7,0x9B",
    "EndModule",
    "",
];

#[test]
fn file_has_a_line_for_each_fact() {
    let text = Gsd { facts: FACTS, profile: &PROFILE }.to_string();
    let lines: Vec<&str> = text.split("\r\n").collect();
    assert_eq!(lines, FILE);
}

#[test]
fn file_without_bitmaps_names_none() {
    let text = Gsd { facts: GsdFacts { bitmaps: None, ..FACTS }, profile: &PROFILE }.to_string();
    assert!(!text.contains("Bitmap"), "{text}");
}

#[test]
fn unsupported_rates_are_listed_as_such() {
    let facts = GsdFacts { rates: &[Baud::K45_45], ..FACTS };
    let text = Gsd { facts, profile: &PROFILE }.to_string();
    for baud in Baud::ALL {
        let (flag, time) = (u8::from(baud == Baud::K45_45), std::format!("MaxTsdr_{} ", name(baud)));
        assert!(text.contains(&std::format!("\r\n{}_supp = {flag}\r\n", name(baud))), "{baud:?}");
        assert_eq!(text.contains(&time), flag == 1, "{baud:?}");
    }
}
