//! The settings of a bridge as holding registers: one table, for the PLC's bus, for flash and for `--set`.

use super::rows::{Rows, assembled, count, setting_rows};
use super::{RegisterError, Setting, StoreCommand};
use crate::config::{
    BusConfig, CanConfig, Config, Format, GripperLine, PlcBus, ProfibusConfig, RECIPE_COUNT, Recipe,
    collides_with_canopen,
};
use wsg_fieldbus::SilenceReaction;
use wsg_protocol::can::Identifiers;

/// The address of the first of [`SETTINGS`].
pub const FIRST_SETTING: u16 = 100;

setting_rows! { Config:
    106 "DEBOUNCE" "ms" (0, 1_000) "how long a wire must keep its level; a low FAST_STOP_OK counts at once, whatever is set here"
        debounce_ms: |it| saturate(it), |value| Some(value.into());
    107 "MIN_BUSY" "ms" (0, 10_000) "how long the wire BUSY is high at the least; for the refusal of a command, at least 50 ms"
        min_busy_ms: |it| saturate(it), |value| Some(value.into());
    108 "HALF_FRAME" "ms" (1, 1_000) "after how long without a byte half a frame of the gripper is given up"
        half_frame_ms: |it| saturate(it), |value| Some(value.into());
    173 "BUS_RECIPE" "" (0, RECIPE_COUNT as u16)
        "0 to 15: commands of the bus take this recipe's values; 16: WIDTH, SPEED and FORCELIMIT that it writes"
        bus_recipe: |it| match it { Some(number) => number as u16, None => u16::MAX },
        |value| Some(u8::try_from(value).ok().filter(|it| usize::from(*it) < RECIPE_COUNT));
    174 "PLC_BUS" "" (0, PlcBus::ALL.len() as u16 - 1)
        "the PLC's bus, beside the wires: 0 none, 1 Modbus RTU, 2 CANopen, 3 PROFIBUS DP"
        plc_bus: |it| it as u16, |value| PlcBus::ALL.get(usize::from(value)).copied();
    175 "GRIPPER_LINE" "" (0, 1) "the gripper's line: 0 RS-232, 1 CAN"
        gripper_line: |it| it as u16,
        |value| Some(if value == 0 { GripperLine::Serial } else { GripperLine::Can });
}

setting_rows! { BusConfig:
    100 "UNIT" "" (1, 247) "the bridge's address on the bus, from the next request on"
        unit: |it| it as u16, |value| Some(value as u8);
    101 "BUS_TIMEOUT" "ms" (0, u16::MAX) "how long a PLC that commanded may be silent; 0: for ever"
        timeout_ms: |it| it, |value| Some(value);
    102 "BUS_REACTION" "" (0, 2) "what is done then: 0 hold, 1 stop, 2 FAST STOP; a jog ends in any case"
        reaction: |it| it as u16, |value| Some(match value {
            0 => SilenceReaction::Hold,
            1 => SilenceReaction::Stop,
            _ => SilenceReaction::FastStop,
        });
    103 "BUS_CHAR_TIMEOUT" "ms" (0, 1_000) "how long a pause inside a request may be; 0: T1.5, by the specification"
        character_timeout_ms: |it| it, |value| Some(value);
    104 "BROADCAST" "" (0, 1) "1: broadcast writes count"
        broadcast: |it| it as u16, |value| Some(value != 0);
    105 "SWAP_BYTES" "" (0, 1) "1: the bytes of the numbers in registers 0 to 5 change places"
        swap_bytes: |it| it as u16, |value| Some(value != 0);
    176 "MODBUS_RATE" "100 bit/s" (12, 2_304) "the rate of Modbus RTU"
        baud: |it| saturate(it / 100), |value| Some(u32::from(value) * 100);
    177 "MODBUS_FORMAT" "" (0, 2) "a character of Modbus RTU: 0 8E1, 1 8N1, 2 8N2"
        format: |it| it as u16, |value| Some(match value {
            0 => Format::Even1,
            1 => Format::None1,
            _ => Format::None2,
        });
}

