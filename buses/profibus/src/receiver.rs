//! From characters and silences to telegrams.

use crate::telegram::{
    LE, MAX_TELEGRAM_LEN, SC, SD1, SD1_LEN, SD2, SD2_HEAD_LEN, SD3, SD3_LEN, SD4, SD4_LEN, TAIL_LEN, Telegram,
};

/// T_SYN, the silence in front of every request, in bit times: what came before it is over.
pub const SYNC_BITS: u32 = 33;

/// What the line brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Character {
    /// A byte.
    Byte(u8),
    /// A parity or framing error, or a character that was lost before this one: the telegram around it is void.
    Damaged,
}

/// What the receiver has found so far. Each wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Intact telegrams with start delimiter 1, 2 or 3, for whatever station.
    pub telegrams: u32,
    /// What was none: a damaged character, a wrong delimiter, length or check sum, or a telegram that was cut short. Counted
    /// once for everything up to the next silence.
    pub damaged: u32,
}

/// Finds telegrams. One ends with the character that completes it; after anything else, the next begins after a silence of
/// [`SYNC_BITS`].
#[derive(Clone, Debug)]
pub(crate) struct Receiver {
    bytes: [u8; MAX_TELEGRAM_LEN],
    len: usize,
    /// Waits for silence.
    void: bool,
    counters: Counters,
}

impl Receiver {
    pub(crate) const fn new() -> Self {
        // What comes first may be the end of something.
        let counters = Counters { telegrams: 0, damaged: 0 };
        Self { bytes: [0; MAX_TELEGRAM_LEN], len: 0, void: true, counters }
    }

    pub(crate) const fn counters(&self) -> Counters {
        self.counters
    }

    /// Takes a character and the silence before it, in bit times. Returns the telegram that it completes. Token telegrams
    /// and short acknowledgements are over without a word.
    pub(crate) fn push(&mut self, character: Character, silence_bits: u32) -> Option<Telegram<'_>> {
        if silence_bits >= SYNC_BITS {
            if self.len > 0 {
                self.counters.damaged = self.counters.damaged.wrapping_add(1);
            }
            self.len = 0;
            self.void = false;
        }
        if self.void {
            return None;
        }
        let (Character::Byte(byte), Some(place)) = (character, self.bytes.get_mut(self.len)) else {
            self.discard();
            return None;
        };
        *place = byte;
        self.len = self.len.saturating_add(1);
        match self.expected_len() {
            None => self.discard(),
            Some(expected) if self.len < expected => {}
            Some(_) => return self.complete(),
        }
        None
    }

    /// How long what is held will be, as far as it shows; `None` if no telegram begins like this.
    fn expected_len(&self) -> Option<usize> {
        match self.bytes.get(..self.len)? {
            [SC, ..] => Some(1),
            [SD1, ..] => Some(SD1_LEN),
            [SD3, ..] => Some(SD3_LEN),
            [SD4, ..] => Some(SD4_LEN),
            [SD2] | [SD2, _] | [SD2, _, _] => Some(SD2_HEAD_LEN),
            [SD2, length, repeated, SD2, ..] if length == repeated && LE.contains(length) => {
                Some(usize::from(*length).saturating_add(SD2_HEAD_LEN + TAIL_LEN))
            }
            _ => None,
        }
    }

    fn complete(&mut self) -> Option<Telegram<'_>> {
        let len = core::mem::replace(&mut self.len, 0);
        let held = self.bytes.get(..len)?;
        if matches!(held, [SC | SD4, ..]) {
            return None;
        }
        let telegram = Telegram::parse(held);
        if telegram.is_some() {
            self.counters.telegrams = self.counters.telegrams.wrapping_add(1);
        } else {
            self.void = true;
            self.counters.damaged = self.counters.damaged.wrapping_add(1);
        }
        telegram
    }

    fn discard(&mut self) {
        self.len = 0;
        self.void = true;
        self.counters.damaged = self.counters.damaged.wrapping_add(1);
    }
}

#[cfg(test)]
mod tests;
