//! Recipes: what the command wires mean in millimetres and newtons.

/// Parameters of the motion commands, chosen by the wires RECIPE0 and RECIPE1.
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

/// How many recipes two wires can choose from.
pub const RECIPE_COUNT: usize = 4;

/// The recipes as delivered, inside the limits of a WSG 50-110 (5 to 420 mm/s, 5 to 80 N, stroke 110 mm).
pub const RECIPES: [Recipe; RECIPE_COUNT] = [
    // A 20 mm part.
    Recipe { width: 20_00, speed: 50_00, force: 40_00, release_width: 40_00 },
    // Wide open, quickly: for pre-positioning.
    Recipe { width: 80_00, speed: 200_00, force: 40_00, release_width: 80_00 },
    // A small part, gently.
    Recipe { width: 10_00, speed: 20_00, force: 10_00, release_width: 25_00 },
    // A 50 mm part, firmly.
    Recipe { width: 50_00, speed: 100_00, force: 80_00, release_width: 70_00 },
];
