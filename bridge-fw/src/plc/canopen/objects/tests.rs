use std::vec::Vec;

use super::*;
use crate::can::{BusCounters, BusState, Health, LinkCounters};

#[test]
fn each_entry_about_the_bus_has_its_own_value() {
    let frames =
        wsg_protocol::can::ReassemblerCounters { dropped: 9, miscut: 10, expired: 11, ..Default::default() };
    let report = BusReport {
        state: BusState::Recovering,
        health: Health { is_off: true, is_passive: true, transmit_errors: 4, receive_errors: 5 },
        counters: BusCounters { bus_offs: 6, overruns: 7, refused: 8 },
        link: LinkCounters { frames, overflows: 0, broken: 12 },
    };
    let values: Vec<u32> = OBJECTS
        .iter()
        .filter_map(|object| match object.source {
            Source::Application(Key(value)) if object.index == 0x2002 => Some(bus_value(&report, value)),
            _ => None,
        })
        .collect();
    assert_eq!(values, [0x82, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
}

#[test]
fn each_image_is_one_record() {
    for (index, name) in [(OUTPUT_INDEX, "Output image"), (INPUT_INDEX, "Input image")] {
        assert!(OBJECTS.iter().filter(|object| object.index == index).all(|object| object.record == name));
    }
}
