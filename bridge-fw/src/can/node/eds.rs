//! The EDS file (CiA 306), from the tables that the server uses.

use core::fmt::{self, Write};
use core::iter;

use bus_canopen::{DataType, Eds, EdsEntry, EdsFacts, Source};

use super::objects::{COUNT, Key, OBJECTS, Object, REPORTS_INDEX, SETTINGS_INDEX, report, setting};
use crate::config::NodeConfig;
use crate::registers::{REPORTS, SETTINGS};

const FACTS: EdsFacts<'_> = EdsFacts {
    file_name: "wsg-bridge.eds",
    description: "PLC bridge for WSG servo grippers",
    time: "12:00AM",
    date: "01-01-2026",
    author: "wsg-bridge",
    vendor: "wsg-bridge",
    product: "wsg-bridge",
    order_code: "wsg-bridge",
    kbit_rates: &[125, 250, 500, 1000],
};

/// Writes the EDS file of a bridge that is built with this configuration.
///
/// # Errors
/// Those of the writer.
pub fn write_eds(out: &mut impl Write, config: &NodeConfig) -> fmt::Result {
    let table = OBJECTS.iter().map(|object| EdsEntry { object: *object, limits: None });
    let settings = (1..).zip(&SETTINGS).map(|(sub, of)| EdsEntry {
        object: Object { writable: true, ..register(SETTINGS_INDEX, sub, of.name, setting(sub)) },
        limits: Some((of.least, of.most)),
    });
    let reports = (1..).zip(&REPORTS).map(|(sub, of)| EdsEntry {
        object: register(REPORTS_INDEX, sub, of.name, report(sub)),
        limits: None,
    });
    let entries = table
        .chain(count(SETTINGS_INDEX, SETTINGS.len()))
        .chain(settings)
        .chain(count(REPORTS_INDEX, REPORTS.len()))
        .chain(reports);
    write!(out, "{}", Eds { facts: FACTS, entries, config: *config })
}

/// The entry that says how many there are.
fn count(index: u16, entries: usize) -> iter::Once<EdsEntry<Key>> {
    let source = Source::Fixed(entries as u32);
    let object = Object { kind: DataType::U8, ..register(index, 0, COUNT, source) };
    iter::once(EdsEntry { object, limits: None })
}

fn register(index: u16, sub: u8, name: &'static str, source: Source<Key>) -> Object {
    let record = if index == SETTINGS_INDEX { "Settings" } else { "Reports" };
    Object { index, sub, kind: DataType::U16, writable: false, mappable: false, name, record, source }
}
