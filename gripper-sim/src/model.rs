//! Differences between the models of the series in one table, with the source of each figure.
//!
//! Sources: `field` is reported by users and public drivers, `manual` is the command set manual, and `assumed` is our
//! own choice where no public figure was found. `docs/models.md` lists the same figures.

use wsg_protocol::{DeviceType, SystemLimits};

/// A gripper of the WSG series.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// WSG 50 with a stroke of 110 mm.
    #[default]
    Wsg50Stroke110,
    /// WSG 50 with a stroke of 210 mm.
    Wsg50Stroke210,
    /// WSG 32 with a stroke of 68 mm.
    Wsg32,
    /// WSG 25 with a stroke of 64 mm.
    Wsg25,
    /// WSG 70 with a stroke of 200 mm.
    Wsg70,
}

/// The parameters of one model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// The type byte of Get System Information (command set, 3.5.1).
    pub device: DeviceType,
    /// The answer to Get System Limits (command set, 3.5.4): mm, mm/s, mm/s², N summed over both fingers.
    pub limits: SystemLimits,
    /// The acceleration after power-up, in mm/s².
    pub default_acceleration: f32,
    /// The force limit after power-up, in N, summed over both fingers.
    pub default_force: f32,
    /// Speed of the homing sequence in mm/s; every model completes it within 4 s.
    pub homing_speed: f32,
}

impl Model {
    /// All models of the series.
    pub const ALL: &'static [Self] =
        &[Self::Wsg50Stroke110, Self::Wsg50Stroke210, Self::Wsg32, Self::Wsg25, Self::Wsg70];

    /// Returns the name used on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Wsg50Stroke110 => "wsg50-110",
            Self::Wsg50Stroke210 => "wsg50-210",
            Self::Wsg32 => "wsg32",
            Self::Wsg25 => "wsg25",
            Self::Wsg70 => "wsg70",
        }
    }

    /// Returns the parameters of this model.
    #[must_use]
    pub const fn parameters(self) -> &'static Parameters {
        match self {
            Self::Wsg50Stroke110 => &WSG50_110,
            Self::Wsg50Stroke210 => &WSG50_210,
            Self::Wsg32 => &WSG32,
            Self::Wsg25 => &WSG25,
            Self::Wsg70 => &WSG70,
        }
    }
}

impl core::fmt::Display for Model {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

const WSG50_110: Parameters = Parameters {
    device: DeviceType::Wsg50, // manual
    limits: SystemLimits {
        stroke: 110.0,             // field
        min_speed: 5.0,            // field
        max_speed: 420.0,          // field
        min_acceleration: 100.0,   // field
        max_acceleration: 5_000.0, // field
        min_force: 5.0,            // field
        nominal_force: 80.0,       // field
        overdrive_force: 120.0,    // assumed
    },
    default_acceleration: 1_000.0, // assumed
    default_force: 40.0,           // assumed: half of the nominal force
    homing_speed: 50.0,            // assumed; under 4 s from field
};

const WSG50_210: Parameters = Parameters {
    limits: SystemLimits {
        stroke: 210.0, // field; the rest as of the shorter one: assumed
        ..WSG50_110.limits
    },
    homing_speed: 100.0, // assumed
    ..WSG50_110
};

const WSG32: Parameters = Parameters {
    device: DeviceType::Wsg32, // manual
    limits: SystemLimits {
        stroke: 68.0,              // field
        min_speed: 5.0,            // assumed
        max_speed: 400.0,          // assumed
        min_acceleration: 100.0,   // assumed
        max_acceleration: 5_000.0, // assumed
        min_force: 5.0,            // assumed
        nominal_force: 50.0,       // assumed
        overdrive_force: 75.0,     // assumed
    },
    default_acceleration: 1_000.0, // assumed
    default_force: 25.0,           // assumed
    homing_speed: 50.0,            // assumed
};

const WSG25: Parameters = Parameters {
    device: DeviceType::Wsg25, // manual
    limits: SystemLimits {
        stroke: 64.0,              // assumed
        min_speed: 5.0,            // assumed
        max_speed: 300.0,          // assumed
        min_acceleration: 100.0,   // assumed
        max_acceleration: 5_000.0, // assumed
        min_force: 2.0,            // assumed
        nominal_force: 30.0,       // assumed
        overdrive_force: 45.0,     // assumed
    },
    default_acceleration: 1_000.0, // assumed
    default_force: 15.0,           // assumed
    homing_speed: 50.0,            // assumed
};

const WSG70: Parameters = Parameters {
    device: DeviceType::Wsg70, // manual
    limits: SystemLimits {
        stroke: 200.0,             // assumed
        min_speed: 5.0,            // assumed
        max_speed: 320.0,          // assumed
        min_acceleration: 100.0,   // assumed
        max_acceleration: 3_000.0, // assumed
        min_force: 20.0,           // assumed
        nominal_force: 400.0, // assumed: the fieldbus counts its force in 0.1 N, so 327.67 N is not enough
        overdrive_force: 600.0, // assumed
    },
    default_acceleration: 1_000.0, // assumed
    default_force: 200.0,          // assumed
    homing_speed: 100.0,           // assumed
};