setting_rows! { CanConfig:
    178 "CAN_RATE" "kbit/s" (125, 1_000) "the rate of CAN: 125, 250, 500 or 1000"
        kbit_rate: |it| it, |value| matches!(value, 125 | 250 | 500 | 1_000).then_some(value);
    179 "CAN_ID" "" (0, 0x7FE)
        "the identifier that the gripper listens to; it sends on the next one. None of both may be one of CANopen's"
        gripper: |it| it.base(), |value| Identifiers::from_base(value).filter(|it| !collides_with_canopen(*it));
    180 "CAN_NODE" "" (1, 127) "the bridge's node-ID; not CAN_MASTER's"
        node.node: |it| it as u16, |value| Some(value as u8);
    181 "CAN_MASTER" "" (1, 127) "the node-ID of the CANopen master, whose heartbeat is watched"
        node.master: |it| it as u16, |value| Some(value as u8);
    together 180: |it| it.node.is_valid();
}

setting_rows! { ProfibusConfig:
    182 "PROFIBUS_ADDRESS" "" (0, 125) "the bridge's address on PROFIBUS"
        address: |it| it as u16, |value| Some(value as u8);
    183 "PROFIBUS_RATE" "100 bit/s" (0, 15_000)
        "the rate of PROFIBUS: 96, 192, 454 (45.45 kbit/s), 937 (93.75 kbit/s), 1875, 5000 or 15000; 0: that of the bus, which is searched"
        rate: |it| ProfibusConfig::rate_setting(it), |value| ProfibusConfig::rate_of(value);
}

const RECIPE_LEN: usize = 4;

/// The register of the first recipe's first value.
const FIRST_RECIPE: u16 = 109;

/// The rows of the recipes, by their numbers.
macro_rules! recipe_rows {
    ($first:literal $($number:literal)*) => {[
        recipe_rows!(@ $first
            "where GRIP and MOVE go" "of every motion" "force limit of GRIP" "where RELEASE goes"),
        $(recipe_rows!(@ $number "as for recipe 0" "" "" "")),*
    ]};
    (@ $number:literal $width:literal $speed:literal $force:literal $release:literal) => {[
        recipe_row($number, 0, concat!("RECIPE", $number, "_WIDTH"), "1/100 mm", WIDTH, $width),
        recipe_row($number, 1, concat!("RECIPE", $number, "_SPEED"), "1/100 mm/s", SPEED, $speed),
        recipe_row($number, 2, concat!("RECIPE", $number, "_FORCE"), "1/100 N", FORCE, $force),
        recipe_row($number, 3, concat!("RECIPE", $number, "_RELEASE"), "1/100 mm", WIDTH, $release),
    ]};
}

const WIDTH: (u16, u16) = (0, i16::MAX as u16);
const SPEED: (u16, u16) = (1, u16::MAX);
const FORCE: (u16, u16) = (1, i16::MAX as u16);

const fn recipe_row(
    number: u16,
    field: u16,
    name: &'static str,
    unit: &'static str,
    (least, most): (u16, u16),
    meaning: &'static str,
) -> (u16, Setting) {
    (FIRST_RECIPE + number * RECIPE_LEN as u16 + field, Setting { name, unit, least, most, meaning })
}

const RECIPE_ROWS: [[(u16, Setting); RECIPE_LEN]; RECIPE_COUNT] =
    recipe_rows!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);

const PARTS: [Rows<Setting>; 5] = [
    Config::SETTINGS,
    RECIPE_ROWS.as_flattened(),
    BusConfig::SETTINGS,
    CanConfig::SETTINGS,
    ProfibusConfig::SETTINGS,
];

/// The settings, from [`FIRST_SETTING`] on.
pub const SETTINGS: [Setting; count(&PARTS)] = assembled(FIRST_SETTING, &PARTS);

/// The values of all settings, in the order of [`SETTINGS`].
pub type Record = [u16; SETTINGS.len()];

/// Those of [`SETTINGS`] from here on count from a start of the bridge on, and not while it runs.
pub const FIRST_START_SETTING: usize = place_of("PLC_BUS");

/// Returns the place of a setting among [`SETTINGS`]. At compile time, where a name that none has does not compile.
const fn place_of(name: &str) -> usize {
    let mut place = 0;
    #[expect(clippy::indexing_slicing, reason = "at compile time, where a wrong index does not compile")]
    while !is_same(SETTINGS[place].name.as_bytes(), name.as_bytes()) {
        place += 1;
    }
    place
}

