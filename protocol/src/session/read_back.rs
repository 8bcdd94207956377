//! Read-back of settings (command set, 3.3): the query for each setting, and the values that confirm it.

use super::Known;
use crate::command::Command;
use crate::reply::Value;

/// Returns the query that reads this setting back.
pub(super) const fn query(setting: &Command<'static>) -> Option<Command<'static>> {
    Some(match setting {
        Command::SetAcceleration { .. } => Command::GetAcceleration,
        Command::SetForceLimit { .. } => Command::GetForceLimit,
        Command::SetSoftLimits { .. } => Command::GetSoftLimits,
        _ => return None,
    })
}

/// Returns whether the value confirms the setting. A gripper clamps acceleration and force to its limits: the force to
/// the nominal limit or, in overdrive mode, to the overdrive limit.
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

/// Clamps like `f32::clamp`, but does not panic if a gripper reports swapped limits.
// `max` and `min` would call functions of the C library.
const fn clamp(value: f32, least: f32, greatest: f32) -> f32 {
    let raised = if value < least { least } else { value };
    if raised > greatest { greatest } else { raised }
}

/// Compares with a tolerance, because a gripper may round a setting to its own steps.
fn is_near(read: f32, expected: f32) -> bool {
    (read - expected).abs() <= 0.05 + 0.001 * expected.abs()
}
