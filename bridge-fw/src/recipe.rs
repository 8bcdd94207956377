//! Recipes: the parameters of motion commands, in millimetres and newtons.

use crate::register::{FIRST_SETTING, Rows, Setting};
use wsg_fieldbus::{CommandFlags, ForceUnit, OutputImage};

/// Parameters of motion commands, selected by the wires RECIPE0 and RECIPE1, or by BUS_RECIPE for bus commands.
///
/// The units are the units of the fieldbus registers, so no value is rounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Recipe {
    /// Target width of GRIP and MOVE, in 1/100 mm.
    pub width: i16,
    /// Speed of every motion, in 1/100 mm/s.
    pub speed: u16,
    /// Force limit of GRIP, summed over both fingers, in 1/100 N.
    pub force: i16,
    /// Target width of RELEASE, in 1/100 mm.
    pub release_width: i16,
}

impl Recipe {
    pub(crate) const SETTINGS: Rows<Setting> = RECIPE_ROWS.as_flattened();

    /// Returns the recipe with this number from a record.
    pub(crate) fn of(record: &[u16], number: usize) -> Option<Self> {
        let recipes = record.get(RECIPES_AT..RECIPES_AT + Self::SETTINGS.len())?;
        recipes.as_chunks::<RECIPE_LEN>().0.get(number).copied().map(Self::from_registers)
    }

    /// Writes all recipes to a record.
    #[expect(clippy::indexing_slicing, reason = "their rows are in the table")]
    pub(crate) const fn put_all<const LEN: usize>(recipes: &[Self; RECIPE_COUNT], record: &mut [u16; LEN]) {
        const { assert!(RECIPES_AT + Self::SETTINGS.len() <= LEN) }
        let mut at = 0;
        while at < Self::SETTINGS.len() {
            record[RECIPES_AT + at] = recipes[at / RECIPE_LEN].registers()[at % RECIPE_LEN];
            at += 1;
        }
    }

    const fn registers(self) -> [u16; 4] {
        let Self { width, speed, force, release_width } = self;
        [width.cast_unsigned(), speed, force.cast_unsigned(), release_width.cast_unsigned()]
    }

    const fn from_registers([width, speed, force, release_width]: [u16; 4]) -> Self {
        Self {
            width: width.cast_signed(),
            speed,
            force: force.cast_signed(),
            release_width: release_width.cast_signed(),
        }
    }

    /// Writes the parameters of this command to an image. `unit` is the unit of the gripper's force registers.
    pub(crate) const fn fill(self, image: &mut OutputImage, command: CommandFlags, unit: ForceUnit) {
        image.width = if command.contains(CommandFlags::RELEASE) { self.release_width } else { self.width };
        image.speed = self.speed;
        image.force_limit = match unit {
            ForceUnit::Hundredth => self.force,
            ForceUnit::Tenth => self.force / 10,
        };
    }
}

/// Number of recipes. The two recipe wires select one of the first four.
pub const RECIPE_COUNT: usize = 16;

/// Delivered recipes, within the limits of a WSG 50-110 (5 to 420 mm/s, 5 to 80 N, stroke 110 mm).
pub const RECIPES: [Recipe; RECIPE_COUNT] = {
    // A 20 mm part, in all recipes except these three.
    let mut recipes =
        [Recipe { width: 20_00, speed: 50_00, force: 40_00, release_width: 40_00 }; RECIPE_COUNT];
    // Pre-positioning: wide open, fast.
    recipes[1] = Recipe { width: 80_00, speed: 200_00, force: 40_00, release_width: 80_00 };
    // Small part, gentle grip.
    recipes[2] = Recipe { width: 10_00, speed: 20_00, force: 10_00, release_width: 25_00 };
    // 50 mm part, firm grip.
    recipes[3] = Recipe { width: 50_00, speed: 100_00, force: 80_00, release_width: 70_00 };
    recipes
};

const RECIPE_LEN: usize = 4;

/// Register of the first recipe's width.
const FIRST_RECIPE: u16 = 109;

/// Rows of the recipes, by number.
macro_rules! recipe_rows {
    ($first:literal $($number:literal)*) => {[
        recipe_rows!(@ $first
            "target width of GRIP and MOVE" "speed of every motion" "force limit of GRIP" "target width of RELEASE"),
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

/// Index of the first recipe's width among the settings.
const RECIPES_AT: usize = (FIRST_RECIPE - FIRST_SETTING) as usize;
