//! What a server serves: four tables of bits and registers, and a name.

use super::{Exception, Identification};

/// The data behind a server.
///
/// A read asks item by item; nothing changes between the items of one request. A write comes whole: it is carried out
/// as one, or refused as one. An address that does not exist is [`Exception::IllegalDataAddress`].
pub trait Device {
    /// The coil at this address (FC 1).
    ///
    /// # Errors
    /// The exception to answer with.
    fn coil(&self, address: u16) -> Result<bool, Exception>;

    /// The discrete input at this address (FC 2).
    ///
    /// # Errors
    /// The exception to answer with.
    fn discrete_input(&self, address: u16) -> Result<bool, Exception>;

    /// The holding register at this address (FC 3, 22, 23).
    ///
    /// # Errors
    /// The exception to answer with.
    fn holding_register(&self, address: u16) -> Result<u16, Exception>;

    /// The input register at this address (FC 4).
    ///
    /// # Errors
    /// The exception to answer with.
    fn input_register(&self, address: u16) -> Result<u16, Exception>;

    /// Writes coils from this address on (FC 5, 15).
    ///
    /// # Errors
    /// The exception to answer with; then nothing was written.
    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception>;

    /// Writes holding registers from this address on (FC 6, 16, 22, 23).
    ///
    /// # Errors
    /// The exception to answer with; then nothing was written.
    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception>;

    /// What the server calls itself (FC 43/14; on a serial line also FC 17).
    fn identification(&self) -> Identification;
}

/// Bits of a request: bit n is bit n mod 8 of byte n div 8.
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
    /// The first `len` bits of these bytes; bits that are not there are 0.
    #[must_use]
    pub const fn new(bytes: &'a [u8], len: u16) -> Self {
        Self { bytes, len }
    }

    /// How many there are.
    #[must_use]
    pub const fn len(self) -> u16 {
        self.len
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.len == 0
    }

    /// One after the other.
    pub fn iter(self) -> impl Iterator<Item = bool> + 'a {
        let bytes = self.bytes;
        (0..usize::from(self.len)).map(move |n| bit(bytes, n).unwrap_or(false))
    }
}

/// Registers of a request: each high byte first.
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
    /// The registers in these bytes; an odd byte at the end is none.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// How many there are.
    #[must_use]
    pub const fn len(self) -> usize {
        self.bytes.len() / 2
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// One after the other.
    pub fn iter(self) -> impl Iterator<Item = u16> + Clone + 'a {
        self.bytes.as_chunks().0.iter().map(|pair| u16::from_be_bytes(*pair))
    }
}

/// Bit n mod 8 of byte n div 8.
pub(super) fn bit(bytes: &[u8], n: usize) -> Option<bool> {
    Some(bytes.get(n / 8)? & (1 << (n % 8)) != 0)
}
