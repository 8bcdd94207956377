//! The current settings, the stored settings, and the pending store command.

use super::{Config, RANGES, Record, check_sides, place_of};
use crate::recipe::Recipe;
use crate::register::{RegisterError, StoreCommand};

/// Values of [`SETTINGS`](super::SETTINGS), always in range and without conflicts.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Settings {
    values: Record,
    /// Stored values, which apply from the next start on.
    stored: Record,
    /// Store command to execute at the end of the turn.
    asked: Option<StoreCommand>,
}

impl Settings {
    /// Index of BUS_TIMEOUT, counted from the first setting.
    pub(crate) const TIMEOUT: u16 = place_of("BUS_TIMEOUT") as u16;

    /// Creates settings from a configuration, each value clamped to its range.
    pub(crate) const fn new(config: &Config) -> Self {
        let values = config.record();
        Self { values, stored: values, asked: None }
    }

    /// Replaces all settings with a configuration, in place to save stack.
    pub(crate) fn start(&mut self, config: &Config) {
        self.values = config.record();
        self.stored = self.values;
        self.asked = None;
    }

    /// Returns all values, in the order of [`SETTINGS`](super::SETTINGS).
    pub(crate) const fn record(&self) -> &Record {
        &self.values
    }

    /// Returns the setting at this index, counted from the first setting.
    pub(crate) fn register(&self, index: u16) -> Result<u16, RegisterError> {
        self.values.get(usize::from(index)).copied().ok_or(RegisterError::Missing)
    }

    /// Checks whether the registers from `first` on exist and accept these values.
    pub(crate) fn check(
        &self,
        first: u16,
        values: impl Iterator<Item = u16> + Clone,
    ) -> Result<(), RegisterError> {
        let first = usize::from(first);
        let mut ranges = RANGES.get(first..).unwrap_or_default().iter();
        let mut fits = true;
        for value in values.clone() {
            let (least, most) = *ranges.next().ok_or(RegisterError::Missing)?;
            fits &= (least..=most).contains(&value);
        }
        // No second record: it would be on the stack.
        let after = |place: usize| {
            let written = place.checked_sub(first).and_then(|n| values.clone().nth(n));
            written.or_else(|| self.values.get(place).copied()).unwrap_or_default()
        };
        if fits && check_sides(&after).is_ok() { Ok(()) } else { Err(RegisterError::Value) }
    }

    /// Writes the registers from `first` on, all or, if one does not exist or rejects its value, none.
    pub(crate) fn write(
        &mut self,
        first: u16,
        values: impl Iterator<Item = u16> + Clone,
    ) -> Result<(), RegisterError> {
        self.check(first, values.clone())?;
        let places = self.values.get_mut(usize::from(first)..).unwrap_or_default();
        for (place, value) in places.iter_mut().zip(values) {
            *place = value;
        }
        Ok(())
    }

    /// Applies these values without storing them.
    pub(crate) const fn take(&mut self, values: &Record) {
        self.values = *values;
    }

    /// Applies the stored values.
    pub(crate) const fn restore(&mut self) {
        self.values = self.stored;
    }

    /// Marks the current values as stored.
    pub(crate) const fn are_stored(&mut self) {
        self.stored = self.values;
    }

    pub(crate) fn are_changed(&self) -> bool {
        self.values != self.stored
    }

    /// Schedules a store command for the end of the turn.
    pub(crate) const fn ask(&mut self, command: StoreCommand) {
        self.asked = Some(command);
    }

    pub(crate) const fn is_requested(&self) -> bool {
        self.asked.is_some()
    }

    pub(crate) const fn take_requested(&mut self) -> Option<StoreCommand> {
        self.asked.take()
    }

    pub(crate) fn timeout_ms(&self) -> u32 {
        self.values[const { place_of("BUS_TIMEOUT") }].into()
    }

    pub(crate) fn half_frame_ms(&self) -> u32 {
        self.values[const { place_of("HALF_FRAME") }].into()
    }

    pub(crate) fn recipe(&self, number: usize) -> Option<Recipe> {
        Recipe::of(&self.values, number)
    }

