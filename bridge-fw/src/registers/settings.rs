//! The configuration as holding registers. It lives in RAM: power-up brings back what the image was delivered with.

use super::RegisterError;
use crate::config::{BusConfig, Config, RECIPE_COUNT, Recipe};
use wsg_protocol::fieldbus::SilenceReaction;

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
enum Place {
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
}

const RECIPE_LEN: usize = 4;

pub(super) const fn setting(
    name: &'static str,
    unit: &'static str,
    (least, most): (u16, u16),
    meaning: &'static str,
) -> Setting {
    Setting { name, unit, least, most, meaning }
}

/// The settings, from [`FIRST_SETTING`] on.
pub const SETTINGS: [Setting; Place::Recipes as usize + RECIPE_COUNT * RECIPE_LEN] = {
    const WIDTH: (u16, u16) = (0, i16::MAX as u16);
    const SPEED: (u16, u16) = (1, u16::MAX);
    const FORCE: (u16, u16) = (1, i16::MAX as u16);
    [
        setting("UNIT", "", (1, 247), "the bridge's address on the bus, from the next request on"),
        setting(
            "BUS_TIMEOUT",
            "ms",
            (0, u16::MAX),
            "how long a PLC that commanded may be silent; 0: for ever",
        ),
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
        setting("MIN_BUSY", "ms", (0, 10_000), "how long the wire BUSY is high at the least"),
        setting(
            "HALF_FRAME",
            "ms",
            (1, 1_000),
            "after how long without a byte half a frame of the gripper is given up",
        ),
        setting("RECIPE0_WIDTH", "1/100 mm", WIDTH, "where GRIP and MOVE go"),
        setting("RECIPE0_SPEED", "1/100 mm/s", SPEED, "of every motion"),
        setting("RECIPE0_FORCE", "1/100 N", FORCE, "force limit of GRIP"),
        setting("RECIPE0_RELEASE", "1/100 mm", WIDTH, "where RELEASE goes"),
        setting("RECIPE1_WIDTH", "1/100 mm", WIDTH, "as for recipe 0"),
        setting("RECIPE1_SPEED", "1/100 mm/s", SPEED, ""),
        setting("RECIPE1_FORCE", "1/100 N", FORCE, ""),
        setting("RECIPE1_RELEASE", "1/100 mm", WIDTH, ""),
        setting("RECIPE2_WIDTH", "1/100 mm", WIDTH, "as for recipe 0"),
        setting("RECIPE2_SPEED", "1/100 mm/s", SPEED, ""),
        setting("RECIPE2_FORCE", "1/100 N", FORCE, ""),
        setting("RECIPE2_RELEASE", "1/100 mm", WIDTH, ""),
        setting("RECIPE3_WIDTH", "1/100 mm", WIDTH, "as for recipe 0"),
        setting("RECIPE3_SPEED", "1/100 mm/s", SPEED, ""),
        setting("RECIPE3_FORCE", "1/100 N", FORCE, ""),
        setting("RECIPE3_RELEASE", "1/100 mm", WIDTH, ""),
    ]
};

/// The ranges alone, so that the words of the table stay out of the image.
const RANGES: [(u16, u16); SETTINGS.len()] = ranges(&SETTINGS);

/// The ranges of a table of settings.
pub(super) const fn ranges<const N: usize>(table: &[Setting; N]) -> [(u16, u16); N] {
    let mut ranges = [(0, 0); N];
    let mut at = 0;
    while at < N {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            ranges[at] = (table[at].least, table[at].most);
        }
        at += 1;
    }
    ranges
}

/// These values, each brought into its range.
pub(super) const fn into_ranges<const N: usize>(mut values: [u16; N], ranges: &[(u16, u16); N]) -> [u16; N] {
    let mut at = 0;
    while at < N {
        #[expect(clippy::indexing_slicing, reason = "both tables are of this length")]
        {
            let (least, most) = ranges[at];
            values[at] = if values[at] < least { least } else { values[at] };
            values[at] = if values[at] > most { most } else { values[at] };
        }
        at += 1;
    }
    values
}

/// The values of [`SETTINGS`]: always inside their ranges.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Settings {
    values: [u16; SETTINGS.len()],
}

impl Settings {
    /// Where BUS_TIMEOUT stands, counted from [`FIRST_SETTING`].
    pub(crate) const TIMEOUT: u16 = Place::Timeout as u16;

