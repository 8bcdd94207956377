//! Settings in flash: selection at the start, and execution of SAVE, RESTORE and DEFAULTS.

use crate::bridge::Bridge;
use crate::plc::{Config, Record, SETTINGS, WrongSetting, check_record};
use crate::register::{SettingsFrom, StoreCommand};
use crate::storage::{FlashError, LoadError, NorFlash, Progress, SaveError, Store};
use wsg_protocol::Instant;

/// Version of the record's format. Appending a setting does not change it.
const VERSION: u16 = 1;

/// Length of a record in bytes: each setting in the order of its register, low byte first.
const LEN: usize = 2 * SETTINGS.len();

/// The stored settings, which apply from the next start on, and the settings of the image.
pub(crate) struct StoredSettings {
    store: Store<LEN>,
    delivered: Record,
    from: SettingsFrom,
}

impl StoredSettings {
    pub(crate) const fn new() -> Self {
        Self { store: Store::new(), delivered: [0; SETTINGS.len()], from: SettingsFrom::Delivered }
    }

    /// Returns the source of the configuration that [`load`](Self::load) returned.
    pub(crate) const fn from(&self) -> SettingsFrom {
        self.from
    }

    /// Sets the settings of the image.
    // Not inlined: its return removes them from the stack.
    #[inline(never)]
    pub(crate) fn set_delivered(&mut self, delivered: impl FnOnce() -> Record) {
        self.delivered = delivered();
    }

    /// Returns the configuration for the start.
    ///
    /// # Errors
    /// [`WrongSetting`] if the settings of the image are invalid.
    pub(crate) fn load(&mut self, flash: &impl NorFlash) -> Result<Config, WrongSetting> {
        let delivered = &self.delivered;
        check_record(delivered)?;
        self.from = match self.store.load(flash) {
            Ok(record) if record.version == VERSION => {
                let words = record.payload.as_chunks::<2>().0;
                // The image supplies settings that older firmware did not know.
                let mut stored = *delivered;
                for (value, word) in stored.iter_mut().zip(words) {
                    *value = u16::from_le_bytes(*word);
                }
                let is_whole = words.len() == SETTINGS.len();
                if let Ok(config) = Config::from_record(&stored) {
                    self.from = if is_whole { SettingsFrom::Stored } else { SettingsFrom::StoredByOlder };
                    return Ok(config);
                }
                SettingsFrom::RefusedWrong
            }
            Ok(_) | Err(LoadError::TooLong { .. }) => SettingsFrom::RefusedNewer,
            Err(LoadError::Empty) => SettingsFrom::Delivered,
            Err(LoadError::NoFlash) => SettingsFrom::NoFlash,
            Err(LoadError::Damaged | LoadError::Saving) => SettingsFrom::RefusedDamaged,
        };
        Config::from_record(delivered)
    }

    /// Executes the store command of this turn, and continues a running save.
    pub(crate) fn turn(&mut self, now: Instant, bridge: &mut Bridge, flash: &mut impl NorFlash) {
        let command = bridge.take_store_command();
        if command == Some(StoreCommand::Defaults) {
            bridge.take_settings(&self.delivered);
        }
        if command.is_some() {
            self.begin(bridge);
        }
        match self.store.poll(flash, now) {
            Progress::Idle | Progress::Saving => {}
            Progress::Saved => bridge.save_succeeded(),
            Progress::Failed(error) => bridge.save_failed(failure(error)),
        }
    }

    fn begin(&mut self, bridge: &mut Bridge) {
        let mut payload = [0; LEN];
        for (word, value) in payload.as_chunks_mut::<2>().0.iter_mut().zip(bridge.settings().record()) {
            *word = value.to_le_bytes();
        }
        match self.store.begin(VERSION, &payload) {
            Ok(()) => bridge.save_begins(),
            Err(_) => bridge.save_failed(WORN_OUT),
        }
    }
}

/// Value of SAVE_FAILED if a save cannot start. None is running and the record fits, so the numbers of saves are used up.
const WORN_OUT: u16 = 7;

/// Returns the value of SAVE_FAILED for an error, as listed in the table of events.
const fn failure(error: SaveError) -> u16 {
    match error {
        SaveError::TimedOut | SaveError::Flash(FlashError::Busy) => 1,
        SaveError::Flash(FlashError::Protected) => 2,
        SaveError::Flash(FlashError::NotErased) => 3,
        SaveError::Flash(FlashError::Failed) => 4,
        SaveError::NotErased => 5,
        SaveError::NotWritten => 6,
    }
}
