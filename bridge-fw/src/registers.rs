//! The registers of the bridge itself: settings and reports, whatever bus carries them.
//!
//! The tables here are the only ones: the PLC sides serve them, `docs/registers.md` and the EDS file are made from them.

mod events;
mod reports;
mod rows;
mod settings;
mod store_commands;

pub use events::{EVENTS, EVENTS_KEPT, EventCode, EventText};
pub use reports::{
    BusCounts, CanReports, FIRST_REPORT, Link, MAP_VERSION, ProfibusReports, REPORTS, ResetCause,
};
pub use rows::{Report, Setting};
pub use settings::{FIRST_SETTING, FIRST_START_SETTING, Record, SETTINGS, WrongSetting};
pub use store_commands::{
    COMMAND_KEY, COMMANDS, CommandRegister, FIRST_COMMAND, SaveState, SettingsFrom, StoreCommand,
};

pub(crate) use events::Events;
pub(crate) use reports::ReportSource;
pub(crate) use rows::{Rows, place_in};
pub(crate) use settings::Settings;
pub(crate) use store_commands::StoreReports;

/// Why a register was not read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RegisterError {
    /// One of the registers does not exist.
    Missing,
    /// One of the values is out of its register's range.
    Value,
    /// Settings do not change while the fingers move.
    Moving,
    /// Settings do not change while they are being stored.
    Saving,
}

impl core::fmt::Display for RegisterError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Missing => "there is no such register",
            Self::Value => "the value is out of the register's range",
            Self::Moving => "settings do not change while the fingers move",
            Self::Saving => "settings do not change while they are being stored",
        })
    }
}

impl core::error::Error for RegisterError {}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    #[test]
    fn each_refusal_has_words_of_its_own() {
        let all =
            [RegisterError::Missing, RegisterError::Value, RegisterError::Moving, RegisterError::Saving];
        let words = all.map(|it| it.to_string());
        assert_eq!(words[0], "there is no such register");
        assert!(words[1].contains("range") && words[2].contains("move"), "{words:?}");
        assert!(words[3].contains("stored"), "{words:?}");
    }
}
