//! Settings that are read back (command set, 3.3): which query shows what a setting came to, and what it may show.

use super::Known;
use crate::command::Command;
use crate::reply::Value;

/// The query that shows what this setting came to.
pub(super) const fn query(setting: &Command<'static>) -> Option<Command<'static>> {
    Some(match setting {
        Command::SetAcceleration { .. } => Command::GetAcceleration,
        Command::SetForceLimit { .. } => Command::GetForceLimit,
        Command::SetSoftLimits { .. } => Command::GetSoftLimits,
        _ => return None,
    })
}

/// Whether the value is what the gripper makes of the setting: it clamps acceleration and force to its limits, the force
/// to the nominal one or, in overdrive mode, to the overdrive limit.
pub(super) fn agrees(setting: &Command<'static>, value: &Value<'_>, known: &Known) -> bool {
    match (*setting, *value) {
        (Command::SetAcceleration { acceleration }, Value::GetAcceleration(read)) => {
            let clamped = known.limits.map_or(acceleration, |limits| {
                clamp(acceleration, limits.min_acceleration, limits.max_acceleration)
            });
            is_near(read, clamped)
        }
        (Command::SetForceLimit { force }, Value::GetForceLimit(read)) => match known.limits {
            None => is_near(read, force),
            Some(limits) => [limits.nominal_force, limits.overdrive_force]
                .into_iter()
                .any(|greatest| is_near(read, clamp(force, limits.min_force, greatest))),
        },
        (Command::SetSoftLimits { limits }, Value::GetSoftLimits(read)) => {
            is_near(read.minus, limits.minus) && is_near(read.plus, limits.plus)
        }
        _ => false,
    }
}

/// As `f32::clamp`, but without its panic when a gripper's limits are the wrong way round.
const fn clamp(value: f32, least: f32, greatest: f32) -> f32 {
    value.max(least).min(greatest)
}

/// A gripper may keep a setting in steps of its own.
fn is_near(read: f32, expected: f32) -> bool {
    (read - expected).abs() <= 0.05 + 0.001 * expected.abs()
}
