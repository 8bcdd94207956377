//! The EDS file (CiA 306), from the tables that the server uses.

use core::fmt::{self, Write};

use super::NodeConfig;
use super::objects::{DataType, OBJECTS, Object, REPORTS_INDEX, SETTINGS_INDEX, Subject};
use crate::registers::{REPORTS, SETTINGS};

/// Objects that every device has (CiA 306: mandatory); those from 2000h on are the manufacturer's.
const MANDATORY: [u16; 3] = [0x1000, 0x1001, 0x1018];
const MANUFACTURER: u16 = 0x2000;

/// Writes the EDS file of a bridge that is built with this configuration.
///
/// # Errors
/// Those of the writer.
pub fn write_eds(out: &mut impl Write, config: &NodeConfig) -> fmt::Result {
    out.write_str(HEAD)?;
    writeln!(out, "\n[DeviceInfo]")?;
    for line in DEVICE_INFO {
        writeln!(out, "{line}")?;
    }
    writeln!(out, "\n[DummyUsage]")?;
    for number in 1..=7 {
        writeln!(out, "Dummy{number:04}=0")?;
    }
    writeln!(out, "\n[Comments]\nLines=0")?;
    list(out, "MandatoryObjects", |index| MANDATORY.contains(&index))?;
    list(out, "OptionalObjects", |index| !MANDATORY.contains(&index) && index < MANUFACTURER)?;
    list(out, "ManufacturerObjects", |index| index >= MANUFACTURER)?;
    for index in indices() {
        match index {
            SETTINGS_INDEX => {
                record(out, index, "Settings", SETTINGS.len() + 1)?;
                count(out, index, SETTINGS.len())?;
                for (number, setting) in SETTINGS.iter().enumerate() {
                    let access = Access { writable: true, mappable: false };
                    let range = Some((setting.least, setting.most));
                    entry(out, index, Some(number + 1), setting.name, DataType::U16, access, range)?;
                }
            }
            REPORTS_INDEX => {
                record(out, index, "Reports", REPORTS.len() + 1)?;
                count(out, index, REPORTS.len())?;
                for (number, report) in REPORTS.iter().enumerate() {
                    let access = Access { writable: false, mappable: false };
                    entry(out, index, Some(number + 1), report.name, DataType::U16, access, None)?;
                }
            }
            _ => object(out, index, config)?,
        }
    }
    Ok(())
}

const HEAD: &str = "\
[FileInfo]
FileName=wsg-bridge.eds
FileVersion=1
FileRevision=0
EDSVersion=4.0
Description=PLC bridge for WSG servo grippers
CreationTime=12:00AM
CreationDate=01-01-2026
CreatedBy=wsg-bridge
ModificationTime=12:00AM
ModificationDate=01-01-2026
ModifiedBy=wsg-bridge
";

const DEVICE_INFO: [&str; 21] = [
    "VendorName=wsg-bridge",
    "VendorNumber=0",
    "ProductName=wsg-bridge",
    "ProductNumber=1",
    "RevisionNumber=65536",
    "OrderCode=wsg-bridge",
    "BaudRate_10=0",
    "BaudRate_20=0",
    "BaudRate_50=0",
    "BaudRate_125=1",
    "BaudRate_250=1",
    "BaudRate_500=1",
    "BaudRate_800=0",
    "BaudRate_1000=1",
    "SimpleBootUpMaster=0",
    "SimpleBootUpSlave=1",
    "Granularity=0",
    "DynamicChannelsSupported=0",
    "GroupMessaging=0",
    "NrOfRXPDO=1",
    "NrOfTXPDO=2",
];

/// Every index once, in order.
fn indices() -> impl Iterator<Item = u16> {
    let mut last = 0;
    let table = OBJECTS.iter().filter_map(move |object| {
        let is_new = object.index != last;
        last = object.index;
        is_new.then_some(object.index)
    });
    table.chain([SETTINGS_INDEX, REPORTS_INDEX])
}

fn list(out: &mut impl Write, name: &str, belongs: impl Fn(u16) -> bool) -> fmt::Result {
    let found = indices().filter(|index| belongs(*index));
    writeln!(out, "\n[{name}]\nSupportedObjects={}", found.count())?;
    for (number, index) in indices().filter(|index| belongs(*index)).enumerate() {
        writeln!(out, "{}=0x{index:04X}", number + 1)?;
    }
    Ok(())
}

fn object(out: &mut impl Write, index: u16, config: &NodeConfig) -> fmt::Result {
    let entries = || OBJECTS.iter().filter(move |object| object.index == index);
    let Some(first) = entries().next() else { return Ok(()) };
    if !first.record.is_empty() {
        record(out, index, first.record, entries().count())?;
    }
    for object in entries() {
        let Object { sub, kind, writable, mappable, name, record, .. } = *object;
        let sub = (!record.is_empty()).then_some(usize::from(sub));
        entry_with_default(
            out,
            index,
            sub,
            name,
            kind,
            Access { writable, mappable },
            object.subject,
            config,
        )?;
    }
    Ok(())
}

/// An entry with what it holds at power-up. `$NODEID` is replaced by whoever reads the file.
#[expect(clippy::too_many_arguments, reason = "the keys of one entry")]
fn entry_with_default(
    out: &mut impl Write,
    index: u16,
    sub: Option<usize>,
    name: &str,
    kind: DataType,
    access: Access,
    subject: Subject,
    config: &NodeConfig,
) -> fmt::Result {
    let at = |values: [u16; 2], number: u8| values.get(usize::from(number)).copied().map(u32::from);
    let (prefix, number) = match subject {
        Subject::Fixed(number) => ("", Some(number)),
        Subject::PlusNode(base) => ("$NODEID+", Some(base)),
        Subject::Heartbeat => ("", Some(config.heartbeat_ms.into())),
        Subject::Inhibit(number) => ("", at(config.inhibit, number)),
        Subject::Event(number) => ("", at(config.event_ms, number)),
        _ => ("", None),
    };
    entry(out, index, sub, name, kind, access, None)?;
    match number {
        Some(number) => writeln!(out, "DefaultValue={prefix}0x{number:X}"),
        None => Ok(()),
    }
}

#[derive(Clone, Copy)]
struct Access {
    writable: bool,
    mappable: bool,
}

fn record(out: &mut impl Write, index: u16, name: &str, entries: usize) -> fmt::Result {
    writeln!(out, "\n[{index:04X}]\nParameterName={name}\nObjectType=0x9\nSubNumber={entries}")
}

fn count(out: &mut impl Write, index: u16, entries: usize) -> fmt::Result {
    let access = Access { writable: false, mappable: false };
    entry(out, index, Some(0), "Number of entries", DataType::U8, access, None)?;
    writeln!(out, "DefaultValue=0x{entries:X}")
}

fn entry(
    out: &mut impl Write,
    index: u16,
    sub: Option<usize>,
    name: &str,
    kind: DataType,
    access: Access,
    range: Option<(u16, u16)>,
) -> fmt::Result {
    match sub {
        Some(sub) => writeln!(out, "\n[{index:04X}sub{sub:X}]")?,
        None => writeln!(out, "\n[{index:04X}]")?,
    }
    writeln!(out, "ParameterName={name}\nObjectType=0x7\nDataType=0x{:04X}", kind.code())?;
    writeln!(out, "AccessType={}", if access.writable { "rw" } else { "ro" })?;
    writeln!(out, "PDOMapping={}", u8::from(access.mappable))?;
    if let Some((least, most)) = range {
        writeln!(out, "LowLimit={least}\nHighLimit={most}")?;
    }
    Ok(())
}
