//! EDS file (CiA 306), generated from the server's tables.

use core::fmt::{self, Write};
use core::iter;

use bus_canopen::{DataType, Eds, EdsEntry, EdsFacts, EdsValue, Source};

use super::objects::{
    COUNT, DEVICE_NAME, Key, OBJECTS, Object, REPORTS_INDEX, SETTINGS_INDEX, SOFTWARE_VERSION, report,
    setting,
};
use crate::can::NodeConfig;
use crate::plc::{Config, REPORTS, SETTINGS};

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

/// Writes the EDS file of a bridge with this configuration.
///
/// # Errors
/// Errors of the writer.
pub fn write_eds(out: &mut impl Write, config: &NodeConfig) -> fmt::Result {
    let delivered = Config::DEFAULT.record();
    let table = OBJECTS.iter().map(|object| {
        let default = match (object.index, object.source) {
            (0x1008, _) => Some(EdsValue::Text(DEVICE_NAME)),
            (0x100A, _) => Some(EdsValue::Text(SOFTWARE_VERSION)),
            (_, Source::ConsumerHeartbeat) => {
                let time_ms = Config::DEFAULT.bus.timeout_ms;
                Some(EdsValue::Number(u32::from(config.master) << 16 | u32::from(time_ms)))
            }
            _ => None,
        };
        EdsEntry { default, ..EdsEntry::new(*object) }
    });
    let settings = (1..).zip(&SETTINGS).zip(delivered).map(|((sub, of), value)| EdsEntry {
        object: Object { writable: true, ..register(SETTINGS_INDEX, sub, of.name, setting(sub)) },
        limits: Some((of.least, of.most)),
        default: Some(EdsValue::Number(value.into())),
    });
    let reports = (1..)
        .zip(&REPORTS)
        .map(|(sub, of)| EdsEntry::new(register(REPORTS_INDEX, sub, of.name, report(sub))));
    let entries = table
        .chain(count(SETTINGS_INDEX, SETTINGS.len()))
        .chain(settings)
        .chain(count(REPORTS_INDEX, REPORTS.len()))
        .chain(reports);
    write!(out, "{}", Eds { facts: FACTS, entries, config: *config })
}

/// Returns subindex 0, the number of entries.
fn count(index: u16, entries: usize) -> iter::Once<EdsEntry<'static, Key>> {
    let source = Source::Fixed(entries as u32);
    let object = Object { kind: DataType::U8, ..register(index, 0, COUNT, source) };
    iter::once(EdsEntry::new(object))
}

fn register(index: u16, sub: u8, name: &'static str, source: Source<Key>) -> Object {
    let record = if index == SETTINGS_INDEX { "Settings" } else { "Reports" };
    Object { index, sub, kind: DataType::U16, writable: false, mappable: false, name, record, source }
}
