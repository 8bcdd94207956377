//! Read-back of settings (command set, 3.3): the query for each setting, and the values that confirm it.

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

/// Returns whether the value confirms the setting. A value that the gripper corrected to its limits does not.
pub(super) fn agrees(setting: &Command<'static>, value: &Value<'_>) -> bool {
    match (*setting, *value) {
        (Command::SetAcceleration { acceleration }, Value::GetAcceleration(read)) => {
            is_near(read, acceleration)
        }
        (Command::SetForceLimit { force }, Value::GetForceLimit(read)) => is_near(read, force),
        (Command::SetSoftLimits { limits }, Value::GetSoftLimits(read)) => {
            is_near(read.minus, limits.minus) && is_near(read.plus, limits.plus)
        }
        _ => false,
    }
}

/// Compares with a tolerance, because a gripper may round a setting to its own steps.
fn is_near(read: f32, expected: f32) -> bool {
    (read - expected).abs() <= 0.05 + 0.001 * expected.abs()
}
