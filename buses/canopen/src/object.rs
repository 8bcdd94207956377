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
    /// VISIBLE_STRING.
    Text,
}

impl DataType {
    /// Its bytes on the bus; 0 for a text, which has as many as its value.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "no number has no bytes")]
    pub const fn len(self) -> u8 {
        match self {
            Self::Text => 0,
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
            Self::Text => 9,
        }
    }
}

/// COB-ID of a PDO, bit 30: no remote frames. Of an RPDO it means nothing.
pub(crate) const NO_REMOTE: u32 = 1 << 30;

/// A PDO of the device, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pdo {
    /// An RPDO.
    Receive(u8),
    /// A TPDO.
    Transmit(u8),
}

impl Pdo {
    /// The transmission type at power-up: an RPDO counts when it comes, a TPDO is sent on change and by its event timer.
    pub(crate) const EVENT_DRIVEN: u8 = 255;

    /// The COB-ID of an enabled one in the predefined connection set, without the node-ID. A TPDO cannot be asked for by a
    /// remote frame, which bit 30 says.
    pub(crate) const fn base_cob_id(self) -> u32 {
        let (first, number, flags) = match self {
            Self::Receive(number) => (0x200, number, 0),
            Self::Transmit(number) => (0x180, number, NO_REMOTE),
        };
        u32::wrapping_add(first, (number as u32).wrapping_shl(8)) | flags
    }
}

/// Where the value of an entry is. `K` names the values that the application has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source<K> {
    /// A number that never changes. Where the entry is writable, it takes this number again and nothing else.
    Fixed(u32),
    /// A number with the node-ID added: a COB-ID. Where the entry is writable, it takes the same again.
    PlusNode(u32),
    /// The error register (1001h).
    ErrorRegister,
    /// How many past faults there are (1003h, 0); writing 0 forgets them.
    ErrorCount,
    /// A past fault, counted from 0, the last first (1003h, 1 and on): its code, and in bits 16 to 23 the last byte that its
    /// emergency carried.
    PastError(u8),
    /// The least time between two emergencies in 100 µs (1015h).
    EmergencyInhibitTime,
    /// What becomes of the device's state when the bus or the master is lost (1029h, 1).
    ErrorBehaviour,
    /// The master's node-ID and the time within which its heartbeat must come (1016h, 1).
    ConsumerHeartbeat,
    /// The time between two heartbeats of the device (1017h).
    ProducerHeartbeat,
    /// The COB-ID of a PDO (1400h, 1800h and on, 1). Bit 31 disables it; the identifier is that of the predefined set.
    CobId(Pdo),
    /// When a PDO is taken or sent (1400h, 1800h and on, 2).
    TransmissionType(Pdo),
    /// How many objects a PDO carries (1600h, 1A00h and on, 0): this number, or 0 while it is disabled.
    Mapped(Pdo, u8),
    /// What a PDO carries at one place (1600h, 1A00h and on, 1 and on). It takes the same again.
    Mapping(u32),
    /// The inhibit time of a TPDO, counted from 0 (1800h and on, 3). It changes only while the TPDO is disabled.
    InhibitTime(u8),
    /// The event timer of a TPDO, counted from 0 (1800h and on, 5).
    EventTimer(u8),
    /// As many bytes as the entry's type has, of what an RPDO brought last. By SDO it takes the same again: only the RPDO
    /// commands.
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
    /// Whether a master may write it by SDO.
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
