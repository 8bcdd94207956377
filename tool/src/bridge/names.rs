//! Register names and values in human-readable form. Names, ranges and units come from the firmware's tables; choices are parsed
//! from the text of a register's meaning.

use anyhow::{Context, Result, bail};
use wsg_bridge_fw::registers::{REPORTS, SETTINGS, Setting};
use wsg_sim::command_line::nearest;

/// Finds a setting by name, in upper or lower case. Returns its index in a record as well.
pub(crate) fn setting(name: &str) -> Result<(usize, &'static Setting)> {
    let found = SETTINGS.iter().enumerate().find(|(_, setting)| setting.name.eq_ignore_ascii_case(name));
    found.with_context(|| unknown(name, "setting", &mut SETTINGS.iter().map(|setting| setting.name)))
}

/// Returns the index of a setting, which must exist.
pub(crate) fn place(name: &str) -> usize {
    SETTINGS.iter().position(|setting| setting.name == name).unwrap_or_default()
}

/// Returns the index of a report, which must exist.
pub(crate) fn report(name: &str) -> usize {
    REPORTS.iter().position(|report| report.name == name).unwrap_or_default()
}

/// Formats the error for an unknown name, with a suggestion if a similar name exists.
pub(crate) fn unknown(name: &str, what: &str, names: &mut dyn Iterator<Item = &'static str>) -> String {
    match nearest(name, names)[..] {
        [] => format!("unknown {what} `{name}`; run `wsg bridge PORT show --json` for all names"),
        ref near => format!("unknown {what} `{name}`; did you mean {}?", near.join(" or ")),
    }
}

/// The step of a register: a multiple or a fraction of a unit, such as `100 bit/s` or `1/100 mm`.
struct Scale {
    multiply: u32,
    divide: u32,
    unit: &'static str,
}

impl Scale {
    fn of(unit: &'static str) -> Self {
        let (factor, name) = unit.split_once(' ').unwrap_or(("1", unit));
        let (multiply, divide) = factor.split_once('/').unwrap_or((factor, "1"));
        match (multiply.parse(), divide.parse()) {
            (Ok(multiply), Ok(divide)) if divide > 0 => Self { multiply, divide, unit: name },
            _ => Self { multiply: 1, divide: 1, unit },
        }
    }

    fn text(&self, value: u16) -> String {
        let Self { multiply, divide, unit } = *self;
        if divide == 1 {
            format!("{} {unit}", u32::from(value) * multiply)
        } else {
            // Hundredths have two decimals.
            let digits = divide.ilog10() as usize;
            format!("{:.digits$} {unit}", f64::from(value) * f64::from(multiply) / f64::from(divide))
        }
    }
}

/// Formats a value as the name of a choice or as a number with its unit. Returns `None` if it has neither.
pub(crate) fn words(unit: &'static str, meaning: &'static str, value: u16) -> Option<String> {
    let choice = choices(meaning).into_iter().find(|(number, _)| *number == value);
    match choice {
        Some((_, text)) => Some(text.to_owned()),
        None if unit.is_empty() => None,
        None => Some(Scale::of(unit).text(value)),
    }
}

/// Parses a value: the register's number (decimal, or hexadecimal with `0x`), a number with its unit, or a choice.
pub(crate) fn value(setting: &Setting, text: &str) -> Result<u16> {
    let text = text.trim();
    let Setting { name, unit, least, most, meaning } = setting;
    let mut choices = choices(meaning).into_iter();
    if let Some((number, _)) = choices.find(|(_, choice)| choice.eq_ignore_ascii_case(text)) {
        return Ok(number);
    }
    let takes = || format!("{name} takes {least} to {most}: {meaning}");
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let number = digits.map_or_else(|| text.parse::<u32>(), |digits| u32::from_str_radix(digits, 16));
    if let Ok(number) = number {
        let value = u16::try_from(number).ok().filter(|value| (least..=most).contains(&value));
        return value.with_context(|| format!("{text} is out of range: {}", takes()));
    }
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, of) = text.split_at(end);
    let scale = Scale::of(unit);
    let of = of.trim();
    let number: f64 =
        number.parse().ok().with_context(|| format!("`{text}` is not a valid value: {}", takes()))?;
    if unit.is_empty() {
        bail!("`{text}` is not a valid value: {}", takes());
    } else if of != scale.unit {
        bail!(
            "`{text}` is not a valid value: the unit of {name} is {}, for example {}",
            scale.unit,
            scale.text(*least.max(&100).min(most))
        );
    }
    let steps = number * f64::from(scale.divide) / f64::from(scale.multiply);
    let value = steps.round();
    if (steps - value).abs() > 1e-6 {
        bail!("{text} is not a multiple of the step of {name}, which is {unit}");
    }
    if !(f64::from(*least)..=f64::from(*most)).contains(&value) {
        bail!("{text} is out of range: {name} takes {} to {}", scale.text(*least), scale.text(*most));
    }
    Ok(value as u16)
}

/// Parses the choices in a register's meaning: numbers followed by text, such as `0 hold, 1 stop` or `0: unlimited`.
pub(crate) fn choices(meaning: &'static str) -> Vec<(u16, &'static str)> {
    // Number, and start and end of its text.
    let mut found: Vec<(u16, usize, usize)> = Vec::new();
    let mut may_go_on = false;
    let mut start = 0;
    while start < meaning.len() {
        let rest = meaning.get(start..).unwrap_or("");
        let end = [", ", "; "].iter().filter_map(|separator| rest.find(separator)).min();
        let end = start + end.unwrap_or(rest.len());
        let part = meaning.get(start..end).unwrap_or("");
        let lead = part.find(": ").map_or(0, |at| at + 2);
        let lead = if part.get(lead..).is_some_and(|it| it.starts_with(|c: char| c.is_ascii_digit())) {
            lead
        } else {
            0
        };
        match choice(part.get(lead..).unwrap_or("")) {
            Some((number, words)) => {
                found.push((number, end - words.len(), end));
                may_go_on = true;
            }
            None => {
                let is_list = meaning.get(..start).is_some_and(|before| before.ends_with(", "));
                may_go_on &= is_list && part.parse::<u16>().is_err();
                if let Some(last) = found.last_mut().filter(|_| may_go_on) {
                    last.2 = end;
                }
            }
        }
        start = end + 2;
    }
    found.into_iter().filter_map(|(number, start, end)| Some((number, meaning.get(start..end)?))).collect()
}

