//! Settings files: TOML with a comment for each setting.

use std::fmt::Write as _;

use anyhow::{Context, Result, bail};
use toml::de::{DeTable, DeValue};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{MAP_VERSION, Record, SETTINGS};

use super::names;

/// Formats the settings as a file. `firmware` is the version of the bridge's firmware.
pub(crate) fn exported(settings: &Record, firmware: &str) -> String {
    let mut text = format!(
        "# Settings of a WSG bridge, written by `wsg bridge PORT export`. docs/registers.md describes them.\n\
         # A value is the register's number, or text with a unit, such as \"20.00 mm\". Omitted settings keep their value.\n\
         map_version = {MAP_VERSION}\nfirmware = \"{firmware}\"\n\n[settings]\n"
    );
    for (setting, value) in SETTINGS.iter().zip(settings) {
        let is = names::words(setting.unit, setting.meaning, *value)
            .map(|words| format!("{words}; "))
            .unwrap_or_default();
        let meaning =
            if setting.meaning.is_empty() { String::new() } else { format!(": {}", setting.meaning) };
        // Writing to a string never fails.
        let _ = writeln!(
            text,
            "{} = {value}  # {is}{} to {}{meaning}",
            setting.name, setting.least, setting.most
        );
    }
    text
}

/// Applies the settings in a file to a record.
///
/// # Errors
/// The file is invalid. The message states the line and the reason.
pub(crate) fn imported(text: &str, settings: &Record) -> Result<Record> {
    let line = |at: usize| format!("line {}", 1 + text.get(..at).unwrap_or("").matches('\n').count());
    let document = DeTable::parse(text).map_err(|error| {
        let at = error.span().map(|span| format!("{}: ", line(span.start))).unwrap_or_default();
        anyhow::anyhow!("{at}{}", error.message())
    })?;
    let mut new = *settings;
    let mut version = None;
    for (key, value) in document.get_ref() {
        let at = line(key.span().start);
        match (key.get_ref().as_ref(), value.get_ref()) {
            ("map_version", DeValue::Integer(number)) => {
                version = Some(number.as_str().to_owned());
                if number.as_str() != MAP_VERSION.to_string() {
                    bail!(
                        "{at}: the file is for register map version {}, but this wsg supports version {MAP_VERSION}",
                        number.as_str()
                    );
                }
            }
            ("firmware", DeValue::String(_)) => {}
            ("settings", DeValue::Table(table)) => new = applied(table, settings, &line)?,
            (name @ ("map_version" | "firmware" | "settings"), _) => {
                bail!("{at}: {name} has the wrong type")
            }
            (name, _) => bail!("{at}: unknown key `{name}`; settings belong below [settings]"),
        }
    }
    if version.is_none() {
        bail!("missing map_version: the file was not written by `wsg bridge PORT export`, or is incomplete");
    }
    Ok(new)
}

/// Applies the settings in a table to a record. `place` describes the place of a byte in the file.
///
/// # Errors
/// A setting is unknown or invalid. The message states its place and the reason.
pub(crate) fn applied(
    table: &DeTable<'_>,
    settings: &Record,
    place: &impl Fn(usize) -> String,
) -> Result<Record> {
    let mut new = *settings;
    // The place of each setting in the file.
    let mut places = [None; SETTINGS.len()];
    for (key, value) in table {
        let at = key.span().start;
        let taken = names::setting(key.get_ref()).and_then(|(index, setting)| {
            let words = match value.get_ref() {
                DeValue::Integer(number) => number_of(number.as_str(), number.radix())?,
                DeValue::String(words) => words.to_string(),
                _ => bail!("{} expects a number, or text with a unit", setting.name),
            };
            Ok((index, names::value(setting, &words)?))
        });
        let (index, value) = taken.with_context(|| place(at))?;
        if let (Some(slot), Some(its_place)) = (new.get_mut(index), places.get_mut(index)) {
            *slot = value;
            *its_place = Some(at);
        }
    }
    Config::from_record(&new).map_err(|wrong| {
        let at = places.get(wrong.at).copied().flatten();
        let at = at.map(|at| format!("{}: ", place(at))).unwrap_or_default();
        anyhow::anyhow!("{at}invalid configuration: {wrong}")
    })?;
    Ok(new)
}

