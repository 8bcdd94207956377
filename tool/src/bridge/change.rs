//! Changes of settings: named before they are written, written by one request, read back, and taken back where that fails.

use anyhow::{Result, bail};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{FIRST_START_SETTING, Record, SETTINGS};

use super::client::{Client, Failure};
use super::names::words;

/// The places of a record that differ.
pub(crate) fn differing(old: &Record, new: &Record) -> Vec<usize> {
    (0..old.len()).filter(|at| old.get(*at) != new.get(*at)).collect()
}

/// A line for each change: `RECIPE0_WIDTH: 20.00 mm becomes 15.00 mm (register 2000 -> 1500)`.
pub(crate) fn described(old: &Record, new: &Record) -> String {
    let line = |at: usize| {
        let (setting, old, new) = (SETTINGS.get(at)?, *old.get(at)?, *new.get(at)?);
        let of = |value| words(setting.unit, setting.meaning, value).unwrap_or_else(|| value.to_string());
        let from_a_start = if at >= FIRST_START_SETTING { ", from the next start on" } else { "" };
        Some(format!("{}: {} becomes {} ({old} -> {new}){from_a_start}\n", setting.name, of(old), of(new)))
    };
    differing(old, new).into_iter().filter_map(line).collect()
}

/// Writes the changes: all of them are there afterwards, or an error says what is.
pub(crate) fn write(client: &mut Client, old: &Record, new: &Record) -> Result<()> {
    // What the bridge would refuse, it is not asked for.
    Config::from_record(new)?;
    let places = differing(old, new);
    let (Some(first), Some(last)) = (places.first(), places.last()) else { return Ok(()) };
    let part = |record: &Record| record.get(*first..=*last).unwrap_or(&[]).to_vec();
    let outcome = client.write(*first, &part(new));
    if let Err(failure @ Failure::Refused(_)) = outcome {
        bail!("nothing was changed: {failure}");
    }
    let now = match client.settings() {
        Ok(now) => now,
        Err(failure) => bail!("it is unknown whether the settings were changed: {failure}; look with `show`"),
    };
    if part(&now) == part(new) {
        return Ok(());
    }
    if part(&now) == part(old) {
        match outcome {
            Err(failure) => bail!("nothing was changed: {failure}"),
            Ok(()) => bail!("nothing was changed, though the bridge accepted it"),
        }
    }
    // By one request the bridge writes all or nothing: somebody else has written, too.
    let is_restored = client.write(*first, &part(old)).is_ok()
        && client.settings().is_ok_and(|now| part(&now) == part(old));
    if is_restored {
        bail!(
            "the settings read otherwise than they were written, and the old ones are back: does another program write them?"
        );
    }
    bail!(
        "the settings read otherwise than they were written, and the old ones could not be written back: look with `show`"
    )
}
