//! Objects of the dictionary: one table for the SDO server, the EDS file and the application's documents.

use crate::Abort;

/// Data type of an object (CiA 301, table 44).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DataType {
    /// INTEGER16: signed, two bytes.
    I16,
    /// UNSIGNED8: one byte.
    U8,
    /// UNSIGNED16: two bytes.
    U16,
    /// UNSIGNED32: four bytes.
    U32,
    /// VISIBLE_STRING: ASCII text, read in segments.
    Text,
    /// DOMAIN: any number of bytes, written in segments. It cannot be read.
    Domain,
}

impl DataType {
    /// Returns the length on the bus in bytes, or 0 for text and domains, whose length depends on their value.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "a number is never empty")]
    pub const fn len(self) -> u8 {
        match self {
            Self::Text | Self::Domain => 0,
            Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 => 4,
        }
    }

    /// Returns the index of the data type in the dictionary.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::I16 => 3,
            Self::U8 => 5,
            Self::U16 => 6,
            Self::U32 => 7,
            Self::Text => 9,
            Self::Domain => 15,
        }
    }
}

/// COB-ID of a PDO, bit 30: no remote frames. Ignored for RPDOs.
pub(crate) const NO_REMOTE: u32 = 1 << 30;

/// A PDO of the device, numbered from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pdo {
    /// An RPDO, which the device receives.
    Receive(u8),
    /// A TPDO, which the device sends.
    Transmit(u8),
}

impl Pdo {
    /// Transmission type at power-up: RPDOs take effect on reception, TPDOs are sent on change
    /// and by their event timer.
    pub(crate) const EVENT_DRIVEN: u8 = 255;

    /// Returns the COB-ID of an enabled PDO in the predefined connection set, without the node-ID. Bit 30 marks TPDOs
    /// as unavailable to remote frames.
    pub(crate) const fn base_cob_id(self) -> u32 {
        let (first, number, flags) = match self {
            Self::Receive(number) => (0x200, number, 0),
            Self::Transmit(number) => (0x180, number, NO_REMOTE),
        };
        u32::wrapping_add(first, (number as u32).wrapping_shl(8)) | flags
    }
}

/// Source of an entry's value. `K` identifies the application's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source<K> {
    /// A constant. A writable entry accepts only this number.
    Fixed(u32),
    /// A COB-ID: a number plus the node-ID. A writable entry accepts only the present value.
    PlusNode(u32),
    /// Error register (1001h).
    ErrorRegister,
    /// Number of past faults (1003h, 0). Writing 0 clears the history.
    ErrorCount,
    /// A past fault, numbered from 0 with the latest first (1003h, 1 and up). The lower 16 bits are its code, bits 16
    /// to 23 the last byte of its emergency.
    PastError(u8),
    /// Inhibit time of emergencies in 100 µs (1015h).
    EmergencyInhibitTime,
    /// State of the device after loss of the bus or the master (1029h, 1).
    ErrorBehaviour,
    /// Node-ID of the master and heartbeat time-out (1016h, 1).
    ConsumerHeartbeat,
    /// Period of the device's heartbeat in milliseconds (1017h).
    ProducerHeartbeat,
    /// COB-ID of a PDO (1400h, 1800h and up, 1). Bit 31 disables the PDO; the identifier is
    /// fixed by the predefined set.
    CobId(Pdo),
    /// Transmission type of a PDO (1400h, 1800h and up, 2).
    TransmissionType(Pdo),
    /// Number of objects mapped to a PDO (1600h, 1A00h and up, 0): this number, or 0 after
    /// a master cleared the mapping.
    Mapped(Pdo, u8),
    /// One mapped object of a PDO (1600h, 1A00h and up, 1 and up). Accepts only the present value.
    Mapping(u32),
    /// Inhibit time of a TPDO, numbered from 0 (1800h and up, 3). Can be changed only while the TPDO is disabled.
    InhibitTime(u8),
    /// Event timer of a TPDO, numbered from 0 (1800h and up, 5).
    EventTimer(u8),
    /// Data of the last RPDO in effect, as many bytes as the entry's type has. SDO writes are rejected unless they
    /// repeat the present value, because only the RPDO commands.
    Rpdo {
        /// Number of the RPDO, from 0.
        number: u8,
        /// Offset of the first byte.
        at: u8,
    },
    /// Present data of a TPDO, as many bytes as the entry's type has.
    Tpdo {
        /// Number of the TPDO, from 0.
        number: u8,
        /// Offset of the first byte.
        at: u8,
    },
    /// A value that the application supplies.
    Application(K),
}

/// An object of the dictionary, or one entry of an array or a record.
#[derive(Clone, Copy, Debug)]
pub struct Object<K> {
    /// Index in the dictionary.
    pub index: u16,
    /// Subindex; 0 for an object without entries.
    pub sub: u8,
    /// Data type of the value.
    pub kind: DataType,
    /// Whether a master may write it by SDO.
    pub writable: bool,
    /// Whether the object can be mapped to a PDO.
    pub mappable: bool,
    /// Parameter name in the EDS file.
    pub name: &'static str,
    /// Name of the containing array or record; empty for an object without entries.
    pub record: &'static str,
    /// Source of the value.
    pub source: Source<K>,
}

/// The part of an object that the SDO server needs. Keeps the names out of the image.
#[derive(Clone, Copy, Debug)]
pub struct Entry<K> {
    /// Index in the dictionary.
    pub index: u16,
    /// Subindex; 0 for an object without entries.
    pub sub: u8,
    /// Data type of the value.
    pub kind: DataType,
    /// Whether a master may write it by SDO.
    pub writable: bool,
    /// Source of the value.
    pub source: Source<K>,
}

/// Converts a table of objects to entries at compile time.
#[must_use]
pub const fn entries<K: Copy, const N: usize>(objects: &[Object<K>; N]) -> [Entry<K>; N] {
    let mut entries =
        [Entry { index: 0, sub: 0, kind: DataType::U8, writable: false, source: Source::Fixed(0) }; N];
    let mut at = 0;
    while at < N {
        #[expect(
            clippy::indexing_slicing,
            clippy::arithmetic_side_effects,
            reason = "the loop ends at the table's length"
        )]
        {
            let Object { index, sub, kind, writable, source, .. } = objects[at];
            entries[at] = Entry { index, sub, kind, writable, source };
            at += 1;
        }
    }
    entries
}

/// Finds an entry in a table.
///
/// # Errors
/// Returns [`Abort::NoObject`] if the index does not exist, [`Abort::NoSubindex`] if only the subindex does not exist.
pub fn find<K: Copy>(entries: &[Entry<K>], index: u16, sub: u8) -> Result<Entry<K>, Abort> {
    let mut missing = Abort::NoObject;
    for entry in entries {
        if entry.index == index {
            missing = Abort::NoSubindex;
            if entry.sub == sub {
                return Ok(*entry);
            }
        }
    }
    Err(missing)
}
