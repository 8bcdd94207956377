//! The settings of a bridge as holding registers: one table, for the PLC's bus, for flash and for `--set`.

use super::table::joined;
use super::{RegisterError, StoreCommand};
use crate::config::{
    CanConfig, Config, NodeConfig, PlcBus, ProfibusConfig, RECIPE_COUNT, Recipe, collides_with_canopen,
};
use wsg_fieldbus::SilenceReaction;
use wsg_protocol::can::Identifiers;

/// A holding register that holds a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Its name.
    pub name: &'static str,
    /// Its unit; empty for a number without one.
    pub unit: &'static str,
    /// The least value it takes.
    pub least: u16,
    /// The greatest value it takes.
    pub most: u16,
    /// What it is for.
    pub meaning: &'static str,
}

/// The address of the first of [`SETTINGS`].
pub const FIRST_SETTING: u16 = 100;

/// Where each setting stands among [`SETTINGS`].
#[derive(Clone, Copy)]
pub(super) enum Place {
    Unit,
    Timeout,
    Reaction,
    Patience,
    Broadcast,
    SwapBytes,
    Debounce,
    MinBusy,
    HalfFrame,
    /// The first of the registers of the recipes, [`RECIPE_LEN`] for each.
    Recipes,
    BusRecipe = Self::Recipes as isize + (RECIPE_COUNT * RECIPE_LEN) as isize,
    PlcBus,
    GripperLine,
    ModbusRate,
    ModbusFormat,
    CanRate,
    CanId,
    CanNode,
    CanMaster,
    ProfibusAddress,
    ProfibusRate,
}

const COUNT: usize = Place::ProfibusRate as usize + 1;

const RECIPE_LEN: usize = 4;

/// The value of BUS_RECIPE that stands for none.
const NO_RECIPE: u16 = RECIPE_COUNT as u16;

/// Those of [`SETTINGS`] from here on count from a start of the bridge on, and not while it runs.
pub const FIRST_START_SETTING: usize = Place::PlcBus as usize;

const fn setting(
    name: &'static str,
    unit: &'static str,
    (least, most): (u16, u16),
    meaning: &'static str,
) -> Setting {
    Setting { name, unit, least, most, meaning }
}

/// The names and meanings of the recipes' registers, by their numbers.
macro_rules! recipe_settings {
    ($first:literal $($number:literal)*) => {[
        recipe_settings!(@ $first
            "where GRIP and MOVE go" "of every motion" "force limit of GRIP" "where RELEASE goes"),
        $(recipe_settings!(@ $number "as for recipe 0" "" "" "")),*
    ]};
    (@ $number:literal $width:literal $speed:literal $force:literal $release:literal) => {[
        setting(concat!("RECIPE", $number, "_WIDTH"), "1/100 mm", WIDTH, $width),
        setting(concat!("RECIPE", $number, "_SPEED"), "1/100 mm/s", SPEED, $speed),
        setting(concat!("RECIPE", $number, "_FORCE"), "1/100 N", FORCE, $force),
        setting(concat!("RECIPE", $number, "_RELEASE"), "1/100 mm", WIDTH, $release),
    ]};
}

const WIDTH: (u16, u16) = (0, i16::MAX as u16);
const SPEED: (u16, u16) = (1, u16::MAX);
const FORCE: (u16, u16) = (1, i16::MAX as u16);

const RECIPE_SETTINGS: [[Setting; RECIPE_LEN]; RECIPE_COUNT] =
    recipe_settings!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);

/// What stands before the recipes.
const BEFORE_RECIPES: [Setting; Place::Recipes as usize] = [
    setting("UNIT", "", (1, 247), "the bridge's address on the bus, from the next request on"),
    setting("BUS_TIMEOUT", "ms", (0, u16::MAX), "how long a PLC that commanded may be silent; 0: for ever"),
    setting(
        "BUS_REACTION",
        "",
        (0, 2),
        "what is done then: 0 hold, 1 stop, 2 FAST STOP; a jog ends in any case",
    ),
    setting(
        "BUS_CHAR_TIMEOUT",
        "ms",
        (0, 1_000),
        "how long a pause inside a request may be; 0: T1.5, by the specification",
    ),
    setting("BROADCAST", "", (0, 1), "1: broadcast writes count"),
    setting("SWAP_BYTES", "", (0, 1), "1: the bytes of the numbers in registers 0 to 5 change places"),
    setting(
        "DEBOUNCE",
        "ms",
        (0, 1_000),
        "how long a wire must keep its level; a low FAST_STOP_OK counts at once, whatever is set here",
    ),
    setting(
        "MIN_BUSY",
        "ms",
        (0, 10_000),
        "how long the wire BUSY is high at the least; for the refusal of a command, at least 50 ms",
    ),
    setting(
        "HALF_FRAME",
        "ms",
        (1, 1_000),
        "after how long without a byte half a frame of the gripper is given up",
    ),
];