    /// Returns the recipe for bus commands, if BUS_RECIPE selects one.
    pub(crate) fn bus_recipe(&self) -> Option<Recipe> {
        self.recipe(self.values[const { place_of("BUS_RECIPE") }].into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plc::{SETTINGS, WiresConfig, WrongSetting, check_record};
    use crate::recipe::{RECIPE_COUNT, RECIPES};
    use std::string::ToString;
    use wsg_fieldbus::SilenceReaction;

    #[test]
    fn settings_start_with_the_values_of_the_configuration() {
        let settings = Settings::new(&Config::DEFAULT);
        for (number, recipe) in RECIPES.iter().enumerate() {
            assert_eq!(settings.recipe(number), Some(*recipe));
        }
        assert_eq!(settings.recipe(RECIPE_COUNT), None);
        assert_eq!(settings.bus_recipe(), None);
        assert_eq!(settings.bus().reaction, SilenceReaction::Stop);
        assert_eq!(
            (settings.wires().debounce_ms, settings.wires().min_busy_ms, settings.half_frame_ms()),
            (2, 50, 20)
        );
        assert_eq!(settings.bus().unit, 1);
        assert_eq!(settings.register(SETTINGS.len() as u16), Err(RegisterError::Missing));
    }

    #[test]
    fn values_of_the_configuration_are_clamped_to_their_ranges() {
        let config = Config {
            wires: WiresConfig { debounce_ms: 0x1_0005, min_busy_ms: u32::MAX },
            half_frame_ms: 0,
            ..Config::DEFAULT
        };
        let settings = Settings::new(&config);
        assert_eq!(
            (settings.wires().debounce_ms, settings.half_frame_ms(), settings.wires().min_busy_ms),
            (1_000, 1, 10_000)
        );
    }

    #[test]
    fn every_setting_accepts_its_range_and_nothing_else() {
        for (index, setting) in SETTINGS.iter().enumerate() {
            let mut settings = Settings::new(&Config::DEFAULT);
            // The valid values of these depend on each other and on CANopen.
            let is_free = !matches!(setting.name, "CAN_ID" | "CAN_NODE" | "CAN_MASTER");
            for value in [setting.least, setting.most].into_iter().filter(|_| is_free) {
                settings.write(index as u16, [value].into_iter()).unwrap();
                assert_eq!(settings.register(index as u16), Ok(value), "{}", setting.name);
                assert!(Config::from_record(settings.record()).is_ok(), "valid at a start: {}", setting.name);
            }
            for value in [setting.least.checked_sub(1), setting.most.checked_add(1)].into_iter().flatten() {
                let refused = settings.write(index as u16, [value].into_iter());
                assert_eq!(refused, Err(RegisterError::Value), "{}", setting.name);
            }
        }
    }

    #[test]
    fn conflicting_values_are_refused_but_a_consistent_pair_is_not() {
        let mut settings = Settings::new(&Config::DEFAULT);
        for (name, value) in [
            ("CAN_RATE", 300),
            ("CAN_ID", 0x100),
            ("CAN_NODE", 0x7F),
            ("CAN_MASTER", 0x10),
            ("PROFIBUS_RATE", 97),
        ] {
            let refused = settings.write(place_of(name) as u16, [value].into_iter());
            assert_eq!(refused, Err(RegisterError::Value), "{value}");
        }
        assert_eq!(settings.write(place_of("CAN_NODE") as u16, [0x7F, 0x10].into_iter()), Ok(()));
        assert!(settings.are_changed());
        let record = *settings.record();
        assert_eq!(check_record(&record), Ok(()));
    }

    #[test]
    fn wrong_setting_is_reported_with_its_range() {
        let mut record = Config::DEFAULT.record();
        record[place_of("BUS_REACTION")] = 3;
        let wrong = Config::from_record(&record).unwrap_err();
        assert_eq!(wrong, WrongSetting { at: place_of("BUS_REACTION") });
        assert!(wrong.to_string().starts_with("BUS_REACTION takes 0 to 2: "), "{wrong}");
        assert_eq!(WrongSetting { at: SETTINGS.len() }.to_string(), "no such setting");
    }

    #[test]
    fn write_with_one_wrong_value_changes_nothing() {
        let mut settings = Settings::new(&Config::DEFAULT);
        let refused = settings.write(0, [9; 3].into_iter());
        assert_eq!(refused, Err(RegisterError::Value), "9 is no reaction");
        assert_eq!(settings.register(0), Ok(1));
        let past_the_end = settings.write(SETTINGS.len() as u16 - 1, [9; 2].into_iter());
        assert_eq!(past_the_end, Err(RegisterError::Missing));
    }
}