const fn is_same(one: &[u8], other: &[u8]) -> bool {
    match (one, other) {
        ([], []) => true,
        ([a, one @ ..], [b, other @ ..]) => *a == *b && is_same(one, other),
        _ => false,
    }
}

/// Settings of a record that no bridge can have: one of them has a value that it does not take, be it only beside another's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongSetting {
    /// Its place in the record.
    pub at: usize,
}

impl WrongSetting {
    const fn of(register: u16) -> Self {
        Self { at: register.saturating_sub(FIRST_SETTING) as usize }
    }
}

impl core::fmt::Display for WrongSetting {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match SETTINGS.get(self.at) {
            Some(Setting { name, least, most, meaning, .. }) => {
                write!(f, "{name} takes {least} to {most}: {meaning}")
            }
            None => f.write_str("there is no such setting"),
        }
    }
}

impl core::error::Error for WrongSetting {}

/// The ranges alone, so that the words of the table stay out of the image.
pub(super) const RANGES: [(u16, u16); SETTINGS.len()] = {
    let mut ranges = [(0, 0); SETTINGS.len()];
    let mut at = 0;
    while at < ranges.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            ranges[at] = (SETTINGS[at].least, SETTINGS[at].most);
        }
        at += 1;
    }
    ranges
};

/// The values of [`SETTINGS`]: always inside their ranges, and such as go together.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Settings {
    values: Record,
    /// Those that count from the next start on.
    stored: Record,
    /// What shall be done with them at the end of the turn.
    asked: Option<StoreCommand>,
}

impl Settings {
    /// Where BUS_TIMEOUT stands, counted from [`FIRST_SETTING`].
    pub(crate) const TIMEOUT: u16 = place_of("BUS_TIMEOUT") as u16;

    /// What the configuration says, each value brought into its range.
    pub(crate) const fn new(config: &Config) -> Self {
        let values = config.record();
        Self { values, stored: values, asked: None }
    }

    /// Whether a bridge can have these values.
    pub(crate) fn check_record(values: &Record) -> Result<(), WrongSetting> {
        let is_wrong = |(value, (least, most)): (&u16, &(u16, u16))| !(least..=most).contains(&value);
        if let Some(at) = values.iter().zip(&RANGES).position(is_wrong) {
            return Err(WrongSetting { at });
        }
        CanConfig::check(values).and_then(|()| ProfibusConfig::check(values)).map_err(WrongSetting::of)
    }

    /// All values, in the order of [`SETTINGS`].
    pub(crate) const fn record(&self) -> &Record {
        &self.values
    }

    /// The register at this address, counted from [`FIRST_SETTING`].
    pub(crate) fn register(&self, index: u16) -> Result<u16, RegisterError> {
        self.values.get(usize::from(index)).copied().ok_or(RegisterError::Missing)
    }

    /// Returns the values with these written to the registers from `first` on; fails when one does not exist or does not take its
    /// value.
    pub(crate) fn with(
        &self,
        first: u16,
        values: impl Iterator<Item = u16>,
    ) -> Result<Record, RegisterError> {
        let mut record = self.values;
        let mut places = record.get_mut(usize::from(first)..).unwrap_or_default().iter_mut();
        for value in values {
            *places.next().ok_or(RegisterError::Missing)? = value;
        }
        Self::check_record(&record).map_err(|_| RegisterError::Value)?;
        Ok(record)
    }

    /// Takes these values; they are not stored.
    pub(crate) const fn take(&mut self, values: &Record) {
        self.values = *values;
    }

    /// Takes the stored values.
    pub(crate) const fn restore(&mut self) {
        self.values = self.stored;
    }

    /// They are stored as they are.
    pub(crate) const fn are_stored(&mut self) {
        self.stored = self.values;
    }

    pub(crate) fn are_changed(&self) -> bool {
        self.values != self.stored
    }

    /// Has them stored, or the delivered ones taken and stored, at the end of the turn.
    pub(crate) const fn ask(&mut self, command: StoreCommand) {
        self.asked = Some(command);
    }

    pub(crate) const fn is_asked(&self) -> bool {
        self.asked.is_some()
    }

