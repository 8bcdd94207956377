//! Settings as a file: TOML, with a comment for each.

use std::fmt::Write as _;
use std::ops::Range;

use anyhow::{Context, Result, bail};
use toml::de::{DeTable, DeValue};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{MAP_VERSION, Record, SETTINGS};

use super::names;

/// The file of these settings, of a bridge with this firmware.
pub(crate) fn exported(settings: &Record, firmware: &str) -> String {
    let mut text = format!(
        "# Settings of a WSG bridge, written by `wsg bridge PORT export`. docs/registers.md has them all.\n\
         # A value is the register's number, or text with its unit, as \"20.00 mm\". What is left out stays as it is.\n\
         map_version = {MAP_VERSION}\nfirmware = \"{firmware}\"\n\n[settings]\n"
    );
    for (setting, value) in SETTINGS.iter().zip(settings) {
        let is = names::words(setting.unit, setting.meaning, *value)
            .map(|words| format!("{words}; "))
            .unwrap_or_default();
        let meaning =
            if setting.meaning.is_empty() { String::new() } else { format!(": {}", setting.meaning) };
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{} = {value}  # {is}{} to {}{meaning}",
            setting.name, setting.least, setting.most
        );
    }
    text
}

/// The settings with the changes that a file makes.
///
/// # Errors
/// The line in which something does not fit, and why.
pub(crate) fn imported(text: &str, settings: &Record) -> Result<Record> {
    let line = |span: Range<usize>| 1 + text.get(..span.start).unwrap_or("").matches('\n').count();
    let document = DeTable::parse(text).map_err(|error| {
        let at = error.span().map(|span| format!("line {}: ", line(span))).unwrap_or_default();
        anyhow::anyhow!("{at}{}", error.message())
    })?;
    let mut new = *settings;
    // Where each setting is that the file has.
    let mut lines = [None; SETTINGS.len()];
    let mut version = None;
    for (key, value) in document.get_ref() {
        let at = line(key.span());
        match (key.get_ref().as_ref(), value.get_ref()) {
            ("map_version", DeValue::Integer(number)) => {
                version = Some(number.as_str().to_owned());
                if number.as_str() != MAP_VERSION.to_string() {
                    bail!(
                        "line {at}: the file is for version {} of the register map, and this wsg knows version {MAP_VERSION}",
                        number.as_str()
                    );
                }
            }
            ("firmware", DeValue::String(_)) => {}
            ("settings", DeValue::Table(table)) => {
                for (key, value) in table {
                    let at = line(key.span());
                    let taken = names::setting(key.get_ref()).and_then(|(place, setting)| {
                        let words = match value.get_ref() {
                            DeValue::Integer(number) => number_of(number.as_str(), number.radix())?,
                            DeValue::String(words) => words.to_string(),
                            _ => bail!("{} takes a number, or text with a unit", setting.name),
                        };
                        Ok((place, names::value(setting, &words)?))
                    });
                    let (place, value) = taken.with_context(|| format!("line {at}"))?;
                    if let (Some(slot), Some(line)) = (new.get_mut(place), lines.get_mut(place)) {
                        *slot = value;
                        *line = Some(at);
                    }
                }
            }
            (name @ ("map_version" | "firmware" | "settings"), _) => {
                bail!("line {at}: {name} is something else in such a file")
            }
            (name, _) => bail!("line {at}: {name} is unknown; settings stand below [settings]"),
        }
    }
    if version.is_none() {
        bail!("the file has no map_version: it was not written by `wsg bridge PORT export`, or not whole");
    }
    Config::from_record(&new).map_err(|wrong| {
        let at = lines.get(wrong.at).copied().flatten();
        let at = at.map(|line| format!("line {line}: ")).unwrap_or_default();
        anyhow::anyhow!("{at}beside the other settings it does not fit: {wrong}")
    })?;
    Ok(new)
}

/// An integer of TOML as decimal digits.
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
    fn exported_settings_are_imported_as_they_were() {
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
    fn what_does_not_fit_is_refused_with_its_line() {
        let with = |lines: &str| of_this_map(&format!("[settings]\nUNIT = 5\n{lines}\n"));
        let other = MAP_VERSION + 1;
        let of_other = format!(
            "line 1: the file is for version {other} of the register map, and this wsg knows version"
        );
        for (text, error) in [
            (with("COLOUR = 3"), "line 4: there is no setting COLOUR; `show` lists all"),
            (with("RECIPE0_WITH = 3"), "line 4: there is no setting RECIPE0_WITH; is it RECIPE0_WIDTH?"),
            (with("UNIT = 6"), "line 4: duplicate key"),
            (with("BUS_REACTION = 3"), "line 4: 3 does not fit: BUS_REACTION takes 0 to 2: "),
            (with("BUS_REACTION = -1"), "line 4: -1 is no value: "),
            (with("BUS_REACTION = 1.5"), "line 4: BUS_REACTION takes a number, or text with a unit"),
            (
                with("BUS_TIMEOUT = \"1 s\""),
                "line 4: 1 s is no value: the unit of BUS_TIMEOUT is ms, as 100 ms",
            ),
            (
                with("\nCAN_NODE = 127"),
                "line 5: beside the other settings it does not fit: CAN_NODE takes 1 to 127: ",
            ),
            (
                with("CAN_RATE = 126"),
                "line 4: beside the other settings it does not fit: CAN_RATE takes 125 to 1000: ",
            ),
            (with("[more]"), "line 4: more is unknown; settings stand below [settings]"),
            (format!("map_version = {other}\n"), of_other.as_str()),
            ("[settings]\nUNIT = 5\n".to_owned(), "the file has no map_version"),
            ("map_version = \n".to_owned(), "line 1: "),
            ("settings = 3\n".to_owned(), "line 1: settings is something else in such a file"),
        ] {
            let said = format!("{:#}", imported(&text, &record()).expect_err(&text));
            assert!(said.starts_with(error), "{text}{said}");
        }
    }

    #[test]
    fn both_of_two_values_that_go_together_may_change() {
        let text = of_this_map("[settings]\nCAN_NODE = 127\nCAN_MASTER = 16\n");
        assert!(imported(&text, &record()).is_ok());
    }
}
