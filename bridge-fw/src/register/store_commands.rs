//! What can be done with the settings as a whole: registers that take a key, and what is reported of it.

use super::RegisterError;

/// What is done with all settings at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StoreCommand {
    /// Stores them.
    Save,
    /// Takes those again that are stored.
    Restore,
    /// Takes those that the image was delivered with, and stores them.
    Defaults,
}

/// A holding register that does something when the key is written to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandRegister {
    /// Its name.
    pub name: &'static str,
    /// What it does.
    pub meaning: &'static str,
    /// The command.
    pub command: StoreCommand,
}

/// The address of the first of [`COMMANDS`].
pub const FIRST_COMMAND: u16 = 200;

/// What a command register takes; anything else is refused. It reads 0.
pub const COMMAND_KEY: u16 = 0x5AA5;

/// The command registers, from [`FIRST_COMMAND`] on.
pub const COMMANDS: [CommandRegister; 3] = [
    CommandRegister {
        name: "SAVE",
        meaning: "stores the settings: they count after the next power-up too",
        command: StoreCommand::Save,
    },
    CommandRegister {
        name: "RESTORE",
        meaning: "takes the stored settings again, without a start",
        command: StoreCommand::Restore,
    },
    CommandRegister {
        name: "DEFAULTS",
        meaning: "takes the settings that the image was delivered with, and stores them",
        command: StoreCommand::Defaults,
    },
];

impl StoreCommand {
    /// The command of the register at this address, counted from [`FIRST_COMMAND`], if this is its key.
    pub(crate) fn of_register(index: u16, key: u16) -> Result<Self, RegisterError> {
        let register = COMMANDS.get(usize::from(index)).ok_or(RegisterError::Missing)?;
        if key == COMMAND_KEY { Ok(register.command) } else { Err(RegisterError::Value) }
    }
}

/// Where the settings are from that the bridge started with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SettingsFrom {
    /// The image: nothing was ever stored.
    #[default]
    Delivered,
    /// Flash.
    Stored,
    /// Flash, by a firmware that knew fewer of them; the others are the image's.
    StoredByOlder,
    /// The image: those in flash are a newer firmware's.
    RefusedNewer,
    /// The image: one of those in flash is wrong.
    RefusedWrong,
    /// The image: what is in flash is damaged.
    RefusedDamaged,
    /// The image: there is no flash for them.
    NoFlash,
}

impl SettingsFrom {
    /// Whether settings were stored that do not count: other ones than were set up.
    pub(crate) const fn is_refusal(self) -> bool {
        matches!(self, Self::RefusedNewer | Self::RefusedWrong | Self::RefusedDamaged)
    }
}

/// How the last save went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SaveState {
    /// There was none since the start.
    #[default]
    Nothing,
    /// It runs.
    Saving,
    /// What was saved is stored, and was read back.
    Saved,
    /// It failed; what was stored before still is.
    Failed,
}

/// What is reported of the settings in flash.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct StoreReports {
    pub(crate) from: SettingsFrom,
    pub(crate) save: SaveState,
}
