//! Checks requests against the physical limits of the gripper (command set, 3.5.4) before they are sent.
//!
//! A gripper corrects some values outside its limits and reports success: width and speed of Pre-position Fingers
//! (3.2.2), acceleration (3.3.1) and force limit (3.3.3). [`Command::check_limits`] finds all values that a gripper
//! could correct, and [`SystemLimits::check`] checks a single one. The drivers call them for every request.
//!
//! Soft limits (3.3.5) are not checked here. Another client can change them at any time, and the gripper refuses a target
//! outside of them with E_RANGE_ERROR.
//!
//! ```
//! use wsg_protocol::limits::Quantity;
//! use wsg_protocol::{Command, SystemFlags, SystemLimits};
//!
//! // The answer to Get System Limits, and the flags of Get System State.
//! let limits = SystemLimits {
//!     stroke: 110.0,
//!     min_speed: 5.0,
//!     max_speed: 420.0,
//!     min_acceleration: 100.0,
//!     max_acceleration: 5_000.0,
//!     min_force: 5.0,
//!     nominal_force: 80.0,
//!     overdrive_force: 120.0,
//! };
//! let flags = SystemFlags::REFERENCED;
//!
//! let grip = Command::GripPart { width: 20.0, speed: 50.0 };
//! assert_eq!(grip.check_limits(&limits, flags, None), Ok(()));
//!
//! let refused = Command::SetForceLimit { force: 500.0 }.check_limits(&limits, flags, None).unwrap_err();
//! assert_eq!(refused.to_string(), "force 500 N is outside the gripper's limits, 5 to 80 N");
//!
//! let refused = limits.check(Quantity::Speed, 1.5, flags).unwrap_err();
//! assert_eq!((refused.least(), refused.greatest()), (5.0, 420.0));
//! ```

use core::fmt::{Display, Formatter};
use core::ops::RangeInclusive;

use crate::Number;
use crate::command::Command;
use crate::types::{PrePositionFlags, SystemFlags, SystemLimits};

/// A quantity with limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
#[non_exhaustive]
pub enum Quantity {
    /// An opening width, in mm.
    Width,
    /// A change of the opening width, in mm.
    Offset,
    /// A finger speed, in mm/s.
    Speed,
    /// An acceleration, in mm/s².
    Acceleration,
    /// A force limit, in N, summed over both fingers.
    Force,
}

impl Quantity {
    /// Returns the unit, for example `mm/s`.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Width | Self::Offset => "mm",
            Self::Speed => "mm/s",
            Self::Acceleration => "mm/s²",
            Self::Force => "N",
        }
    }
}

impl Display for Quantity {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Width => "width",
            Self::Offset => "offset",
            Self::Speed => "speed",
            Self::Acceleration => "acceleration",
            Self::Force => "force",
        })
    }
}

/// A value outside the gripper's limits. Its text names value, unit and limits.
#[derive(Clone, Copy, Debug, crate::Format)]
pub struct OutOfLimits {
    quantity: Quantity,
    value: f32,
    least: f32,
    greatest: f32,
}

impl OutOfLimits {
    /// Returns the quantity that was checked.
    #[must_use]
    pub const fn quantity(&self) -> Quantity {
        self.quantity
    }

    /// Returns the refused value, in the [`unit`](Quantity::unit) of the quantity.
    #[must_use]
    pub const fn value(&self) -> f32 {
        self.value
    }

    /// Returns the least permitted value.
    #[must_use]
    pub const fn least(&self) -> f32 {
        self.least
    }

    /// Returns the greatest permitted value, or infinity if the gripper's limits are unknown.
    #[must_use]
    pub const fn greatest(&self) -> f32 {
        self.greatest
    }

    /// Returns `Ok` if the value is a number in `range`, widened by `tolerance` at both ends.
    fn check(quantity: Quantity, value: f32, range: RangeInclusive<f32>, tolerance: f32) -> Result<(), Self> {
        let (least, greatest) = range.into_inner();
        let is_inside = value.is_finite() && least - tolerance <= value && value <= greatest + tolerance;
        if is_inside { Ok(()) } else { Err(Self { quantity, value, least, greatest }) }
    }
}

