//! Compares the complete file of a small device with `example.xml`.

use super::*;
use crate::device::tests::controller::PROFILE;
use std::string::ToString;

#[test]
fn file_covers_the_whole_profile() {
    let facts = GsdmlFacts {
        vendor: "Example & <\"Co.\">",
        family: "EX",
        main_family: "I/O",
        info: "A few bytes",
        bitmap: Some("GSDML-1234-5678-EX"),
    };
    // 2 ms, so that 1 ms is not offered.
    let profile = Profile { min_interval: 64, ..PROFILE };
    let text = Gsdml { facts, profile: &profile }.to_string();
    assert_eq!(text, include_str!("example.xml"));
}
