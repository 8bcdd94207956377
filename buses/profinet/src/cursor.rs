//! Reads and writes consecutive fields of frames, never outside a buffer.

/// Byte order of a number. In RPC each side chooses its own; everything else is big-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    BigEndian,
    LittleEndian,
}

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

    pub(crate) fn skip(&mut self, len: usize) -> Option<()> {
        self.bytes(len).map(|_| ())
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_be_bytes)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_be_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_be_bytes)
    }

    pub(crate) fn u16_in(&mut self, order: Order) -> Option<u16> {
        self.u16().map(|value| if order == Order::BigEndian { value } else { value.swap_bytes() })
    }

    pub(crate) fn u32_in(&mut self, order: Order) -> Option<u32> {
        self.u32().map(|value| if order == Order::BigEndian { value } else { value.swap_bytes() })
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

    /// Returns the number of bytes written, or `None` if the buffer was too short.
    pub(crate) fn finish(self) -> Option<usize> {
        (!self.is_short).then_some(self.len)
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        match copy(self.buffer, self.len, bytes) {
            Some(end) => self.len = end,
            None => self.is_short = true,
        }
    }

    pub(crate) fn fill(&mut self, byte: u8, count: usize) {
        for _ in 0..count {
            self.bytes(&[byte]);
        }
    }

    /// Writes zeros up to a multiple of `unit` bytes, counted from offset `from`.
    pub(crate) fn align(&mut self, from: usize, unit: usize) {
        while !self.is_short && !self.len.saturating_sub(from).is_multiple_of(unit) {
            self.u8(0);
        }
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.bytes(&[value]);
    }

    pub(crate) fn u16(&mut self, value: u16) {
        self.bytes(&value.to_be_bytes());
    }

    pub(crate) fn u16s(&mut self, values: &[u16]) {
        for value in values {
            self.u16(*value);
        }
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.bytes(&value.to_be_bytes());
    }

    pub(crate) fn u16_in(&mut self, order: Order, value: u16) {
        self.u16(if order == Order::BigEndian { value } else { value.swap_bytes() });
    }

    pub(crate) fn u32_in(&mut self, order: Order, value: u32) {
        self.u32(if order == Order::BigEndian { value } else { value.swap_bytes() });
    }

    /// Writes a count of 0 for [`count_one`](Self::count_one), and returns its offset.
    pub(crate) fn begin_count(&mut self) -> usize {
        let at = self.len;
        self.u16(0);
        at
    }

    /// Increments a count written before.
    pub(crate) fn count_one(&mut self, at: usize) {
        if let Some(count) = self.buffer.get_mut(at..self.len).and_then(|rest| rest.first_chunk_mut()) {
            *count = u16::from_be_bytes(*count).saturating_add(1).to_be_bytes();
        }
    }

    /// Overwrites a number written before.
    pub(crate) fn put_u16(&mut self, at: usize, value: u16) {
        self.put(at, &value.to_be_bytes());
    }

    pub(crate) fn put(&mut self, at: usize, bytes: &[u8]) {
        // Bytes that did not fit cannot be overwritten.
        let _ = self.buffer.get_mut(..self.len).and_then(|written| copy(written, at, bytes));
    }

    /// Writes a block of the application layer: type, length of the rest, version 1.`minor`, and the output of `body`.
    pub(crate) fn block(&mut self, kind: u16, minor: u8, body: impl FnOnce(&mut Self)) {
        self.u16(kind);
        let length_at = self.len;
        self.u16(0);
        self.bytes(&[1, minor]);
        body(self);
        let length = self.len.saturating_sub(length_at).saturating_sub(2);
        self.put_u16(length_at, length as u16);
    }

    /// Writes text into a field of `len` bytes, padded with blanks.
    pub(crate) fn text(&mut self, text: &[u8], len: usize) {
        let text = text.get(..len).unwrap_or(text);
        self.bytes(text);
        self.fill(b' ', len.saturating_sub(text.len()));
    }
}
