//! Compares the table of settings and reports with the released one, so that numbers, names and ranges stay.

use std::fmt::Write;

use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS};

const GOLDEN: &str = include_str!("register_table.txt");

#[test]
fn registers_keep_number_name_range_default_and_unit() {
    let mut table = String::new();
    for ((register, setting), default) in (FIRST_SETTING..).zip(&SETTINGS).zip(Config::DEFAULT.record()) {
        let line = format!("setting {register} {} {}..={}", setting.name, setting.least, setting.most);
        writeln!(table, "{}", format!("{line} {default} {}", setting.unit).trim_end()).unwrap();
    }
    for (register, report) in (FIRST_REPORT..).zip(&REPORTS) {
        writeln!(table, "report {register} {}", report.name).unwrap();
    }
    for (new, golden) in table.lines().zip(GOLDEN.lines()) {
        assert_eq!(new, golden);
    }
    assert_eq!(table.lines().count(), GOLDEN.lines().count());
}
