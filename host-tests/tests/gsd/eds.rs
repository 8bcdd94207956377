//! Checks the EDS file of the virtual gripper and the gateway on EtherNet/IP.

use bus_ethernetip::{Eds, EdsFacts};
use document::{hold_file, read};
use host_tests::device_files::ETHERNETIP_EDS;
use host_tests::masters::{printed, python};
use wsg_fieldbus::ethernetip::PROFILE;
use wsg_fieldbus::{InputImage, OutputImage};

const FACTS: EdsFacts<'_> = EdsFacts {
    description: "WSG servo gripper: wsg-sim or wsg gateway, 8 bytes of outputs, 12 bytes of inputs",
    date: "11-29-2026",
    vendor: "wsg-sim",
    type_name: "Generic Device (keyable)",
    catalog: "WSG",
    interval_us: 10_000,
};

#[test]
fn eds_file_is_that_of_the_profile() {
    let [output_len, input_len] = [OutputImage::LEN, InputImage::LEN].map(|len| u16::try_from(len).unwrap());
    let made = Eds { facts: FACTS, profile: &PROFILE, output_len, input_len }.to_string();
    hold_file(&format!("docs/{ETHERNETIP_EDS}"), &made);
}

/// Prints the findings of `eds-pie`, which appear only in its log.
const FINDINGS: &str = r#"
import logging, sys
from eds_pie.eds_pie import CIP_EDS
logging.getLogger().handlers = [logging.StreamHandler(sys.stdout)]
logging.getLogger().setLevel(logging.WARNING)
eds = CIP_EDS(sys.argv[1])
print("entries:", sum(len(section.entries) for section in eds.sections.values()))
"#;

#[test]
#[ignore = "needs eds-pie: run `cargo xtask test`"]
fn eds_pie_finds_no_mistake() {
    let text = read(&format!("docs/{ETHERNETIP_EDS}"));
    let findings = |text: &str| printed(&python(FINDINGS, &[text]));
    assert_eq!(findings(&text), "entries: 29\n");
    for (from, to, finding) in [
        (FACTS.date, "2026-11-29", "ModDate"),
        ("Revision = 1.1", "Revision = 1", "Revision"),
        (",Assem100,", ",Assem101,", "Missing referenced Entry"),
        ("Param1,8", "Param2,8", "Missing referenced Entry"),
    ] {
        let findings = findings(&text.replace(from, to));
        assert!(findings.contains(finding), "{to}: {findings}");
    }
}
