//! Generates the EDS file (CiA 306) from the table of the SDO server.

use core::fmt::{self, Write};

use crate::{Config, DataType, Object, Pdo, Source};

/// Mandatory objects of every device (CiA 306). Objects from 2000h up are manufacturer-specific.
const MANDATORY: [u16; 3] = [0x1000, 0x1001, 0x1018];
const MANUFACTURER: u16 = 0x2000;

/// Objects that CiA 301 defines as arrays. Other objects with entries are records.
const ARRAYS: [u16; 3] = [0x1003, 0x1016, 0x1029];

/// Bit rates with an entry in the EDS file, in kbit/s.
const RATES: [u16; 8] = [10, 20, 50, 125, 250, 500, 800, 1000];

/// Contents of an EDS file other than the objects. Vendor number, product number and revision come from object 1018h.
#[derive(Clone, Copy, Debug)]
pub struct EdsFacts<'a> {
    /// Name of the EDS file.
    pub file_name: &'a str,
    /// Description of the device.
    pub description: &'a str,
    /// Creation time of the file, such as `12:00AM`.
    pub time: &'a str,
    /// Creation date of the file, such as `01-31-2026`.
    pub date: &'a str,
    /// Author of the file.
    pub author: &'a str,
    /// Name of the device's vendor.
    pub vendor: &'a str,
    /// Product name of the device.
    pub product: &'a str,
    /// Order code of the device.
    pub order_code: &'a str,
    /// Supported bit rates in kbit/s, out of 10, 20, 50, 125, 250, 500, 800 and 1000.
    pub kbit_rates: &'a [u16],
}

/// An object with its limits and default in the EDS file.
#[derive(Clone, Copy, Debug)]
pub struct EdsEntry<'a, K> {
    /// Object of the dictionary.
    pub object: Object<K>,
    /// Minimum and maximum value, if known.
    pub limits: Option<(u16, u16)>,
    /// Value at power-up, if it cannot be derived from the object's source.
    pub default: Option<EdsValue<'a>>,
}

impl<K: Copy> EdsEntry<'_, K> {
    /// Creates an entry without limits and explicit default.
    #[must_use]
    pub const fn new(object: Object<K>) -> Self {
        Self { object, limits: None, default: None }
    }
}

/// Default value of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdsValue<'a> {
    /// A number. Signed values are in two's complement.
    Number(u32),
    /// A VISIBLE_STRING value.
    Text(&'a str),
}

/// The EDS file of a device. `Display` writes its text.
#[derive(Clone, Copy, Debug)]
pub struct Eds<'a, I, const T: usize> {
    /// Contents other than the objects.
    pub facts: EdsFacts<'a>,
    /// Entries in ascending order of index and subindex.
    pub entries: I,
    /// Configuration at power-up, for default values.
    pub config: Config<T>,
}

impl<'a, K: Copy, I: Iterator<Item = EdsEntry<'a, K>> + Clone, const T: usize> fmt::Display
    for Eds<'a, I, T>
{
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { facts, entries, config } = self;
        head(out, facts)?;
        device_info(out, facts, entries)?;
        writeln!(out, "\n[DummyUsage]")?;
        for number in 1..=7 {
            writeln!(out, "Dummy{number:04}=0")?;
        }
        writeln!(out, "\n[Comments]\nLines=0")?;
        let indices = indices(entries.clone());
        list(out, "MandatoryObjects", indices.clone().filter(|index| MANDATORY.contains(index)))?;
        let is_optional = |index: &u16| !MANDATORY.contains(index) && *index < MANUFACTURER;
        list(out, "OptionalObjects", indices.clone().filter(is_optional))?;
        list(out, "ManufacturerObjects", indices.clone().filter(|index| *index >= MANUFACTURER))?;
        for index in indices {
            let of_index = entries.clone().filter(|entry| entry.object.index == index);
            let record = of_index.clone().next().map_or("", |entry| entry.object.record);
            if !record.is_empty() {
                writeln!(out, "\n[{index:04X}]\nParameterName={record}")?;
                writeln!(out, "ObjectType=0x{}", if ARRAYS.contains(&index) { 8 } else { 9 })?;
                writeln!(out, "SubNumber={}", of_index.clone().count())?;
            }
            for entry in of_index {
                write_entry(out, &entry, config)?;
            }
        }
        Ok(())
    }
}

fn head(out: &mut impl Write, facts: &EdsFacts<'_>) -> fmt::Result {
    let EdsFacts { file_name, description, time, date, author, .. } = facts;
    writeln!(out, "[FileInfo]\nFileName={file_name}\nFileVersion=1\nFileRevision=0\nEDSVersion=4.0")?;
    writeln!(out, "Description={description}")?;
    writeln!(out, "CreationTime={time}\nCreationDate={date}\nCreatedBy={author}")?;
    writeln!(out, "ModificationTime={time}\nModificationDate={date}\nModifiedBy={author}")
}