    pub(crate) const fn take_asked(&mut self) -> Option<StoreCommand> {
        self.asked.take()
    }

    pub(crate) fn timeout_ms(&self) -> u32 {
        self.values[const { place_of("BUS_TIMEOUT") }].into()
    }

    pub(crate) fn debounce_ms(&self) -> u32 {
        self.values[const { place_of("DEBOUNCE") }].into()
    }

    pub(crate) fn min_busy_ms(&self) -> u32 {
        self.values[const { place_of("MIN_BUSY") }].into()
    }

    pub(crate) fn half_frame_ms(&self) -> u32 {
        self.values[const { place_of("HALF_FRAME") }].into()
    }

    pub(crate) fn recipe(&self, number: usize) -> Option<Recipe> {
        recipe_of(&self.values, number)
    }

    /// The recipe that the bus's commands take, if they take one.
    pub(crate) fn bus_recipe(&self) -> Option<Recipe> {
        self.recipe(self.values[const { place_of("BUS_RECIPE") }].into())
    }

    /// What can be set about the PLC's bus.
    pub(crate) fn bus(&self) -> BusConfig {
        let mut bus = BusConfig::DEFAULT;
        // Values that no bus can have are not among them.
        let _ = bus.take(&self.values);
        bus
    }
}

/// The place of the recipes' first value.
const RECIPES_AT: usize = (FIRST_RECIPE - FIRST_SETTING) as usize;

/// A recipe of a record, by its number.
fn recipe_of(values: &Record, number: usize) -> Option<Recipe> {
    let recipes = values.get(RECIPES_AT..RECIPES_AT + RECIPE_COUNT * RECIPE_LEN)?;
    recipes.as_chunks::<RECIPE_LEN>().0.get(number).copied().map(Recipe::from_registers)
}

impl Config {
    /// Returns the settings of this configuration as a record, each value brought into its range.
    ///
    /// ```
    /// use wsg_bridge_fw::Config;
    ///
    /// let record = Config::DEFAULT.record();
    /// assert_eq!(record[..3], [1, 1_000, 1], "unit 1, and a stop after a second of silence");
    /// ```
    #[must_use]
    pub const fn record(&self) -> Record {
        let mut record = [0; SETTINGS.len()];
        self.put(&mut record);
        self.bus.put(&mut record);
        self.can.put(&mut record);
        self.profibus.put(&mut record);
        #[expect(clippy::indexing_slicing, reason = "every place is in the table")]
        {
            let mut at = 0;
            while at < RECIPE_COUNT * RECIPE_LEN {
                record[RECIPES_AT + at] = self.recipes[at / RECIPE_LEN].registers()[at % RECIPE_LEN];
                at += 1;
            }
            let mut at = 0;
            while at < RANGES.len() {
                let (least, most) = RANGES[at];
                record[at] = if record[at] < least { least } else { record[at] };
                record[at] = if record[at] > most { most } else { record[at] };
                at += 1;
            }
        }
        record
    }

    /// Returns the configuration that this record makes. What no setting is for is [`DEFAULT`](Self::DEFAULT)'s.
    ///
    /// # Errors
    /// [`WrongSetting`]: the first whose value is out of its range or does not go with the others.
    pub fn from_record(record: &Record) -> Result<Self, WrongSetting> {
        Settings::check_record(record)?;
        // In its place from the start on: copies of it would be on the stack.
        let mut config = Self::DEFAULT;
        config.take_parts(record).map_err(WrongSetting::of)?;
        for (number, recipe) in config.recipes.iter_mut().enumerate() {
            *recipe = recipe_of(record, number).unwrap_or(*recipe);
        }
        Ok(config)
    }

    fn take_parts(&mut self, record: &Record) -> Result<(), u16> {
        self.take(record)?;
        self.bus.take(record)?;
        self.can.take(record)?;
        self.profibus.take(record)
    }
}

const fn saturate(value: u32) -> u16 {
    if value > u16::MAX as u32 { u16::MAX } else { value as u16 }
}