/// Parses one choice: `0 hold` or `0: unlimited`.
fn choice(part: &str) -> Option<(u16, &str)> {
    let end = part.find(|c: char| !c.is_ascii_digit())?;
    let (number, rest) = part.split_at(end);
    let words = rest.strip_prefix(": ").or_else(|| rest.strip_prefix(' '))?;
    let is_choice = !["to ", "or ", "("].iter().any(|no| words.starts_with(no));
    is_choice.then_some((number.parse().ok()?, words))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_match_the_tables() {
        let of = |name: &str| choices(setting(name).unwrap().1.meaning);
        assert_eq!(of("BUS_REACTION"), [(0, "hold"), (1, "stop"), (2, "FAST STOP")]);
        assert_eq!(of("PLC_BUS"), [(0, "none"), (1, "Modbus RTU"), (2, "CANopen"), (3, "PROFIBUS DP")]);
        assert_eq!(of("BUS_CHAR_TIMEOUT"), [(0, "T1.5 of the specification")]);
        assert_eq!(of("BUS_RECIPE"), [(16, "WIDTH, SPEED and FORCELIMIT of the bus")]);
        assert_eq!(of("PROFIBUS_RATE"), [(0, "automatic search")]);
        assert_eq!((of("CAN_RATE"), of("RECIPE0_WIDTH"), of("CAN_MASTER")), (vec![], vec![], vec![]));
        let of = |name: &str| choices(REPORTS[report(name)].meaning);
        assert_eq!(of("GRIPPER_LINK"), [(0, "never answered"), (1, "lost"), (2, "connected")]);
        assert_eq!(of("SETTINGS_FROM").len(), 7);
        assert_eq!(of("SETTINGS_FROM")[3..5], [(3, "from newer firmware"), (4, "invalid")]);
        assert!(matches!(of("SAVE_STATE")[3], (3, words) if words.starts_with("failed, ")));
        assert_eq!(of("BUS_MESSAGES"), []);
    }

    #[test]
    fn values_are_register_numbers_numbers_with_a_unit_or_choices() {
        let of =
            |name: &str, text: &str| value(setting(name).unwrap().1, text).map_err(|error| error.to_string());
        assert_eq!(of("RECIPE0_WIDTH", "2005"), Ok(20_05));
        assert_eq!(of("RECIPE0_WIDTH", "20.05mm"), Ok(20_05));
        assert_eq!(of("RECIPE0_WIDTH", "20.05 mm"), Ok(20_05));
        assert_eq!(of("MODBUS_RATE", "19200 bit/s"), Ok(192));
        assert_eq!(of("CAN_ID", "0x140"), Ok(0x140));
        assert_eq!(of("PLC_BUS", "canopen"), Ok(2));
        assert_eq!(of("BUS_TIMEOUT", "unlimited"), Ok(0));
        for (name, text, error) in [
            (
                "RECIPE0_WIDTH",
                "20.05",
                "`20.05` is not a valid value: the unit of RECIPE0_WIDTH is mm, for example 1.00 mm",
            ),
            (
                "RECIPE0_WIDTH",
                "20.051mm",
                "20.051mm is not a multiple of the step of RECIPE0_WIDTH, which is 1/100 mm",
            ),
            ("RECIPE0_WIDTH", "400mm", "400mm is out of range: RECIPE0_WIDTH takes 0.00 mm to 327.67 mm"),
            (
                "RECIPE0_SPEED",
                "0",
                "0 is out of range: RECIPE0_SPEED takes 1 to 65535: speed of every motion",
            ),
            (
                "UNIT",
                "70000",
                "70000 is out of range: UNIT takes 1 to 247: address of the bridge on the bus; takes effect with the next request",
            ),
            (
                "GRIPPER_LINE",
                "USB",
                "`USB` is not a valid value: GRIPPER_LINE takes 0 to 1: gripper interface: 0 RS-232, 1 CAN",
            ),
            (
                "MODBUS_RATE",
                "19250 bit/s",
                "19250 bit/s is not a multiple of the step of MODBUS_RATE, which is 100 bit/s",
            ),
        ] {
            assert_eq!(of(name, text), Err(error.to_owned()));
        }
    }

    #[test]
    fn formatted_values_with_units_parse_to_the_same_number() {
        for setting in &SETTINGS {
            for value_of in [setting.least, setting.least.max(20), setting.most] {
                let Some(words) = words(setting.unit, setting.meaning, value_of) else { continue };
                assert_eq!(value(setting, &words).unwrap(), value_of, "{} {words}", setting.name);
            }
        }
    }

    #[test]
    fn similar_name_is_suggested() {
        assert_eq!(
            setting("recipe0_widht").unwrap_err().to_string(),
            "unknown setting `recipe0_widht`; did you mean RECIPE0_WIDTH?"
        );
        assert_eq!(
            setting("COLOUR").unwrap_err().to_string(),
            "unknown setting `COLOUR`; run `wsg bridge PORT show --json` for all names"
        );
    }
}
