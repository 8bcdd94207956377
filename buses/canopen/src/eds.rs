//! The EDS file (CiA 306), from the table that the server uses.

use core::fmt::{self, Write};

use crate::{Config, DataType, Object, Pdo, Source};

/// Objects that every device has (CiA 306: mandatory); those from 2000h on are the manufacturer's.
const MANDATORY: [u16; 3] = [0x1000, 0x1001, 0x1018];
const MANUFACTURER: u16 = 0x2000;

/// Objects with entries of one type, which CiA 301 has as arrays; those with entries of several are records.
const ARRAYS: [u16; 3] = [0x1003, 0x1016, 0x1029];

/// The rates that an EDS file speaks of, in kbit/s.
const RATES: [u16; 8] = [10, 20, 50, 125, 250, 500, 800, 1000];

/// What an EDS file says besides the objects. Vendor, product and revision number are those of object 1018h.
#[derive(Clone, Copy, Debug)]
pub struct EdsFacts<'a> {
    /// The name of the file.
    pub file_name: &'a str,
    /// What the device is.
    pub description: &'a str,
    /// When the file was made: `12:00AM`.
    pub time: &'a str,
    /// The day: `01-31-2026`.
    pub date: &'a str,
    /// Who made it.
    pub author: &'a str,
    /// Who makes the device.
    pub vendor: &'a str,
    /// The name of the device.
    pub product: &'a str,
    /// How it is ordered.
    pub order_code: &'a str,
    /// The rates that it can be set to, in kbit/s, of 10, 20, 50, 125, 250, 500, 800 and 1000.
    pub kbit_rates: &'a [u16],
}

/// An entry as the file has it: an object of the dictionary, which values a master may write, and what it holds at power-up.
#[derive(Clone, Copy, Debug)]
pub struct EdsEntry<'a, K> {
    /// The object.
    pub object: Object<K>,
    /// The least and the greatest value, where they are known.
    pub limits: Option<(u16, u16)>,
    /// Its value at power-up, where the table does not say it.
    pub default: Option<EdsValue<'a>>,
}

impl<K: Copy> EdsEntry<'_, K> {
    /// An entry of which nothing else is known.
    #[must_use]
    pub const fn new(object: Object<K>) -> Self {
        Self { object, limits: None, default: None }
    }
}

/// What an entry holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdsValue<'a> {
    /// A number; of one with a sign, the bits of its two's complement.
    Number(u32),
    /// A text.
    Text(&'a str),
}

/// The EDS file of a device with this configuration, as text.
#[derive(Clone, Copy, Debug)]
pub struct Eds<'a, I, const T: usize> {
    /// What it says besides the objects.
    pub facts: EdsFacts<'a>,
    /// The entries, in the order of the dictionary.
    pub entries: I,
    /// What the device has at power-up.
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

/// Every index once, in order.
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

/// An entry with what it holds at power-up. `$NODEID` is replaced by whoever reads the file.
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
