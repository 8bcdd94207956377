//! Application data of a server: four tables of bits and registers, and an identification.

use super::{Exception, Identification};

/// The application data that a server exposes.
///
/// Reads query one item at a time; the data must not change within one request. Each write is passed in one call and
/// must be applied completely or rejected. Return [`Exception::IllegalDataAddress`] for an address that does not exist.
pub trait Device {
    /// Returns the coil at this address (FC 1).
    ///
    /// # Errors
    /// Returns the exception to send as the response.
    fn coil(&self, address: u16) -> Result<bool, Exception>;

    /// Returns the discrete input at this address (FC 2).
    ///
    /// # Errors
    /// Returns the exception to send as the response.
    fn discrete_input(&self, address: u16) -> Result<bool, Exception>;

    /// Returns the holding register at this address (FC 3, 22, 23).
    ///
    /// # Errors
    /// Returns the exception to send as the response.
    fn holding_register(&self, address: u16) -> Result<u16, Exception>;

    /// Returns the input register at this address (FC 4).
    ///
    /// # Errors
    /// Returns the exception to send as the response.
    fn input_register(&self, address: u16) -> Result<u16, Exception>;

    /// Writes consecutive coils, starting at address `first` (FC 5, 15).
    ///
    /// # Errors
    /// Returns the exception to send as the response, and leaves all coils unchanged.
    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception>;

    /// Writes consecutive holding registers, starting at address `first` (FC 6, 16, 22, 23).
    ///
    /// # Errors
    /// Returns the exception to send as the response, and leaves all registers unchanged.
    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception>;

    /// Writes all records of a request (FC 21). The response repeats the request.
    ///
    /// # Errors
    /// Returns the exception to send as the response, and leaves all files unchanged; by default always
    /// [`Exception::IllegalFunction`].
    fn write_file_records(&mut self, _: FileRecords<'_>) -> Result<(), Exception> {
        Err(Exception::IllegalFunction)
    }

    /// Returns the outcome of the last successful [`write_file_records`](Self::write_file_records), for a device whose
    /// writes take time. `None` means that the write is in progress and defers the response.
    ///
    /// [`rtu::Server`](crate::rtu::Server) calls this after the write, and repeats it in each call of
    /// [`silence`](crate::rtu::Server::silence) until the client sends another request. [`serve`](crate::serve) responds at once.
    ///
    /// # Errors
    /// Returns the exception to send if the write failed.
    fn outcome(&self) -> Option<Result<(), Exception>> {
        Some(Ok(()))
    }

    /// Returns the device identification (FC 43/14; on a serial line also FC 17).
    fn identification(&self) -> Identification;
}

/// Bits of a request. Bit n is bit n mod 8 of byte n div 8.
///
/// ```
/// use bus_modbus::Bits;
///
/// let bits = Bits::new(&[0b1000_0001, 0b10], 10);
/// assert_eq!(bits.iter().filter(|set| *set).count(), 3);
/// assert_eq!(bits.len(), 10);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bits<'a> {
    bytes: &'a [u8],
    len: u16,
}

impl<'a> Bits<'a> {
    /// Creates a view of the first `len` bits of `bytes`. Bits past the end of `bytes` read as 0.
    #[must_use]
    pub const fn new(bytes: &'a [u8], len: u16) -> Self {
        Self { bytes, len }
    }

    /// Returns the number of bits.
    #[must_use]
    pub const fn len(self) -> u16 {
        self.len
    }

    /// Returns whether there are no bits.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.len == 0
    }

    /// Iterates over the bits in ascending order of address.
    pub fn iter(self) -> impl Iterator<Item = bool> + 'a {
        let bytes = self.bytes;
        (0..usize::from(self.len)).map(move |n| bit(bytes, n).unwrap_or(false))
    }
}

/// Registers of a request, each with its high byte first.
///
/// ```
/// use bus_modbus::Words;
///
/// let words = Words::new(&[0x01, 0x20, 0x04, 0xC4]);
/// assert!(words.iter().eq([0x0120, 1220]));
/// assert_eq!(words.len(), 2);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Words<'a> {
    bytes: &'a [u8],
}

impl<'a> Words<'a> {
    /// Creates a view of the registers in `bytes`. An odd trailing byte is ignored.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// Returns the number of registers.
    #[must_use]
    pub const fn len(self) -> usize {
        self.bytes.len() / 2
    }

    /// Returns whether there are no registers.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Returns the bytes as sent, the high byte of each register first.
    #[must_use]
    pub const fn as_bytes(self) -> &'a [u8] {
        self.bytes
    }

    /// Iterates over the registers in ascending order of address.
    pub fn iter(self) -> impl Iterator<Item = u16> + Clone + 'a {
        self.bytes.as_chunks().0.iter().map(|pair| u16::from_be_bytes(*pair))
    }
}

/// Consecutive records of a file: a group of a Write File Record request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileRecord<'a> {
    /// Number of the file, from 1.
    pub file: u16,
    /// Number of the first record, 0 to 9999.
    pub first: u16,
    /// A register for each record.
    pub values: Words<'a>,
}

/// Groups of a Write File Record request (FC 21), which all exist according to the specification.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileRecords<'a> {
    groups: &'a [u8],
}

impl<'a> FileRecords<'a> {
    /// Checks the groups of a request.
    pub(super) fn new(groups: &'a [u8]) -> Result<Self, Exception> {
        let mut rest = groups;
        while !rest.is_empty() {
            let (_, record, others) = group(rest).ok_or(Exception::IllegalDataValue)?;
            if record.values.is_empty() {
                return Err(Exception::IllegalDataValue);
            }
            rest = others;
        }
        rest = groups;
        while let Some((reference, FileRecord { file, first, values }, others)) = group(rest) {
            let end = usize::from(first).saturating_add(values.len());
            if reference != REFERENCE_TYPE || file == 0 || end > RECORDS {
                return Err(Exception::IllegalDataAddress);
            }
            rest = others;
        }
        Ok(Self { groups })
    }

    /// Iterates over the groups in the order of the request.
    pub fn iter(self) -> impl Iterator<Item = FileRecord<'a>> + 'a {
        let mut rest = self.groups;
        core::iter::from_fn(move || {
            let (_, record, others) = group(rest)?;
            rest = others;
            Some(record)
        })
    }
}

/// Reference type of each group (specification, 6.15).
const REFERENCE_TYPE: u8 = 6;

/// Number of records in a file.
const RECORDS: usize = 10_000;

/// Splits off the first group, with its reference type. Returns `None` if it is not complete.
fn group(groups: &[u8]) -> Option<(u8, FileRecord<'_>, &[u8])> {
    let (&[reference, f1, f0, r1, r0, n1, n0], rest) = groups.split_first_chunk()?;
    let len = usize::from(u16::from_be_bytes([n1, n0])).saturating_mul(2);
    let (values, rest) = rest.split_at_checked(len)?;
    let (file, first) = (u16::from_be_bytes([f1, f0]), u16::from_be_bytes([r1, r0]));
    Some((reference, FileRecord { file, first, values: Words::new(values) }, rest))
}

/// Returns bit n mod 8 of byte n div 8, or `None` past the end of `bytes`.
pub(super) fn bit(bytes: &[u8], n: usize) -> Option<bool> {
    Some(bytes.get(n / 8)? & (1 << (n % 8)) != 0)
}