/// Converts a TOML integer to decimal digits.
fn number_of(digits: &str, radix: u32) -> Result<String> {
    let number = i64::from_str_radix(&digits.replace('_', ""), radix).context("the number is too large")?;
    Ok(number.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bridge::names::place;

    fn of_this_map(text: &str) -> String {
        format!("map_version = {MAP_VERSION}\n{text}")
    }

    fn record() -> Record {
        Config::DEFAULT.record()
    }

    #[test]
    fn exported_settings_are_imported_unchanged() {
        let mut other = record();
        other[place("RECIPE3_WIDTH")] = 12_34;
        other[place("CAN_NODE")] = 5;
        assert_eq!(imported(&exported(&other, "0.1.0"), &record()).unwrap(), other);
    }

    #[test]
    fn part_of_a_file_changes_that_part_and_takes_units_and_choices() {
        let text = "[settings]\nRECIPE0_WIDTH = \"15 mm\"\nPLC_BUS = \"CANopen\"\nCAN_ID = 0x1_40\n";
        let new = imported(&of_this_map(text), &record()).unwrap();
        let mut expected = record();
        expected[place("RECIPE0_WIDTH")] = 15_00;
        expected[place("PLC_BUS")] = 2;
        expected[place("CAN_ID")] = 0x140;
        assert_eq!(new, expected);
    }

    #[test]
    fn invalid_file_is_rejected_with_its_line() {
        let with = |lines: &str| of_this_map(&format!("[settings]\nUNIT = 5\n{lines}\n"));
        let other = MAP_VERSION + 1;
        let of_other =
            format!("line 1: the file is for register map version {other}, but this wsg supports version");
        for (text, error) in [
            (
                with("COLOUR = 3"),
                "line 4: unknown setting `COLOUR`; run `wsg bridge PORT show --json` for all names",
            ),
            (with("RECIPE0_WITH = 3"), "line 4: unknown setting `RECIPE0_WITH`; did you mean RECIPE0_WIDTH?"),
            (with("UNIT = 6"), "line 4: duplicate key"),
            (with("BUS_REACTION = 3"), "line 4: 3 is out of range: BUS_REACTION takes 0 to 2: "),
            (with("BUS_REACTION = -1"), "line 4: `-1` is not a valid value: "),
            (with("BUS_REACTION = 1.5"), "line 4: BUS_REACTION expects a number, or text with a unit"),
            (
                with("BUS_TIMEOUT = \"1 s\""),
                "line 4: `1 s` is not a valid value: the unit of BUS_TIMEOUT is ms, for example 100 ms",
            ),
            (with("\nCAN_NODE = 127"), "line 5: invalid configuration: CAN_NODE takes 1 to 127: "),
            (with("CAN_RATE = 126"), "line 4: invalid configuration: CAN_RATE takes 125 to 1000: "),
            (with("[more]"), "line 4: unknown key `more`; settings belong below [settings]"),
            (format!("map_version = {other}\n"), of_other.as_str()),
            ("[settings]\nUNIT = 5\n".to_owned(), "missing map_version"),
            ("map_version = \n".to_owned(), "line 1: "),
            ("settings = 3\n".to_owned(), "line 1: settings has the wrong type"),
        ] {
            let printed = format!("{:#}", imported(&text, &record()).expect_err(&text));
            assert!(printed.starts_with(error), "{text}{printed}");
        }
    }

    #[test]
    fn two_interdependent_settings_can_change_together() {
        let text = of_this_map("[settings]\nCAN_NODE = 127\nCAN_MASTER = 16\n");
        assert!(imported(&text, &record()).is_ok());
    }
}
