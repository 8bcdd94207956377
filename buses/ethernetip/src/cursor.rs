//! Reads and writes consecutive fields, never outside a buffer. Numbers are little-endian, socket addresses big-endian.

use core::net::{Ipv4Addr, SocketAddrV4};

/// Address family of IPv4 in a socket address.
const AF_INET: u8 = 2;

/// Reads fields from the front of a slice. All methods return `None` if too few bytes are left.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// Returns the bytes not read yet.
    pub(crate) const fn rest(&self) -> &'a [u8] {
        self.0
    }

    pub(crate) fn bytes(&mut self, len: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    /// Reads a socket address of IPv4.
    pub(crate) fn socket_address(&mut self) -> Option<SocketAddrV4> {
        let [0, AF_INET, high, low, a, b, c, d, ..] = self.array::<16>()? else { return None };
        Some(SocketAddrV4::new(Ipv4Addr::new(a, b, c, d), u16::from_be_bytes([high, low])))
    }
}

/// Copies bytes into a buffer at `at`. Returns the offset after them, or `None` if they do not fit.
pub(crate) fn copy(buffer: &mut [u8], at: usize, bytes: &[u8]) -> Option<usize> {
    let (place, _) = buffer.get_mut(at..)?.split_at_mut_checked(bytes.len())?;
    place.copy_from_slice(bytes);
    Some(at.saturating_add(bytes.len()))
}

/// Writes consecutive fields. Fields that do not fit are dropped, and [`finish`](Self::finish) returns `None`.
#[derive(Debug)]
pub(crate) struct Writer<'a> {
    buffer: &'a mut [u8],
    len: usize,
    is_short: bool,
}

impl<'a> Writer<'a> {
    pub(crate) const fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, len: 0, is_short: false }
    }

    pub(crate) const fn len(&self) -> usize {
        self.len
    }

    /// Returns whether fields were dropped.
    pub(crate) const fn is_short(&self) -> bool {
        self.is_short
    }

    /// Returns the number of bytes written, or `None` if the buffer was too short.
    pub(crate) fn finish(self) -> Option<usize> {
        (!self.is_short).then_some(self.len)
    }

    /// Removes everything after the first `len` bytes.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
        self.is_short = false;
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        match copy(self.buffer, self.len, bytes) {
            Some(end) => self.len = end,
            None => self.is_short = true,
        }
    }

    /// Writes the bytes that `fill` puts at the front of the free space. `fill` returns their number.
    pub(crate) fn bytes_with<E>(
        &mut self,
        fill: impl FnOnce(&mut [u8]) -> Result<usize, E>,
    ) -> Result<(), E> {
        let space = self.buffer.get_mut(self.len..).unwrap_or_default();
        let (room, count) = (space.len(), fill(space)?);
        self.is_short |= count > room;
        self.len = self.len.saturating_add(count.min(room));
        Ok(())
    }

    pub(crate) fn zeros(&mut self, count: usize) {
        for _ in 0..count {
            self.u8(0);
        }
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.bytes(&[value]);
    }

    pub(crate) fn u16(&mut self, value: u16) {
        self.bytes(&value.to_le_bytes());
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.bytes(&value.to_le_bytes());
    }

    /// Writes an address as CIP does: as a number.
    pub(crate) fn address(&mut self, address: Ipv4Addr) {
        self.u32(address.to_bits());
    }

    /// Writes a socket address of 16 bytes.
    pub(crate) fn socket_address(&mut self, address: SocketAddrV4) {
        self.bytes(&[0, AF_INET]);
        self.bytes(&address.port().to_be_bytes());
        self.bytes(&address.ip().octets());
        self.zeros(8);
    }

    /// Overwrites bytes written before.
    pub(crate) fn put(&mut self, at: usize, bytes: &[u8]) {
        // Bytes that did not fit cannot be overwritten.
        let _ = self.buffer.get_mut(..self.len).and_then(|written| copy(written, at, bytes));
    }

    /// Writes the length of the output of `body` in 16 bits, then the output.
    pub(crate) fn counted(&mut self, body: impl FnOnce(&mut Self)) {
        let at = self.len;
        self.u16(0);
        body(self);
        let len = self.len.saturating_sub(at).saturating_sub(2);
        self.put(at, &(len as u16).to_le_bytes());
    }
}
