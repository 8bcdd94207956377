//! Telegram detection from characters and silences.

use crate::telegram::{
    LE, MAX_TELEGRAM_LEN, SC, SD1, SD1_LEN, SD2, SD2_HEAD_LEN, SD3, SD3_LEN, SD4, SD4_LEN, TAIL_LEN, Telegram,
};

/// T_SYN, the silence before every request, in bit times. It ends any previous telegram.
pub const SYNC_BITS: u32 = 33;

/// A character received from the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Character {
    /// A byte without line errors.
    Byte(u8),
    /// A parity or framing error, or an overrun before this character. The telegram that contains it is invalid.
    Damaged,
}

impl Character {
    /// Returns whether a transceiver that switches over may have caused this character: 00h, FFh, or a break. Between
    /// telegrams, such a character is no telegram of another station.
    #[must_use]
    pub const fn is_stray(self) -> bool {
        matches!(self, Self::Byte(0x00 | 0xFF) | Self::Damaged)
    }
}

/// Statistics of the receiver. Each counter wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Intact telegrams with start delimiter 1, 2 or 3, for any station.
    pub telegrams: u32,
    /// Damaged characters, wrong delimiters, lengths or check sums, and truncated telegrams. Counted once for
    /// everything up to the next silence. [Strays](Character::is_stray) between telegrams count as well.
    pub damaged: u32,
}

/// Detects telegrams. A telegram ends with its last character. The next one starts after it, or after strays of a
/// transceiver. After anything else, the next one starts after a silence of [`SYNC_BITS`].
#[derive(Clone, Debug)]
pub(crate) struct Receiver {
    bytes: [u8; MAX_TELEGRAM_LEN],
    len: usize,
    /// Ignores characters until the next silence.
    void: bool,
    /// Damage since the last silence has been counted.
    is_counted: bool,
    counters: Counters,
}

impl Receiver {
    pub(crate) const fn new() -> Self {
        // The first characters may be the end of a telegram.
        let counters = Counters { telegrams: 0, damaged: 0 };
        Self { bytes: [0; MAX_TELEGRAM_LEN], len: 0, void: true, is_counted: false, counters }
    }

    pub(crate) const fn counters(&self) -> Counters {
        self.counters
    }

    /// Processes a character and the silence before it, in bit times. Returns the telegram that it completes. Discards
    /// token telegrams and short acknowledgements.
    pub(crate) fn push(&mut self, character: Character, silence_bits: u32) -> Option<Telegram<'_>> {
        if silence_bits >= SYNC_BITS {
            if self.len > 0 {
                self.count_damage();
            }
            self.len = 0;
            self.void = false;
            self.is_counted = false;
        }
        if self.void {
            return None;
        }
        if self.len == 0 && character.is_stray() {
            self.count_damage();
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

    /// Returns the length of the telegram, as far as its first bytes determine it; `None` if
    /// no telegram starts with them.
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
            count_once(&mut self.is_counted, &mut self.counters.damaged);
        }
        telegram
    }

    fn discard(&mut self) {
        self.len = 0;
        self.void = true;
        self.count_damage();
    }

    const fn count_damage(&mut self) {
        count_once(&mut self.is_counted, &mut self.counters.damaged);
    }
}

const fn count_once(is_counted: &mut bool, counter: &mut u32) {
    if !*is_counted {
        *is_counted = true;
        *counter = counter.wrapping_add(1);
    }
}

#[cfg(test)]
mod tests;
