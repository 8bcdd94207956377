//! What the registers of the bridge are made of: rows, commands and events. `plc` assembles the tables from the rows of all
//! modules.

mod events;
mod rows;
mod store_commands;

pub use events::{EVENTS, EVENTS_KEPT, EventCode, EventText};
pub use rows::{Report, Setting};
pub use store_commands::{
    COMMAND_KEY, COMMANDS, CommandRegister, FIRST_COMMAND, SaveState, SettingsFrom, StoreCommand,
};

pub(crate) use events::Events;
pub(crate) use rows::{Rows, assembled, count, place_in, report_rows, saturate, setting_rows};
pub(crate) use store_commands::StoreReports;

/// The address of the first setting.
pub const FIRST_SETTING: u16 = 100;

/// The address of the first report.
pub const FIRST_REPORT: u16 = 100;

/// The version of the register map: the last register or meaning that was added or changed.
pub const MAP_VERSION: u16 = 7;

/// Whether the gripper answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Link {
    /// It has not answered since power-up.
    #[default]
    Never,
    /// It answered, and does not any more.
    Silent,
    /// It does.
    Up,
}

/// Why the MCU was reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ResetCause {
    /// The board does not say.
    #[default]
    Unknown,
    /// Power-on, or a supply that was too low.
    PowerOn,
    /// The reset pin.
    Pin,
    /// The watchdog: the main loop did not come round, or not all of it.
    Watchdog,
    /// The firmware itself: a fault or a panic.
    Firmware,
}

/// What a PLC side has counted on its bus; a side that does not count something leaves it at 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounts {
    /// Intact messages on the bus, whoever they were for.
    pub messages: u16,
    /// Damaged messages.
    pub errors: u16,
    /// Requests that were refused.
    pub exceptions: u16,
    /// Messages for this device.
    pub own_messages: u16,
    /// Those of them that got no answer.
    pub no_responses: u16,
    /// Those of them that were put off.
    pub busy: u16,
    /// Messages that were lost because they were too long or came too fast.
    pub overruns: u16,
}

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
