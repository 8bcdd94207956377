//! Settings of an image. `--set NAME=VALUE` changes them in the ELF file without recompiling.

use std::fmt;

use anyhow::{Context, Result, anyhow, bail, ensure};
use wsg_bridge_fw::{
    Config,
    registers::{Record, SETTINGS},
};

/// Symbol of the settings record in the image.
const SYMBOL: &str = "WSG_SETTINGS";

/// A setting that differs from the image's default.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Change {
    name: &'static str,
    /// Index in the record.
    at: usize,
    value: u16,
}

impl Change {
    /// Creates a change of the setting with this name.
    pub(crate) fn new(name: &str, value: u16) -> Result<Self> {
        let found = SETTINGS.iter().enumerate().find(|(_, setting)| setting.name == name);
        let (at, setting) = found.with_context(|| {
            let names: Vec<_> = SETTINGS.iter().map(|setting| setting.name).collect();
            format!("unknown setting {name}; expected one of {}", names.join(", "))
        })?;
        Ok(Self { name: setting.name, at, value })
    }

    /// Parses `NAME=VALUE`. The value is decimal, or hexadecimal with `0x`.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        let (name, value) =
            text.split_once('=').with_context(|| format!("invalid argument {text}; expected NAME=VALUE"))?;
        let parsed = match value.strip_prefix("0x") {
            Some(digits) => u16::from_str_radix(digits, 16),
            None => value.parse(),
        };
        Self::new(name, parsed.map_err(|_| anyhow!("{name}={value}: expected a number from 0 to 65535"))?)
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.value)
    }
}

/// Changes these settings in an image.
pub(crate) fn apply(elf: &mut [u8], changes: &[Change]) -> Result<()> {
    if changes.is_empty() {
        return Ok(());
    }
    let place = footprint::place_of(SYMBOL, elf).context("the image has no settings")?;
    let bytes = elf.get_mut(place).context("the settings record is truncated")?;
    let expected = 2 * SETTINGS.len();
    ensure!(bytes.len() == expected, "the image has {} bytes of settings; expected {expected}", bytes.len());
    let words = bytes.as_chunks_mut::<2>().0;
    let record = std::array::from_fn(|n| u16::from_le_bytes(words[n]));
    for (word, value) in words.iter_mut().zip(changed(record, changes)?) {
        *word = value.to_le_bytes();
    }
    Ok(())
}

/// Checks that these settings and the defaults form a valid configuration. Called before the build, which takes longer.
pub(crate) fn check(changes: &[Change]) -> Result<()> {
    changed(Config::DEFAULT.record(), changes).map(drop)
}

fn changed(mut record: Record, changes: &[Change]) -> Result<Record> {
    for change in changes {
        record[change.at] = change.value;
    }
    match Config::from_record(&record) {
        Ok(_) => Ok(record),
        Err(wrong) => bail!("invalid value {}: {wrong}", record[wrong.at]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_decimal_or_hexadecimal() {
        assert_eq!(Change::parse("CAN_ID=0x140").unwrap().value, 0x140);
        assert_eq!(Change::parse("CAN_RATE=250").unwrap().to_string(), "CAN_RATE=250");
    }

    #[test]
    fn mistakes_are_reported_in_one_line() {
        for (text, error) in [
            ("CAN_RATE", "invalid argument CAN_RATE; expected NAME=VALUE"),
            ("CAN_RATE=fast", "CAN_RATE=fast: expected a number from 0 to 65535"),
            ("CAN_RATE=70000", "CAN_RATE=70000: expected a number from 0 to 65535"),
        ] {
            assert_eq!(Change::parse(text).unwrap_err().to_string(), error);
        }
        let unknown = Change::parse("BAUD=9600").unwrap_err().to_string();
        assert!(unknown.starts_with("unknown setting BAUD; expected one of UNIT, "), "{unknown}");
    }

    #[test]
    fn a_value_out_of_its_range_is_refused_with_the_range() {
        let refused = |text| check(&[Change::parse(text).unwrap()]).unwrap_err().to_string();
        let error = "invalid value 300: CAN_RATE takes 125 to 1000: rate of CAN: 125, 250, 500 or 1000";
        assert_eq!(refused("CAN_RATE=300"), error);
        assert!(refused("UNIT=0").contains("UNIT takes 1 to 247"));
        assert!(check(&[Change::parse("CAN_RATE=250").unwrap()]).is_ok());
    }

    #[test]
    fn an_image_without_settings_is_left_alone() {
        assert!(apply(&mut [], &[]).is_ok());
        assert!(apply(&mut [], &[Change::new("UNIT", 5).unwrap()]).is_err());
    }
}
