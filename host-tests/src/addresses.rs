//! Register addresses of the bridge by name, so that tests do not depend on numbers.

use wsg_bridge_fw::registers::{FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS};

/// Returns the index of a setting in the record of all settings.
///
/// # Panics
/// Panics when no setting has this name.
#[must_use]
pub fn place(name: &str) -> usize {
    let place = SETTINGS.iter().position(|setting| setting.name == name);
    place.unwrap_or_else(|| panic!("unknown setting {name}"))
}

/// Returns the holding register of a setting.
///
/// # Panics
/// Panics when no setting has this name.
#[must_use]
pub fn setting(name: &str) -> u16 {
    FIRST_SETTING + place(name) as u16
}

/// Returns the input register of a report.
///
/// # Panics
/// Panics when no report has this name.
#[must_use]
pub fn report(name: &str) -> u16 {
    let place = REPORTS.iter().position(|report| report.name == name);
    FIRST_REPORT + place.unwrap_or_else(|| panic!("unknown report {name}")) as u16
}