/// What stands behind them.
const BEHIND_RECIPES: [Setting; COUNT - Place::BusRecipe as usize] = [
    setting(
        "BUS_RECIPE",
        "",
        (0, NO_RECIPE),
        "0 to 15: commands of the bus take this recipe's values; 16: WIDTH, SPEED and FORCELIMIT that it writes",
    ),
    setting("PLC_BUS", "", (0, PlcBus::ALL.len() as u16 - 1), PlcBus::NUMBERS),
    setting("GRIPPER_LINE", "", (0, 1), "the gripper's line: 0 RS-232, 1 CAN"),
    setting("MODBUS_RATE", "100 bit/s", (12, 2_304), "the rate of Modbus RTU"),
    setting("MODBUS_FORMAT", "", (0, 2), "a character of Modbus RTU: 0 8E1, 1 8N1, 2 8N2"),
    setting("CAN_RATE", "kbit/s", (125, 1_000), "the rate of CAN: 125, 250, 500 or 1000"),
    setting(
        "CAN_ID",
        "",
        (0, 0x7FE),
        "the identifier that the gripper listens to; it sends on the next one. None of both may be one of CANopen's",
    ),
    setting("CAN_NODE", "", (1, 127), "the bridge's node-ID; not CAN_MASTER's"),
    setting("CAN_MASTER", "", (1, 127), "the node-ID of the CANopen master, whose heartbeat is watched"),
    setting("PROFIBUS_ADDRESS", "", (0, 125), "the bridge's address on PROFIBUS"),
    setting(
        "PROFIBUS_RATE",
        "100 bit/s",
        (0, 15_000),
        "the rate of PROFIBUS: 96, 192, 454 (45.45 kbit/s), 937 (93.75 kbit/s), 1875, 5000 or 15000; 0: that of the bus, which is searched",
    ),
];

/// The settings, from [`FIRST_SETTING`] on.
pub const SETTINGS: [Setting; COUNT] = joined(BEFORE_RECIPES, RECIPE_SETTINGS, BEHIND_RECIPES);

/// The values of all settings, in the order of [`SETTINGS`].
pub type Record = [u16; SETTINGS.len()];

/// Settings of a record that no bridge can have: one of them has a value that it does not take, be it only beside another's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongSetting {
    /// Its place in the record.
    pub at: usize,
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
    pub(crate) const TIMEOUT: u16 = Place::Timeout as u16;

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
        let wrong = wrong_together(|place| value_of(values, place));
        wrong.map_or(Ok(()), |place| Err(WrongSetting { at: place as usize }))
    }

    /// All values, in the order of [`SETTINGS`].
    pub(crate) const fn record(&self) -> &Record {
        &self.values
    }

    /// The register at this address, counted from [`FIRST_SETTING`].
    pub(crate) fn register(&self, index: u16) -> Result<u16, RegisterError> {
        self.values.get(usize::from(index)).copied().ok_or(RegisterError::Missing)
    }

    /// Whether registers from this one on exist and take these values.
    pub(crate) fn check(
        &self,
        first: u16,
        values: impl Iterator<Item = u16> + Clone,
    ) -> Result<(), RegisterError> {
        let first = usize::from(first);
        let mut ranges = RANGES.get(first..).unwrap_or_default().iter();
        let mut fits = true;
        let mut end = first;
        for value in values.clone() {
            let (least, most) = *ranges.next().ok_or(RegisterError::Missing)?;
            fits &= (least..=most).contains(&value);
            end = end.wrapping_add(1);
        }
        if end > FIRST_START_SETTING {
            let after = |place: Place| {
                let written = (place as usize).checked_sub(first).and_then(|n| values.clone().nth(n));
                written.unwrap_or(self.value(place))
            };
            fits &= wrong_together(after).is_none();
        }
        if fits { Ok(()) } else { Err(RegisterError::Value) }
    }

    /// Writes registers from this one on; all or, when one does not exist or does not take its value, none.
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

    pub(super) const fn value(&self, place: Place) -> u16 {
        value_of(&self.values, place)
    }

    pub(crate) const fn swap_bytes(&self) -> bool {
        self.value(Place::SwapBytes) != 0
    }

    pub(crate) fn timeout_ms(&self) -> u32 {
        self.value(Place::Timeout).into()
    }

    pub(crate) fn reaction(&self) -> SilenceReaction {
        reaction_of(self.value(Place::Reaction))
    }

    pub(crate) fn debounce_ms(&self) -> u32 {
        self.value(Place::Debounce).into()
    }

    pub(crate) fn min_busy_ms(&self) -> u32 {
        self.value(Place::MinBusy).into()
    }

    pub(crate) fn half_frame_ms(&self) -> u32 {
        self.value(Place::HalfFrame).into()
    }

    pub(crate) fn recipe(&self, number: usize) -> Option<Recipe> {
        recipe_of(&self.values, number)
    }

    /// The recipe that the bus's commands take, if they take one.
    pub(crate) fn bus_recipe(&self) -> Option<Recipe> {
        self.recipe(self.value(Place::BusRecipe).into())
    }

    pub(crate) const fn unit(&self) -> u8 {
        self.value(Place::Unit) as u8
    }

    pub(crate) const fn character_timeout_ms(&self) -> u16 {
        self.value(Place::Patience)
    }

    pub(crate) const fn broadcast(&self) -> bool {
        self.value(Place::Broadcast) != 0
    }
}

