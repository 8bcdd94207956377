//! Parts of the register tables: rows, commands and events. `plc` assembles the tables from the rows of all modules.

mod events;
mod rows;
mod store_commands;
mod update_refusal;

pub use events::{EVENTS, EVENTS_KEPT, EventCode, EventText};
pub use rows::{Report, Setting};
pub use store_commands::{
    COMMAND_KEY, COMMANDS, CommandRegister, FIRST_COMMAND, RegisterCommand, SaveState, SettingsFrom,
    StoreCommand, UpdateCommand,
};
pub use update_refusal::UpdateRefusal;

pub(crate) use events::Events;
pub(crate) use rows::{Rows, assembled, count, place_in, report_rows, saturate, setting_rows};
pub(crate) use store_commands::StoreReports;

/// Address of the first setting, a holding register.
pub const FIRST_SETTING: u16 = 100;

/// Address of the first report, an input register.
pub const FIRST_REPORT: u16 = 100;

/// Version of the register map, increased when a register or a meaning is added or changed.
pub const MAP_VERSION: u16 = 8;

/// State of the link to the gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Link {
    /// The gripper has not answered since power-up.
    #[default]
    Never,
    /// The gripper has stopped answering.
    Silent,
    /// The gripper answers within the time-out.
    Up,
}

/// Cause of the last reset of the MCU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ResetCause {
    /// The board does not report the cause.
    #[default]
    Unknown,
    /// Power-on or brown-out.
    PowerOn,
    /// Reset pin.
    Pin,
    /// Watchdog: the main loop stalled, or skipped a part of its turn.
    Watchdog,
    /// Firmware: a fault or a panic.
    Firmware,
}

/// Counters of a PLC side for its bus. Counters that a side does not support stay at 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounts {
    /// Intact messages on the bus, for any device.
    pub messages: u16,
    /// Messages discarded because of a wrong checksum or length.
    pub errors: u16,
    /// Requests that were answered with an exception.
    pub exceptions: u16,
    /// Messages for this device.
    pub own_messages: u16,
    /// Messages for this device without a response.
    pub no_responses: u16,
    /// Messages for this device that were answered with "busy".
    pub busy: u16,
    /// Messages that were lost because they were too long or too fast.
    pub overruns: u16,
    /// Characters around intact messages that a transceiver caused, and that were ignored.
    pub strays: u16,
}

/// Reason for a failed register access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RegisterError {
    /// A register does not exist.
    Missing,
    /// A value is out of its register's range.
    Value,
    /// Settings cannot change while the fingers move.
    Moving,
    /// Settings cannot change while a save is running.
    Saving,
    /// Settings cannot change during an update.
    Updating,
}

impl core::fmt::Display for RegisterError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Missing => "no such register",
            Self::Value => "the value is out of the register's range",
            Self::Moving => "settings cannot change while the fingers move",
            Self::Saving => "settings cannot change while they are being stored",
            Self::Updating => "settings cannot change during an update",
        })
    }
}

impl core::error::Error for RegisterError {}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    #[test]
    fn each_error_has_its_own_message() {
        let all = [
            RegisterError::Missing,
            RegisterError::Value,
            RegisterError::Moving,
            RegisterError::Saving,
            RegisterError::Updating,
        ];
        let words = all.map(|it| it.to_string());
        assert_eq!(words[0], "no such register");
        assert!(words[1].contains("range") && words[2].contains("move"), "{words:?}");
        assert!(words[3].contains("stored") && words[4].contains("update"), "{words:?}");
    }
}
