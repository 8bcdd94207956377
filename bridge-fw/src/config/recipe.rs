//! Recipes: what motion commands mean in millimetres and newtons.

use wsg_fieldbus::{CommandFlags, ForceUnit, OutputImage};

/// Parameters of the motion commands, chosen by the wires RECIPE0 and RECIPE1, or by BUS_RECIPE for the bus's.
///
/// The units are those of the fieldbus registers, so no value has to be rounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Recipe {
    /// Opening width that GRIP and MOVE go to, in 1/100 mm.
    pub width: i16,
    /// Speed of every motion, in 1/100 mm/s.
    pub speed: u16,
    /// Force limit of GRIP, summed over both fingers, in 1/100 N.
    pub force: i16,
    /// Opening width that RELEASE goes to, in 1/100 mm.
    pub release_width: i16,
}

impl Recipe {
    /// As settings hold it.
    pub(crate) const fn registers(self) -> [u16; 4] {
        let Self { width, speed, force, release_width } = self;
        [width.cast_unsigned(), speed, force.cast_unsigned(), release_width.cast_unsigned()]
    }

    pub(crate) const fn from_registers([width, speed, force, release_width]: [u16; 4]) -> Self {
        Self {
            width: width.cast_signed(),
            speed,
            force: force.cast_signed(),
            release_width: release_width.cast_signed(),
        }
    }

    /// Puts the parameters of this command into an image. `unit`: of the gripper's force registers.
    pub(crate) const fn fill(self, image: &mut OutputImage, command: CommandFlags, unit: ForceUnit) {
        image.width = if command.contains(CommandFlags::RELEASE) { self.release_width } else { self.width };
        image.speed = self.speed;
        image.force_limit = match unit {
            ForceUnit::Hundredth => self.force,
            ForceUnit::Tenth => self.force / 10,
        };
    }
}

/// How many recipes there are. Two wires can choose from the first four.
pub const RECIPE_COUNT: usize = 16;

/// The recipes as delivered, inside the limits of a WSG 50-110 (5 to 420 mm/s, 5 to 80 N, stroke 110 mm).
pub const RECIPES: [Recipe; RECIPE_COUNT] = {
    // A 20 mm part, in all but these three.
    let mut recipes =
        [Recipe { width: 20_00, speed: 50_00, force: 40_00, release_width: 40_00 }; RECIPE_COUNT];
    // Wide open, quickly: for pre-positioning.
    recipes[1] = Recipe { width: 80_00, speed: 200_00, force: 40_00, release_width: 80_00 };
    // A small part, gently.
    recipes[2] = Recipe { width: 10_00, speed: 20_00, force: 10_00, release_width: 25_00 };
    // A 50 mm part, firmly.
    recipes[3] = Recipe { width: 50_00, speed: 100_00, force: 80_00, release_width: 70_00 };
    recipes
};
