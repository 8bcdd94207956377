//! Compares the complete file of a small device with `example.eds`.

use super::*;
use crate::device::tests::PROFILE;
use std::string::ToString;

#[test]
fn file_covers_the_whole_profile() {
    let facts = EdsFacts {
        description: "A few bytes",
        date: "01-31-2026",
        vendor: "Example",
        type_name: "Communications Adapter",
        catalog: "EX-8-12",
        interval_us: 10_000,
    };
    // One number that does not fit in 8 bits.
    let profile = Profile { listen_only: 0x0199, min_interval_us: 2_000, ..PROFILE };
    let text = |profile| Eds { facts, profile, output_len: 8, input_len: 12 }.to_string();
    let (unicast, text) = (text(&Profile { allows_multicast: false, ..PROFILE }), text(&profile));
    assert_eq!(text.replace("\r\n", "\n"), include_str!("example.eds").replace('\r', ""));
    assert_eq!(text.matches("\r\n").count(), text.matches('\n').count());
    assert!(unicast.contains("0x44440405") && unicast.matches("0x44440305").count() == 2);
}