fn device_info<'a, K: Copy>(
    out: &mut impl Write,
    facts: &EdsFacts<'_>,
    entries: &(impl Iterator<Item = EdsEntry<'a, K>> + Clone),
) -> fmt::Result {
    let EdsFacts { vendor, product, order_code, kbit_rates, .. } = facts;
    let identity = |sub: u8| {
        let is_it = |entry: &EdsEntry<'_, K>| (entry.object.index, entry.object.sub) == (0x1018, sub);
        match entries.clone().find(is_it).map(|entry| entry.object.source) {
            Some(Source::Fixed(number)) => number,
            _ => 0,
        }
    };
    let pdos =
        |first: u16, end: u16| indices(entries.clone()).filter(|index| (first..end).contains(index)).count();
    writeln!(out, "\n[DeviceInfo]\nVendorName={vendor}\nVendorNumber={}", identity(1))?;
    writeln!(out, "ProductName={product}\nProductNumber={}", identity(2))?;
    writeln!(out, "RevisionNumber={}\nOrderCode={order_code}", identity(3))?;
    for rate in RATES {
        writeln!(out, "BaudRate_{rate}={}", u8::from(kbit_rates.contains(&rate)))?;
    }
    writeln!(out, "SimpleBootUpMaster=0\nSimpleBootUpSlave=1\nGranularity=0")?;
    writeln!(out, "DynamicChannelsSupported=0\nGroupMessaging=0")?;
    writeln!(out, "NrOfRXPDO={}\nNrOfTXPDO={}", pdos(0x1400, 0x1600), pdos(0x1800, 0x1A00))?;
    writeln!(out, "LSS_Supported=0")
}

/// Returns each index once, in order. `entries` must be sorted.
fn indices<'a, K>(
    entries: impl Iterator<Item = EdsEntry<'a, K>> + Clone,
) -> impl Iterator<Item = u16> + Clone {
    let mut last = 0;
    entries.filter_map(move |entry| {
        let is_new = entry.object.index != last;
        last = entry.object.index;
        is_new.then_some(last)
    })
}

fn list(out: &mut impl Write, name: &str, indices: impl Iterator<Item = u16> + Clone) -> fmt::Result {
    writeln!(out, "\n[{name}]\nSupportedObjects={}", indices.clone().count())?;
    for (number, index) in (1u16..).zip(indices) {
        writeln!(out, "{number}=0x{index:04X}")?;
    }
    Ok(())
}

/// Writes an entry with its default value. Readers of the file substitute `$NODEID`.
fn write_entry<K: Copy, const T: usize>(
    out: &mut impl Write,
    entry: &EdsEntry<'_, K>,
    config: &Config<T>,
) -> fmt::Result {
    let Object { index, sub, kind, writable, mappable, name, record, source } = entry.object;
    if record.is_empty() {
        writeln!(out, "\n[{index:04X}]")?;
    } else {
        writeln!(out, "\n[{index:04X}sub{sub:X}]")?;
    }
    writeln!(out, "ParameterName={name}\nObjectType=0x7\nDataType=0x{:04X}", DataType::code(kind))?;
    let access = match source {
        Source::Rpdo { .. } => "rww",
        _ if kind == DataType::Domain => "wo",
        _ if writable => "rw",
        _ => "ro",
    };
    writeln!(out, "AccessType={access}")?;
    writeln!(out, "PDOMapping={}", u8::from(mappable))?;
    if let Some((least, most)) = entry.limits {
        writeln!(out, "LowLimit={least}\nHighLimit={most}")?;
    }
    let time = |times: &[u16; T], number: u8| times.get(usize::from(number)).copied().map(u32::from);
    let (prefix, number) = match (entry.default, source) {
        (Some(EdsValue::Text(text)), _) => return writeln!(out, "DefaultValue={text}"),
        (Some(EdsValue::Number(number)), _) => ("", Some(number)),
        (None, Source::Fixed(number) | Source::Mapping(number)) => ("", Some(number)),
        (None, Source::PlusNode(base)) => ("$NODEID+", Some(base)),
        (None, Source::CobId(pdo)) => ("$NODEID+", Some(pdo.base_cob_id())),
        (None, Source::TransmissionType(_)) => ("", Some(Pdo::EVENT_DRIVEN.into())),
        (None, Source::Mapped(_, count)) => ("", Some(count.into())),
        (None, Source::ProducerHeartbeat) => ("", Some(config.heartbeat_ms.into())),
        (None, Source::EmergencyInhibitTime) => ("", Some(config.emergency_inhibit.into())),
        (None, Source::InhibitTime(number)) => ("", time(&config.inhibit, number)),
        (None, Source::EventTimer(number)) => ("", time(&config.event_ms, number)),
        (None, Source::ErrorBehaviour | Source::ErrorCount) => ("", Some(0)),
        _ => ("", None),
    };
    match number {
        Some(number) => writeln!(out, "DefaultValue={prefix}0x{number:X}"),
        None => Ok(()),
    }
}
