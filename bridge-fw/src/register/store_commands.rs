//! Commands for all settings at once and for updates: registers that accept a key, and reports on the outcome of a save.

use super::RegisterError;

/// A command for all settings at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StoreCommand {
    /// Stores the current settings.
    Save,
    /// Applies the stored settings.
    Restore,
    /// Applies the default settings, and stores them.
    Defaults,
}

/// A command for an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum UpdateCommand {
    /// Ends the transfer, and checks the image.
    Check,
    /// Puts the gripper into FAST STOP, and restarts with the image.
    Restart,
}

/// A command of a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RegisterCommand {
    /// For all settings at once.
    Store(StoreCommand),
    /// For an update.
    Update(UpdateCommand),
}

/// A holding register that executes a command when the key is written to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandRegister {
    /// Name in documents and tools.
    pub name: &'static str,
    /// Effect of the command, short enough for a table cell.
    pub meaning: &'static str,
    /// Command that the key executes.
    pub command: RegisterCommand,
}

/// Address of the first of [`COMMANDS`].
pub const FIRST_COMMAND: u16 = 200;

/// Key for all command registers. Other values are refused. Reads return 0.
pub const COMMAND_KEY: u16 = 0x5AA5;

/// Command registers, from [`FIRST_COMMAND`] on.
pub const COMMANDS: [CommandRegister; 5] = [
    CommandRegister {
        name: "SAVE",
        meaning: "stores the settings, so that they also apply after the next power-up",
        command: RegisterCommand::Store(StoreCommand::Save),
    },
    CommandRegister {
        name: "RESTORE",
        meaning: "applies the stored settings without a restart",
        command: RegisterCommand::Store(StoreCommand::Restore),
    },
    CommandRegister {
        name: "DEFAULTS",
        meaning: "applies the default settings, and stores them",
        command: RegisterCommand::Store(StoreCommand::Defaults),
    },
    CommandRegister {
        name: "UPDATE_CHECK",
        meaning: "ends the transfer of an image, and checks it",
        command: RegisterCommand::Update(UpdateCommand::Check),
    },
    CommandRegister {
        name: "UPDATE_RESTART",
        meaning: "puts the gripper into FAST STOP, and restarts with the checked image",
        command: RegisterCommand::Update(UpdateCommand::Restart),
    },
];

impl RegisterCommand {
    /// Returns the command of the register at this index, counted from [`FIRST_COMMAND`], if `key` is correct.
    pub(crate) fn of_register(index: u16, key: u16) -> Result<Self, RegisterError> {
        let register = COMMANDS.get(usize::from(index)).ok_or(RegisterError::Missing)?;
        if key == COMMAND_KEY { Ok(register.command) } else { Err(RegisterError::Value) }
    }
}

/// Source of the settings at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SettingsFrom {
    /// The image, because no settings were stored.
    #[default]
    Delivered,
    /// Flash.
    Stored,
    /// Flash, written by older firmware with fewer settings. The image supplies the others.
    StoredByOlder,
    /// The image, because newer firmware wrote the settings in flash.
    RefusedNewer,
    /// The image, because a setting in flash is invalid.
    RefusedWrong,
    /// The image, because the record in flash is damaged.
    RefusedDamaged,
    /// The image, because the board has no flash for settings.
    NoFlash,
}

impl SettingsFrom {
    /// Returns whether stored settings were refused, so that the bridge runs with other settings than those set up.
    pub(crate) const fn is_refusal(self) -> bool {
        matches!(self, Self::RefusedNewer | Self::RefusedWrong | Self::RefusedDamaged)
    }
}

/// State of the last save.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SaveState {
    /// No save since the start.
    #[default]
    Nothing,
    /// The save is running.
    Saving,
    /// The settings are stored and verified.
    Saved,
    /// The save failed. The previously stored settings are kept.
    Failed,
}

/// Reports on the settings in flash.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct StoreReports {
    pub(crate) from: SettingsFrom,
    pub(crate) save: SaveState,
}
