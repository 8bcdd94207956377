//! Choices from the fuzzer's bytes.

/// Bytes consumed from the front, followed by zeros.
pub(super) struct Input<'a>(&'a [u8]);

impl<'a> Input<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn byte(&mut self) -> u8 {
        self.bytes(1).first().copied().unwrap_or(0)
    }

    /// Returns up to `count` bytes.
    pub(super) fn bytes(&mut self, count: usize) -> &'a [u8] {
        let (front, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        front
    }

    /// Returns fewer than `limit` bytes.
    pub(super) fn fewer_than(&mut self, limit: usize) -> &'a [u8] {
        let count = usize::from(self.byte()) % limit;
        self.bytes(count)
    }

    pub(super) fn array<const N: usize>(&mut self) -> [u8; N] {
        std::array::from_fn(|_| self.byte())
    }

    /// Returns one of these.
    pub(super) fn pick<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[usize::from(self.byte()) % choices.len()]
    }

    /// Changes some bytes or truncates the end, mostly neither. Returns whether it may have.
    pub(super) fn damage(&mut self, bytes: &mut Vec<u8>) -> bool {
        let how = self.byte();
        if how < 0xC0 {
            return false;
        }
        for _ in 0..how % 4 {
            let at = u16::from_be_bytes(self.array());
            let value = self.byte();
            let at = usize::from(at) % bytes.len().max(1);
            if let Some(byte) = bytes.get_mut(at) {
                *byte = value;
            }
        }
        if how >= 0xF0 {
            bytes.truncate(usize::from(u16::from_be_bytes(self.array())) % (bytes.len() + 1));
        }
        true
    }
}
