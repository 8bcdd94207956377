//! The words of the settings: what each one stands for.

use crate::axis::{Direction, Part};
use crate::config::{Config, Tag};
use crate::finger::Finger;
use crate::model::Model;
use std::str::FromStr;
use wsg_protocol::editor::number;
use wsg_protocol::limits::Quantity;
use wsg_protocol::{SoftLimits, SystemFlags};

/// Sets a setting of the gripper to these words, none for a switch that is on. Returns `None` for words that it does not accept,
/// and for a setting of a line or a program.
pub(crate) fn set(config: &mut Config, name: &str, words: &[String]) -> Option<()> {
    let word = words.first().map_or("", String::as_str);
    let find = |finger: &Finger| finger.name() == word;
    match name {
        "model" => config.model = *Model::ALL.iter().find(|model| model.name() == word)?,
        "no-overdrive" => config.overdrive = false,
        "serial-number" => config.serial_number = parsed(word)?,
        "tag" => config.tag = Tag::new(word).ok()?,
        "homing-default" => {
            config.homing_default = match word {
                "out" => Direction::Plus,
                "in" => Direction::Minus,
                _ => return None,
            }
        }
        "homing-at-start" => config.homing_at_start = true,
        "soft-limits" => config.soft_limits = Some(soft_limits(word)?),
        "part" => config.part = part(word)?,
        "time-scale" => config.time_scale = time_scale(word)?,
        "no-checksum-check" => config.check_checksum = false,
        "answer-bad-checksum" => config.answer_bad_checksum = true,
        "no-disconnect-error" => config.disconnect_error = false,
        "finger1" => config.fingers[0] = *Finger::ALL.iter().find(|finger| find(finger))?,
        "finger2" => config.fingers[1] = *Finger::ALL.iter().find(|finger| find(finger))?,
        "clamping-travel" => config.clamping_travel = length(word)?,
        "part-width-tolerance" => config.part_width_tolerance = length(word)?,
        "force" => config.force_limit = Some(positive(word)?),
        "acceleration" => config.acceleration = Some(positive(word)?),
        "homing-speed" => config.homing_speed = Some(positive(word)?),
        "speed" => config.speed = positive(word)?,
        "release-distance" => config.release_distance = length(word)?,
        "release-speed" => config.release_speed = Some(positive(word)?),
        "updates-idle" => config.updates_idle_s = parsed(word)?,
        _ => return None,
    }
    Some(())
}

/// Returns whether [`set`] knows a setting: it accepts one of these words.
pub(crate) fn is_of_gripper(name: &str) -> bool {
    ["1", "out", "none", "1:2", "wsg25"]
        .iter()
        .any(|word| set(&mut Config::default(), name, &[(*word).to_owned()]).is_some())
}

/// Checks speeds, acceleration and force against the limits of the model.
pub(crate) fn check_limits(config: &Config) -> Result<(), String> {
    for (option, quantity, value) in [
        ("homing-speed", Quantity::Speed, config.homing_speed),
        ("force", Quantity::Force, config.force_limit),
        ("acceleration", Quantity::Acceleration, config.acceleration),
        ("speed", Quantity::Speed, Some(config.speed)),
        ("release-speed", Quantity::Speed, config.release_speed),
    ] {
        let Some(value) = value else { continue };
        let checked = config.model.parameters().limits.check(quantity, value, SystemFlags::empty());
        let model = config.model;
        checked.map_err(|error| format!("invalid value for --{option} with --model {model}: {error}"))?;
    }
    Ok(())
}

/// The part between the fingers, for an option that always has a value.
pub(crate) type MaybePart = Option<Part>;

pub(crate) fn parsed<T: FromStr>(text: &str) -> Option<T> {
    text.parse().ok()
}

/// Parses a part; `none` is a valid value.
pub(crate) fn part(text: &str) -> Option<MaybePart> {
    if text == "none" {
        return Some(None);
    }
    let mut numbers = text.split(':').map(number);
    let width = numbers.next()??;
    let stiffness = numbers.next().unwrap_or(Some(Part::DEFAULT_STIFFNESS))?;
    let part = Part::new(width, stiffness)?;
    let part = match numbers.next() {
        Some(inner_width) => part.with_inner_width(inner_width?)?,
        None => part,
    };
    numbers.next().is_none().then_some(Some(part))
}

pub(crate) fn time_scale(text: &str) -> Option<f32> {
    number(text).filter(|scale| (Config::MIN_TIME_SCALE..=Config::MAX_TIME_SCALE).contains(scale))
}

/// Parses a finite number above 0.
pub(crate) fn positive(text: &str) -> Option<f32> {
    number(text).filter(|value| value.is_finite() && *value > 0.0)
}

/// Parses a length in mm.
pub(crate) fn length(text: &str) -> Option<f32> {
    number(text).filter(|value| (0.0..=1_000.0).contains(value))
}

/// Parses soft limits in mm.
pub(crate) fn soft_limits(text: &str) -> Option<SoftLimits> {
    let (minus, plus) = text.split_once(':')?;
    let limits = SoftLimits { minus: length(minus)?, plus: length(plus)? };
    (limits.minus <= limits.plus).then_some(limits)
}