    /// What the configuration says, each value brought into its range.
    pub(crate) const fn new(config: &Config) -> Self {
        let bus = &config.bus;
        let [r0, r1, r2, r3] = &config.recipes;
        // In the order of `Place` and of the table.
        let values = [
            bus.unit as u16,
            bus.timeout_ms,
            code(bus.reaction),
            bus.character_timeout_ms,
            bus.broadcast as u16,
            bus.swap_bytes as u16,
            saturate(config.debounce_ms),
            saturate(config.min_busy_ms),
            saturate(config.half_frame_ms),
            r0.width.cast_unsigned(),
            r0.speed,
            r0.force.cast_unsigned(),
            r0.release_width.cast_unsigned(),
            r1.width.cast_unsigned(),
            r1.speed,
            r1.force.cast_unsigned(),
            r1.release_width.cast_unsigned(),
            r2.width.cast_unsigned(),
            r2.speed,
            r2.force.cast_unsigned(),
            r2.release_width.cast_unsigned(),
            r3.width.cast_unsigned(),
            r3.speed,
            r3.force.cast_unsigned(),
            r3.release_width.cast_unsigned(),
        ];
        Self { values: into_ranges(values, &RANGES) }
    }

    /// These values, if each is in its range; else the place of the first that is not.
    pub(super) fn from_values(values: [u16; SETTINGS.len()]) -> Result<Self, usize> {
        match values.iter().zip(RANGES).position(|(value, (least, most))| !(least..=most).contains(value)) {
            None => Ok(Self { values }),
            Some(at) => Err(at),
        }
    }

    /// All values, in the order of [`SETTINGS`].
    pub(super) const fn values(&self) -> &[u16; SETTINGS.len()] {
        &self.values
    }

    /// The register at this address, counted from [`FIRST_SETTING`].
    pub(crate) fn register(&self, index: u16) -> Result<u16, RegisterError> {
        self.values.get(usize::from(index)).copied().ok_or(RegisterError::Missing)
    }

    /// Whether registers from this one on exist and take these values.
    pub(crate) fn check(&self, first: u16, values: impl Iterator<Item = u16>) -> Result<(), RegisterError> {
        let mut ranges = RANGES.get(usize::from(first)..).unwrap_or_default().iter();
        let mut fits = true;
        for value in values {
            let (least, most) = *ranges.next().ok_or(RegisterError::Missing)?;
            fits &= (least..=most).contains(&value);
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

    const fn value(&self, place: Place) -> u16 {
        #[expect(clippy::indexing_slicing, reason = "every place is in the table")]
        self.values[place as usize]
    }

    /// The configuration that has these settings, and everything else from `rest`.
    pub(super) fn config(&self, rest: Config) -> Config {
        let bus = BusConfig {
            unit: self.unit(),
            timeout_ms: self.value(Place::Timeout),
            reaction: self.reaction(),
            character_timeout_ms: self.character_timeout_ms(),
            broadcast: self.broadcast(),
            swap_bytes: self.swap_bytes(),
            ..rest.bus
        };
        let mut recipes = rest.recipes;
        for (number, recipe) in recipes.iter_mut().enumerate() {
            *recipe = self.recipe(number).unwrap_or(*recipe);
        }
        Config {
            debounce_ms: self.debounce_ms(),
            min_busy_ms: self.min_busy_ms(),
            half_frame_ms: self.half_frame_ms(),
            recipes,
            bus,
            ..rest
        }
    }

    pub(crate) const fn swap_bytes(&self) -> bool {
        self.value(Place::SwapBytes) != 0
    }

    pub(crate) fn timeout_ms(&self) -> u32 {
        self.value(Place::Timeout).into()
    }

    pub(crate) fn reaction(&self) -> SilenceReaction {
        match self.value(Place::Reaction) {
            0 => SilenceReaction::Hold,
            1 => SilenceReaction::Stop,
            _ => SilenceReaction::FastStop,
        }
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
        let recipes = self.values.get(Place::Recipes as usize..)?;
        let &[width, speed, force, release_width] = recipes.as_chunks::<RECIPE_LEN>().0.get(number)?;
        Some(Recipe {
            width: width.cast_signed(),
            speed,
            force: force.cast_signed(),
            release_width: release_width.cast_signed(),
        })
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

const fn code(reaction: SilenceReaction) -> u16 {
    match reaction {
        SilenceReaction::Hold => 0,
        SilenceReaction::Stop => 1,
        SilenceReaction::FastStop => 2,
    }
}

pub(super) const fn saturate(value: u32) -> u16 {
    if value > u16::MAX as u32 { u16::MAX } else { value as u16 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RECIPES;

    #[test]
    fn settings_begin_as_the_configuration_says() {
        let settings = Settings::new(&Config::DEFAULT);
        for (number, recipe) in RECIPES.iter().enumerate() {
            assert_eq!(settings.recipe(number), Some(*recipe));
        }
        assert_eq!(settings.recipe(RECIPE_COUNT), None);
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
            for value in [setting.least, setting.most] {
                assert_eq!(settings.write(index as u16, [value].into_iter()), Ok(()));
                assert_eq!(settings.register(index as u16), Ok(value), "{}", setting.name);
            }
            for value in [setting.least.checked_sub(1), setting.most.checked_add(1)].into_iter().flatten() {
                let refused = settings.write(index as u16, [value].into_iter());
                assert_eq!(refused, Err(RegisterError::Value), "{}", setting.name);
            }
        }
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
