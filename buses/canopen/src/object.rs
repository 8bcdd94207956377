//! Objects of the dictionary: one table for the SDO server, the EDS file and the application's documents.

use crate::Abort;

/// The type of an object (CiA 301, table 44).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DataType {
    /// INTEGER16.
    I16,
    /// UNSIGNED8.
    U8,
    /// UNSIGNED16.
    U16,
    /// UNSIGNED32.
    U32,
}

impl DataType {
    /// Its bytes on the bus.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "no type has no bytes")]
    pub const fn len(self) -> u8 {
        match self {
            Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 => 4,
        }
    }

    /// Its number in the dictionary.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::I16 => 3,
            Self::U8 => 5,
            Self::U16 => 6,
            Self::U32 => 7,
        }
    }
}

/// Where the value of an entry is. `K` names the values that the application has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source<K> {
    /// A number that never changes.
    Fixed(u32),
    /// A number with the node-ID added: a COB-ID.
    PlusNode(u32),
    /// The error register (1001h).
    ErrorRegister,
    /// The master's node-ID and the time within which its heartbeat must come (1016h, 1).
    ConsumerHeartbeat,
    /// The time between two heartbeats of the device (1017h).
    ProducerHeartbeat,
    /// The inhibit time of a TPDO, counted from 0 (1800h and on, 3).
    InhibitTime(u8),
    /// The event timer of a TPDO, counted from 0 (1800h and on, 5).
    EventTimer(u8),
    /// As many bytes as the entry's type has, of what an RPDO brought last.
    Rpdo {
        /// Which, counted from 0.
        number: u8,
        /// The first byte.
        at: u8,
    },
    /// The same, of what a TPDO shows.
    Tpdo {
        /// Which, counted from 0.
        number: u8,
        /// The first byte.
        at: u8,
    },
    /// A value of the application.
    Application(K),
}

/// An object of the dictionary, or one entry of an array or record.
#[derive(Clone, Copy, Debug)]
pub struct Object<K> {
    /// Its index.
    pub index: u16,
    /// Its subindex.
    pub sub: u8,
    /// Its type.
    pub kind: DataType,
    /// Whether a master may write it.
    pub writable: bool,
    /// Whether it can be part of a PDO.
    pub mappable: bool,
    /// Its name.
    pub name: &'static str,
    /// The name of the record that it is in; empty for an object without entries.
    pub record: &'static str,
    /// Where its value is.
    pub source: Source<K>,
}

/// What the SDO server needs to know of an object: the table without its words, which stay out of the image.
#[derive(Clone, Copy, Debug)]
pub struct Entry<K> {
    /// Its index.
    pub index: u16,
    /// Its subindex.
    pub sub: u8,
    /// Its type.
    pub kind: DataType,
    /// Whether a master may write it.
    pub writable: bool,
    /// Where its value is.
    pub source: Source<K>,
}

/// The entries of a table of objects, at compile time.
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

/// Looks an entry up in a table.
///
/// # Errors
/// [`Abort::NoObject`] if nothing has this index, [`Abort::NoSubindex`] if only the subindex does not exist.
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
