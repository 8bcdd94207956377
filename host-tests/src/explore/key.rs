//! Equality of states: a number for each state that is independent of absolute time.

use std::hash::{Hash, Hasher};

/// Age beyond which moments count as equally old, in milliseconds. The bridge's debounce time, frame time-out,
/// minimum of BUSY and grace period for a result are all shorter. Longer are only a motion's time-out of one minute
/// and the 600 ms of an unconfirmed FAST STOP. States that differ in nothing else count as equal.
const PAST_MS: i32 = 64;

/// A hasher that takes every [`Instant`](wsg_protocol::Instant) relative to now. Only an `Instant` hashes as `i32`.
struct KeyHasher {
    now_ms: u32,
    key: u64,
}

/// Returns the key of a state at this moment.
pub(super) fn key(now_ms: u32, state: &impl Hash) -> u64 {
    let mut hasher = KeyHasher { now_ms, key: SEED };
    state.hash(&mut hasher);
    hasher.finish()
}

const SEED: u64 = 0x9E37_79B9_7F4A_7C15;
const FACTOR: u64 = 0xD6E8_FEB8_6659_FD93;

impl KeyHasher {
    #[inline]
    fn mix(&mut self, word: u64) {
        let product = u128::from(self.key ^ word).wrapping_mul(u128::from(FACTOR));
        self.key = (product as u64 ^ (product >> 64) as u64).wrapping_add(SEED);
    }
}

macro_rules! mix_words {
    ($($write:ident: $word:ty),+) => {
        $(#[inline]
        fn $write(&mut self, word: $word) {
            self.mix(word as u64);
        })+
    };
}

impl Hasher for KeyHasher {
    #[inline]
    fn write(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        words.iter().for_each(|word| self.mix(u64::from_le_bytes(*word)));
        if !rest.is_empty() {
            self.mix(rest.iter().fold(1, |word, byte| word << 8 | u64::from(*byte)));
        }
    }

    mix_words! { write_u8: u8, write_u16: u16, write_u32: u32, write_usize: usize }

    #[inline]
    fn write_u64(&mut self, word: u64) {
        self.mix(word);
    }

    #[inline]
    fn write_i32(&mut self, moment: i32) {
        let age = moment.wrapping_sub(self.now_ms.cast_signed());
        self.mix(u64::from(age.max(-PAST_MS).cast_unsigned()));
    }

    #[inline]
    fn finish(&self) -> u64 {
        let mixed = u128::from(self.key).wrapping_mul(u128::from(FACTOR));
        mixed as u64 ^ (mixed >> 64) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::Instant;

    fn at(now_ms: u32, moment_ms: u32) -> u64 {
        key(now_ms, &(Instant::from_millis(moment_ms), 7u32))
    }

    #[test]
    fn moments_count_from_now() {
        assert_eq!(at(0, 5), at(1_000, 1_005));
        assert_eq!(at(u32::MAX, 4), at(0, 5));
        assert_ne!(at(0, 5), at(0, 6));
        assert_ne!(at(10, 5), at(11, 5));
    }

    #[test]
    fn keys_equate_long_past_moments_but_not_other_numbers() {
        assert_eq!(at(1_000, 5), at(1_000, 900));
        assert_ne!(key(1_000, &5u32), key(1_000, &900u32));
        assert_eq!(key(1_000, &5u32), key(2_000, &5u32));
    }
}