#[cfg(test)]
mod record_tests;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RECIPES;
    use std::string::ToString;

    impl Settings {
        fn write(&mut self, first: u16, values: &[u16]) -> Result<(), RegisterError> {
            self.take(&self.with(first, values.iter().copied())?);
            Ok(())
        }
    }

    #[test]
    fn settings_begin_as_the_configuration_says() {
        let settings = Settings::new(&Config::DEFAULT);
        for (number, recipe) in RECIPES.iter().enumerate() {
            assert_eq!(settings.recipe(number), Some(*recipe));
        }
        assert_eq!(settings.recipe(RECIPE_COUNT), None);
        assert_eq!(settings.bus_recipe(), None);
        assert_eq!(settings.bus().reaction, SilenceReaction::Stop);
        assert_eq!((settings.debounce_ms(), settings.min_busy_ms(), settings.half_frame_ms()), (2, 50, 20));
        assert_eq!(settings.bus().unit, 1);
        assert_eq!(settings.register(SETTINGS.len() as u16), Err(RegisterError::Missing));
    }

    #[test]
    fn what_the_configuration_has_out_of_range_becomes_the_nearest() {
        let config =
            Config { debounce_ms: 0x1_0005, half_frame_ms: 0, min_busy_ms: u32::MAX, ..Config::DEFAULT };
        let settings = Settings::new(&config);
        assert_eq!(
            (settings.debounce_ms(), settings.half_frame_ms(), settings.min_busy_ms()),
            (1_000, 1, 10_000)
        );
    }

    #[test]
    fn every_setting_takes_its_range_and_nothing_else() {
        for (index, setting) in SETTINGS.iter().enumerate() {
            let mut settings = Settings::new(&Config::DEFAULT);
            // What these take depends on each other and on CANopen.
            let is_free = !matches!(setting.name, "CAN_ID" | "CAN_NODE" | "CAN_MASTER");
            for value in [setting.least, setting.most].into_iter().filter(|_| is_free) {
                settings.write(index as u16, &[value]).unwrap();
                assert_eq!(settings.register(index as u16), Ok(value), "{}", setting.name);
                assert!(Config::from_record(settings.record()).is_ok(), "a start takes it: {}", setting.name);
            }
            for value in [setting.least.checked_sub(1), setting.most.checked_add(1)].into_iter().flatten() {
                let refused = settings.write(index as u16, &[value]);
                assert_eq!(refused, Err(RegisterError::Value), "{}", setting.name);
            }
        }
    }

    #[test]
    fn values_that_do_not_go_together_are_refused_and_both_at_once_are_not() {
        let mut settings = Settings::new(&Config::DEFAULT);
        for (name, value) in [
            ("CAN_RATE", 300),
            ("CAN_ID", 0x100),
            ("CAN_NODE", 0x7F),
            ("CAN_MASTER", 0x10),
            ("PROFIBUS_RATE", 97),
        ] {
            let refused = settings.write(place_of(name) as u16, &[value]);
            assert_eq!(refused, Err(RegisterError::Value), "{value}");
        }
        assert_eq!(settings.write(place_of("CAN_NODE") as u16, &[0x7F, 0x10]), Ok(()));
        assert!(settings.are_changed());
        let record = *settings.record();
        assert_eq!(Settings::check_record(&record), Ok(()));
    }

    #[test]
    fn wrong_setting_is_named_with_what_it_takes() {
        let mut record = Config::DEFAULT.record();
        record[place_of("BUS_REACTION")] = 3;
        let wrong = Config::from_record(&record).unwrap_err();
        assert_eq!(wrong, WrongSetting { at: place_of("BUS_REACTION") });
        assert!(wrong.to_string().starts_with("BUS_REACTION takes 0 to 2: "), "{wrong}");
        assert_eq!(WrongSetting { at: SETTINGS.len() }.to_string(), "there is no such setting");
    }

    #[test]
    fn write_with_one_wrong_value_changes_nothing() {
        let mut settings = Settings::new(&Config::DEFAULT);
        let refused = settings.write(0, &[9; 3]);
        assert_eq!(refused, Err(RegisterError::Value), "there is no reaction 9");
        assert_eq!(settings.register(0), Ok(1));
        let past_the_end = settings.write(SETTINGS.len() as u16 - 1, &[9; 2]);
        assert_eq!(past_the_end, Err(RegisterError::Missing));
    }
}
