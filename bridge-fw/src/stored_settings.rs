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
#[derive(Clone)]
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoBus;
    use crate::gripper::GripperLink;
    use crate::io::Inputs;
    use crate::plc::{PlcEvent, PlcSide, Shown, View, WiresConfig};
    use crate::register::{BusCounts, FIRST_REPORT};
    use crate::storage::NoFlash;
    use wsg_protocol::can::Identifiers;

    /// A service port that commands DEFAULTS once, and then reads COMMANDS_REFUSED.
    struct Service {
        is_new: bool,
        refused: u16,
    }

    impl PlcSide for Service {
        fn receive(&mut self, _: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
            if core::mem::take(&mut self.is_new) {
                view.command_store(StoreCommand::Defaults).unwrap();
                return Some(PlcEvent::Configured);
            }
            self.refused = view.report(210 - FIRST_REPORT, BusCounts::default()).unwrap();
            Some(PlcEvent::Served)
        }

        fn show(&mut self, _: Instant, _: &Shown) {}
    }

    /// Without it, the wires keep a debounce time of a second, although the registers show 2 ms.
    #[test]
    fn defaults_apply_to_the_wires_at_once() {
        let slow = WiresConfig { debounce_ms: 1_000, ..WiresConfig::DEFAULT };
        let mut bridge = Bridge::new(Config { wires: slow, ..Config::DEFAULT });
        let mut stored = StoredSettings::new();
        stored.set_delivered(|| Config::DEFAULT.record());
        stored.load(&NoFlash).unwrap();
        let mut service = Service { is_new: true, refused: 0 };
        bridge.serve(0, &mut service);
        stored.turn(Instant::from_millis(0), &mut bridge, &mut NoFlash);

        let mut line = GripperLink::new(Identifiers::DEFAULT);
        for ms in 1..40 {
            let command = if ms < 20 { Inputs::empty() } else { Inputs::MOVE };
            bridge.poll(ms, Inputs::FAST_STOP_OK | command, &mut line, &mut NoBus);
        }
        bridge.serve(40, &mut service);
        assert_eq!(service.refused, 1, "the edge of MOVE, without a gripper");
    }
}
