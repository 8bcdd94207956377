//! Changes of settings: described first, written in one request, read back, and reverted on a mismatch.

use anyhow::{Result, bail};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{FIRST_START_SETTING, Record, SETTINGS};

use super::client::{Client, Failure};
use super::names::words;

/// Returns the indices at which two records differ.
pub(crate) fn differing(old: &Record, new: &Record) -> Vec<usize> {
    (0..old.len()).filter(|at| old.get(*at) != new.get(*at)).collect()
}

/// Describes each change in a line: `RECIPE0_WIDTH: 20.00 mm becomes 15.00 mm (2000 -> 1500)`.
pub(crate) fn described(old: &Record, new: &Record) -> String {
    let line = |at: usize| {
        let (setting, old, new) = (SETTINGS.get(at)?, *old.get(at)?, *new.get(at)?);
        let of = |value| words(setting.unit, setting.meaning, value).unwrap_or_else(|| value.to_string());
        let from_a_start = if at >= FIRST_START_SETTING { ", after the next restart" } else { "" };
        Some(format!("{}: {} becomes {} ({old} -> {new}){from_a_start}\n", setting.name, of(old), of(new)))
    };
    differing(old, new).into_iter().filter_map(line).collect()
}

/// Writes the changes and reads them back.
///
/// # Errors
/// The changes were not applied. The message states whether the previous settings are in effect.
pub(crate) fn write(client: &mut Client, old: &Record, new: &Record) -> Result<()> {
    // Reject here what the bridge would refuse.
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
        Err(failure) => bail!("the settings may or may not have changed: {failure}; check with `show`"),
    };
    if part(&now) == part(new) {
        return Ok(());
    }
    if part(&now) == part(old) {
        match outcome {
            Err(failure) => bail!("nothing was changed: {failure}"),
            Ok(()) => bail!("nothing was changed, although the bridge accepted the request"),
        }
    }
    // The bridge executes a request as a whole or not at all, so another client must have written as well.
    let is_restored = client.write(*first, &part(old)).is_ok()
        && client.settings().is_ok_and(|now| part(&now) == part(old));
    if is_restored {
        bail!(
            "the settings read back differ from those written, and the previous ones were restored; check for other programs that \
             write settings"
        );
    }
    bail!(
        "the settings read back differ from those written, and the previous ones could not be restored; check with `show`"
    )
}