/// Compares the bits, so that equality is total: the value may be NaN.
impl PartialEq for OutOfLimits {
    fn eq(&self, other: &Self) -> bool {
        let bits = |it: &Self| [it.value, it.least, it.greatest].map(f32::to_bits);
        (self.quantity, bits(self)) == (other.quantity, bits(other))
    }
}

impl Eq for OutOfLimits {}

impl Display for OutOfLimits {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        let Self { quantity, value, least, greatest } = *self;
        let (unit, value, least) = (quantity.unit(), Number(value), rounded(least));
        write!(f, "{quantity} {value} {unit} is outside the gripper's limits, ")?;
        if greatest.is_finite() {
            write!(f, "{least} to {} {unit}", rounded(greatest))
        } else {
            write!(f, "at least {least} {unit}")
        }
    }
}

impl core::error::Error for OutOfLimits {}

/// Rounds a limit to 1/100, for its text.
fn rounded(limit: f32) -> Number {
    let half = if limit < 0.0 { -0.5 } else { 0.5 };
    Number((limit * 100.0 + half) as i32 as f32 / 100.0)
}

/// Accuracy of a measured width, in mm: a relative motion back to an end of the stroke is permitted although the measured
/// width was not exact.
const WIDTH_ACCURACY: f32 = 0.1;

impl SystemLimits {
    /// The limits of a gripper that does not report them: only negative values are outside.
    ///
    /// ```
    /// use wsg_protocol::SystemLimits;
    ///
    /// // From the data sheet: up to 80 N, without overdrive mode.
    /// let limits = SystemLimits { nominal_force: 80.0, overdrive_force: 80.0, ..SystemLimits::UNKNOWN };
    /// # assert_eq!(limits.min_speed, 0.0);
    /// ```
    pub const UNKNOWN: Self = Self {
        stroke: f32::INFINITY,
        min_speed: 0.0,
        max_speed: f32::INFINITY,
        min_acceleration: 0.0,
        max_acceleration: f32::INFINITY,
        min_force: 0.0,
        nominal_force: f32::INFINITY,
        overdrive_force: f32::INFINITY,
    };

    /// Returns the permitted values of a quantity, from the least to the greatest one. The nominal force is the greatest
    /// force, or the overdrive force if `flags` contain [`OVERDRIVE_MODE`](SystemFlags::OVERDRIVE_MODE).
    #[must_use]
    pub const fn range(&self, quantity: Quantity, flags: SystemFlags) -> RangeInclusive<f32> {
        match quantity {
            Quantity::Width => 0.0..=self.stroke,
            Quantity::Offset => -self.stroke..=self.stroke,
            Quantity::Speed => self.min_speed..=self.max_speed,
            Quantity::Acceleration => self.min_acceleration..=self.max_acceleration,
            Quantity::Force => {
                let is_overdriven = flags.contains(SystemFlags::OVERDRIVE_MODE);
                // A gripper without overdrive may report 0.
                let is_greater = self.overdrive_force > self.nominal_force;
                let greatest =
                    if is_overdriven && is_greater { self.overdrive_force } else { self.nominal_force };
                self.min_force..=greatest
            }
        }
    }

    /// Checks a value against the limits of its quantity.
    ///
    /// # Errors
    /// Returns [`OutOfLimits`] if the value is outside the [`range`](Self::range), infinite or NaN.
    pub fn check(&self, quantity: Quantity, value: f32, flags: SystemFlags) -> Result<(), OutOfLimits> {
        OutOfLimits::check(quantity, value, self.range(quantity, flags), 0.0)
    }
}

