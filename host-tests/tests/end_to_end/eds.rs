//! Parses the EDS file with third-party libraries.

use std::fmt::Write;

use host_tests::masters::{self, printed};
use wsg_bridge_fw::plc::canopen::{DataType, OBJECTS, OUTPUT_INDEX, REPORTS_INDEX, SETTINGS_INDEX};
use wsg_bridge_fw::registers::{REPORTS, SETTINGS};

#[test]
#[ignore = "needs canopen and dcf-tools: run `cargo xtask test`"]
fn eds_file_is_to_canopen_and_dcf_tools_what_the_tables_say() {
    let mut table = String::new();
    for object in OBJECTS {
        let access = match (object.index, object.writable) {
            (OUTPUT_INDEX, true) => "rww",
            (_, true) if object.kind == DataType::Domain => "wo",
            (_, true) => "rw",
            (_, false) => "ro",
        };
        let (kind, mappable) = (object.kind.code(), u8::from(object.mappable));
        writeln!(table, "{:X} {:X} {kind:X} {access} {mappable} - -", object.index, object.sub).unwrap();
    }
    let word = DataType::U16.code();
    for (index, count) in [(SETTINGS_INDEX, SETTINGS.len()), (REPORTS_INDEX, REPORTS.len())] {
        writeln!(table, "{index:X} 0 {:X} ro 0 - -", DataType::U8.code()).unwrap();
        for sub in 1..=count {
            match SETTINGS.get(sub - 1).filter(|_| index == SETTINGS_INDEX) {
                Some(of) => writeln!(table, "{index:X} {sub:X} {word:X} rw 0 {:X} {:X}", of.least, of.most),
                None => writeln!(table, "{index:X} {sub:X} {word:X} ro 0 - -"),
            }
            .unwrap();
        }
    }
    let eds = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/wsg-bridge.eds");
    let output = masters::python(include_str!("eds.py"), &[eds, &table]);
    assert!(output.status.success() && printed(&output).contains("passed"), "{}", printed(&output));
}
