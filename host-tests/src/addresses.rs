//! The bridge's registers by their names: a test that knew their numbers would be about those.

use wsg_bridge_fw::registers::{FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS};

/// The place of a setting in a record of all.
///
/// # Panics
/// If there is none of this name.
#[must_use]
pub fn place(name: &str) -> usize {
    let place = SETTINGS.iter().position(|setting| setting.name == name);
    place.unwrap_or_else(|| panic!("there is no setting {name}"))
}

/// The holding register of a setting.
///
/// # Panics
/// If there is none of this name.
#[must_use]
pub fn setting(name: &str) -> u16 {
    FIRST_SETTING + place(name) as u16
}

/// The input register of a report.
///
/// # Panics
/// If there is none of this name.
#[must_use]
pub fn report(name: &str) -> u16 {
    let place = REPORTS.iter().position(|report| report.name == name);
    FIRST_REPORT + place.unwrap_or_else(|| panic!("there is no report {name}")) as u16
}