impl Command<'_> {
    /// Checks all parameters against the gripper's limits. `flags` are the latest system state flags, and `width` is the
    /// latest opening width in mm, which only a relative motion requires: its target must be inside the stroke. Without
    /// a width, its offset must be smaller than the stroke.
    ///
    /// Soft limits must be inside the stroke, the lower one first. A command without limited parameters is always
    /// accepted, and so is an unknown one.
    ///
    /// # Errors
    /// Returns [`OutOfLimits`] for the first parameter outside its limits.
    pub fn check_limits(
        &self,
        limits: &SystemLimits,
        flags: SystemFlags,
        width: Option<f32>,
    ) -> Result<(), OutOfLimits> {
        let check = |quantity, value| limits.check(quantity, value, flags);
        match *self {
            Self::PrePosition { flags: motion, width: offset, speed }
                if motion.contains(PrePositionFlags::RELATIVE) =>
            {
                let (range, tolerance) = match width {
                    Some(width) => (-width..=limits.stroke - width, WIDTH_ACCURACY),
                    None => (limits.range(Quantity::Offset, flags), 0.0),
                };
                OutOfLimits::check(Quantity::Offset, offset, range, tolerance)?;
                check(Quantity::Speed, speed)
            }
            Self::PrePosition { width, speed, .. }
            | Self::GripPart { width, speed }
            | Self::ReleasePart { width, speed } => {
                check(Quantity::Width, width)?;
                check(Quantity::Speed, speed)
            }
            Self::SetAcceleration { acceleration } => check(Quantity::Acceleration, acceleration),
            Self::SetForceLimit { force } => check(Quantity::Force, force),
            Self::SetSoftLimits { limits: soft } => {
                check(Quantity::Width, soft.minus)?;
                OutOfLimits::check(Quantity::Width, soft.plus, soft.minus..=limits.stroke, 0.0)
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::SoftLimits;
    use std::string::ToString;

    const LIMITS: SystemLimits = SystemLimits {
        stroke: 110.0,
        min_speed: 5.0,
        max_speed: 420.0,
        min_acceleration: 100.0,
        max_acceleration: 5_000.0,
        min_force: 5.0,
        nominal_force: 80.0,
        overdrive_force: 120.0,
    };
    const OVERDRIVE: SystemFlags = SystemFlags::OVERDRIVE_MODE;
    const NONE: SystemFlags = SystemFlags::empty();

    const fn go(width: f32, speed: f32) -> Command<'static> {
        Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed }
    }

    const fn go_by(width: f32, speed: f32) -> Command<'static> {
        Command::PrePosition { flags: PrePositionFlags::RELATIVE, width, speed }
    }

    const fn soft(minus: f32, plus: f32) -> Command<'static> {
        Command::SetSoftLimits { limits: SoftLimits { minus, plus } }
    }

    #[test]
    fn parameter_is_permitted_up_to_its_limit_and_refused_beyond() {
        use Quantity::{Acceleration, Force, Offset, Speed, Width};
        let force = |force| Command::SetForceLimit { force };
        let acceleration = |acceleration| Command::SetAcceleration { acceleration };
        let grip = |width, speed| Command::GripPart { width, speed };
        let release = |width, speed| Command::ReleasePart { width, speed };
        for (command, flags, refused) in [
            (go(0.0, 5.0), NONE, None),
            (go(110.0, 420.0), NONE, None),
            (go(-0.01, 50.0), NONE, Some((Width, -0.01))),
            (go(110.1, 50.0), NONE, Some((Width, 110.1))),
            (go(50.0, 4.9), NONE, Some((Speed, 4.9))),
            (go(50.0, 0.0), NONE, Some((Speed, 0.0))),
            (go(50.0, f32::INFINITY), NONE, Some((Speed, f32::INFINITY))),
            (grip(110.0, 420.0), NONE, None),
            (grip(-1.0, 50.0), NONE, Some((Width, -1.0))),
            (grip(20.0, 421.0), NONE, Some((Speed, 421.0))),
            (release(0.0, 5.0), NONE, None),
            (release(111.0, 50.0), NONE, Some((Width, 111.0))),
            (release(20.0, -50.0), NONE, Some((Speed, -50.0))),
            (go_by(110.0, 50.0), NONE, None),
            (go_by(-110.1, 50.0), NONE, Some((Offset, -110.1))),
            (go_by(5.0, 500.0), NONE, Some((Speed, 500.0))),
            (force(5.0), NONE, None),
            (force(80.0), NONE, None),
            (force(-1.0), NONE, Some((Force, -1.0))),
            (force(4.9), OVERDRIVE, Some((Force, 4.9))),
            (force(80.1), NONE, Some((Force, 80.1))),
            (force(120.0), OVERDRIVE, None),
            (force(120.1), OVERDRIVE, Some((Force, 120.1))),
            (force(f32::NAN), NONE, Some((Force, f32::NAN))),
            (acceleration(100.0), NONE, None),
            (acceleration(5_000.0), NONE, None),
            (acceleration(99.0), NONE, Some((Acceleration, 99.0))),
            (acceleration(99_999.0), NONE, Some((Acceleration, 99_999.0))),
            (soft(0.0, 110.0), NONE, None),
            (soft(-5.0, 90.0), NONE, Some((Width, -5.0))),
            (soft(20.0, 111.0), NONE, Some((Width, 111.0))),
            (soft(90.0, 20.0), NONE, Some((Width, 20.0))),
            (Command::OverdriveMode { enabled: true }, NONE, None),
            (Command::Unknown { id: 0xB0, payload: &[1] }, NONE, None),
        ] {
            let checked = command.check_limits(&LIMITS, flags, None);
            let found = checked.err().map(|refused| (refused.quantity(), refused.value().to_bits()));
            let expected = refused.map(|(quantity, value): (Quantity, f32)| (quantity, value.to_bits()));
            assert_eq!(found, expected, "{command} {flags}");
        }
    }

    #[test]
    fn offset_must_end_in_the_stroke_within_measurement_accuracy() {
        for (width, offset, is_permitted) in [
            (20.0, -20.0, true),
            (19.95, -20.0, true),
            (20.0, -21.0, false),
            (100.03, 10.0, true),
            (100.0, 10.5, false),
        ] {
            let checked = go_by(offset, 50.0).check_limits(&LIMITS, NONE, Some(width));
            assert_eq!(checked.is_ok(), is_permitted, "from {width} by {offset}");
        }
    }

    #[test]
    fn gripper_without_overdrive_keeps_its_nominal_force() {
        let limits = SystemLimits { overdrive_force: 0.0, ..LIMITS };
        assert_eq!(limits.range(Quantity::Force, OVERDRIVE), 5.0..=80.0);
    }

    #[test]
    fn text_names_value_unit_and_limits() {
        let unknown = SystemLimits { stroke: f32::INFINITY, ..LIMITS };
        for (command, limits, width, text) in [
            (go(-1.0, 100.0), LIMITS, None, "width -1 mm is outside the gripper's limits, 0 to 110 mm"),
            (
                go_by(20.5, 50.0),
                LIMITS,
                Some(100.016),
                "offset 20.5 mm is outside the gripper's limits, -100.02 to 9.98 mm",
            ),
            (go(50.0, 0.1), LIMITS, None, "speed 0.1 mm/s is outside the gripper's limits, 5 to 420 mm/s"),
            (
                Command::SetAcceleration { acceleration: 99_999.0 },
                LIMITS,
                None,
                "acceleration 99999 mm/s² is outside the gripper's limits, 100 to 5000 mm/s²",
            ),
            (go(-1.0, 100.0), unknown, None, "width -1 mm is outside the gripper's limits, at least 0 mm"),
        ] {
            let refused = command.check_limits(&limits, NONE, width).unwrap_err();
            assert_eq!(refused.to_string(), text);
        }
    }

    #[test]
    fn refusals_are_equal_if_all_their_numbers_are() {
        let refused = |force| LIMITS.check(Quantity::Force, force, NONE).unwrap_err();
        assert_eq!(refused(f32::NAN), refused(f32::NAN));
        assert_ne!(refused(500.0), refused(501.0));
        assert_ne!(refused(500.0), LIMITS.check(Quantity::Speed, 500.0, NONE).unwrap_err());
        assert_ne!(refused(500.0), LIMITS.check(Quantity::Force, 500.0, OVERDRIVE).unwrap_err());
    }
}