/// The value at this place of a record.
pub(super) const fn value_of(values: &Record, place: Place) -> u16 {
    #[expect(clippy::indexing_slicing, reason = "every place is in the table")]
    values[place as usize]
}

/// What BUS_REACTION means.
pub(super) const fn reaction_of(value: u16) -> SilenceReaction {
    match value {
        0 => SilenceReaction::Hold,
        1 => SilenceReaction::Stop,
        _ => SilenceReaction::FastStop,
    }
}

/// A recipe of a record, by its number.
pub(super) fn recipe_of(values: &Record, number: usize) -> Option<Recipe> {
    let recipes = values.get(Place::Recipes as usize..Place::BusRecipe as usize)?;
    recipes.as_chunks::<RECIPE_LEN>().0.get(number).copied().map(Recipe::from_registers)
}

/// The first setting whose value is in its range and yet wrong, by itself or beside others.
fn wrong_together(value: impl Fn(Place) -> u16) -> Option<Place> {
    if !matches!(value(Place::CanRate), 125 | 250 | 500 | 1_000) {
        return Some(Place::CanRate);
    }
    if Identifiers::from_base(value(Place::CanId)).is_none_or(collides_with_canopen) {
        return Some(Place::CanId);
    }
    if ProfibusConfig::rate_of(value(Place::ProfibusRate)).is_none() {
        return Some(Place::ProfibusRate);
    }
    let [node, master] = [Place::CanNode, Place::CanMaster].map(|place| value(place) as u8);
    let node = NodeConfig { node, master, ..CanConfig::DEFAULT.node };
    (!node.is_valid()).then_some(Place::CanNode)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RECIPES;
    use std::string::ToString;

    #[test]
    fn settings_begin_as_the_configuration_says() {
        let settings = Settings::new(&Config::DEFAULT);
        for (number, recipe) in RECIPES.iter().enumerate() {
            assert_eq!(settings.recipe(number), Some(*recipe));
        }
        assert_eq!(settings.recipe(RECIPE_COUNT), None);
        assert_eq!(settings.bus_recipe(), None);
        assert_eq!(settings.reaction(), SilenceReaction::Stop);
        assert_eq!((settings.debounce_ms(), settings.min_busy_ms(), settings.half_frame_ms()), (2, 50, 20));
        assert_eq!(settings.unit(), 1);
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
                assert_eq!(settings.write(index as u16, [value].into_iter()), Ok(()));
                assert_eq!(settings.register(index as u16), Ok(value), "{}", setting.name);
                assert!(Config::from_record(settings.record()).is_ok(), "a start takes it: {}", setting.name);
            }
            for value in [setting.least.checked_sub(1), setting.most.checked_add(1)].into_iter().flatten() {
                let refused = settings.write(index as u16, [value].into_iter());
                assert_eq!(refused, Err(RegisterError::Value), "{}", setting.name);
            }
        }
    }

    #[test]
    fn values_that_do_not_go_together_are_refused_and_both_at_once_are_not() {
        let mut settings = Settings::new(&Config::DEFAULT);
        for (place, value) in [
            (Place::CanRate, 300),
            (Place::CanId, 0x100),
            (Place::CanNode, 0x7F),
            (Place::CanMaster, 0x10),
            (Place::ProfibusRate, 97),
        ] {
            let refused = settings.write(place as u16, [value].into_iter());
            assert_eq!(refused, Err(RegisterError::Value), "{value}");
        }
        assert_eq!(settings.write(Place::CanNode as u16, [0x7F, 0x10].into_iter()), Ok(()));
        assert!(settings.are_changed());
        let record = *settings.record();
        assert_eq!(Settings::check_record(&record), Ok(()));
    }

    #[test]
    fn wrong_setting_is_named_with_what_it_takes() {
        let mut record = Config::DEFAULT.record();
        record[Place::Reaction as usize] = 3;
        let wrong = Config::from_record(&record).unwrap_err();
        assert_eq!(wrong, WrongSetting { at: Place::Reaction as usize });
        assert!(wrong.to_string().starts_with("BUS_REACTION takes 0 to 2: "), "{wrong}");
        assert_eq!(WrongSetting { at: SETTINGS.len() }.to_string(), "there is no such setting");
    }

    #[test]
    fn write_with_one_wrong_value_changes_nothing() {
        let mut settings = Settings::new(&Config::DEFAULT);
        let refused = settings.write(0, [9; 3].into_iter());
        assert_eq!(refused, Err(RegisterError::Value), "there is no reaction 9");
        assert_eq!(settings.register(0), Ok(1));
        let past_the_end = settings.write(SETTINGS.len() as u16 - 1, [9; 2].into_iter());
        assert_eq!(past_the_end, Err(RegisterError::Missing));
    }
}
