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

    /// Iterates over the registers in ascending order of address.
    pub fn iter(self) -> impl Iterator<Item = u16> + Clone + 'a {
        self.bytes.as_chunks().0.iter().map(|pair| u16::from_be_bytes(*pair))
    }
}

/// Returns bit n mod 8 of byte n div 8, or `None` past the end of `bytes`.
pub(super) fn bit(bytes: &[u8], n: usize) -> Option<bool> {
    Some(bytes.get(n / 8)? & (1 << (n % 8)) != 0)
}
