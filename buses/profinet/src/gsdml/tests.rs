//! The whole file of a small device, as a person can read it: `example.xml`.

use super::*;
use crate::profile::{Fault, Priority};
use std::string::ToString;

static PROFILE: Profile = Profile {
    vendor_id: 0x1234,
    device_id: 0x0056,
    station_type: "Example",
    order_id: "EX-8-16",
    serial_number: "1",
    hardware_revision: 3,
    software_revision: [1, 2, 13],
    // 2 ms: 1 ms is not offered.
    min_interval: 64,
    modules: &[
        Module {
            slot: 0,
            ident: 0x10,
            name: "Example",
            submodules: &[
                Submodule { subslot: 1, ident: 0x11, input_len: 0, output_len: 0 },
                Submodule { subslot: 0x8000, ident: 0x12, input_len: 0, output_len: 0 },
                Submodule { subslot: 0x8001, ident: 0x13, input_len: 0, output_len: 0 },
            ],
        },
        Module {
            slot: 1,
            ident: 0x20,
            name: "1 byte in, 2 out",
            submodules: &[Submodule { subslot: 1, ident: 0x21, input_len: 1, output_len: 2 }],
        },
        Module {
            slot: 2,
            ident: 0x30,
            name: "3 bytes in",
            submodules: &[Submodule { subslot: 1, ident: 0x31, input_len: 3, output_len: 0 }],
        },
    ],
    faults: &[
        Fault { error_type: 0x0104, name: "too hot", priority: Priority::Low },
        Fault { error_type: 0x010C, name: "stopped", priority: Priority::High },
    ],
};

#[test]
fn file_says_all_of_a_profile() {
    let facts = GsdmlFacts { vendor: "example", family: "EX", main_family: "I/O", info: "A few bytes" };
    let text = Gsdml { facts, profile: &PROFILE }.to_string();
    assert_eq!(text, include_str!("example.xml"));
}
