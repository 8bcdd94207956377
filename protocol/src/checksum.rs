//! The checksum at the end of every frame (command set, 1.2.1 and appendix D).
//!
//! This is not a standard CRC. The manual combines the MSB-first table of polynomial 1021h with a right-shifting
//! update: `c = T[(c ^ b) & FFh] ^ (c >> 8)`, start value FFFFh, low byte sent first. No set of CRC parameters yields
//! these values, so the table is computed here, at compile time.
//!
//! The table is linear in its index: `T[b] = T[b & F0h] ^ T[b & 0Fh]`, and `T[b & F0h]` is the combination of two of
//! the first 16 entries. The feature `small-table` uses this to store 32 bytes instead of 512, at the cost of a few
//! instructions per byte.
//!
//! ```
//! use wsg_protocol::checksum;
//!
//! // The manual's first example: AAAAAA 01 0000, checksum 10E8h, sent as E8 10.
//! assert_eq!(checksum::of(&[0xAA, 0xAA, 0xAA, 0x01, 0x00, 0x00]), 0x10E8);
//! // The checksum of a whole frame, including its checksum field, is 0.
//! assert_eq!(checksum::of(&[0xAA, 0xAA, 0xAA, 0x01, 0x00, 0x00, 0xE8, 0x10]), 0);
//! ```

/// Start value of the checksum, before the first byte.
pub const START: u16 = 0xFFFF;

/// Checksum after the three preamble bytes AAh AAh AAh. Parsers start from it after they have found a preamble.
pub const AFTER_PREAMBLE: u16 = update(update(update(START, 0xAA), 0xAA), 0xAA);

/// Generator polynomial of the table, without its leading term.
const POLYNOMIAL: u16 = 0x1021;

/// Computes one entry of the MSB-first table.
const fn entry(index: u8) -> u16 {
    let mut value = (index as u16) << 8;
    let mut bit = 0u8;
    while bit < 8 {
        value = if value & 0x8000 == 0 { value << 1 } else { (value << 1) ^ POLYNOMIAL };
        bit = bit.wrapping_add(1);
    }
    value
}

/// Computes the first `N` entries of the table.
const fn entries<const N: usize>() -> [u16; N] {
    let mut table = [0; N];
    let mut index = 0usize;
    while index < N {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            table[index] = entry(index as u8);
        }
        index = index.wrapping_add(1);
    }
    table
}

#[cfg(not(feature = "small-table"))]
mod lookup {
    static TABLE: [u16; 256] = super::entries();

    #[expect(
        clippy::indexing_slicing,
        reason = "a u8 always indexes 256 entries, so no bounds check is generated"
    )]
    pub(super) fn table(index: u8) -> u16 {
        TABLE[index as usize]
    }
}

#[cfg(feature = "small-table")]
mod lookup {
    /// The first 16 entries, one for each value of four bits.
    static TABLE: [u16; 16] = super::entries();

    #[expect(
        clippy::indexing_slicing,
        reason = "four bits always index 16 entries, so no bounds check is generated"
    )]
    pub(super) fn table(index: u8) -> u16 {
        let high = TABLE[(index >> 4) as usize];
        (high << 4) ^ TABLE[((high >> 12) as u8 ^ (index & 0x0F)) as usize]
    }
}

/// Updates the checksum with one byte, without the table. Equal to [`push`], but usable at compile time.
#[must_use]
pub const fn update(value: u16, byte: u8) -> u16 {
    entry((value as u8) ^ byte) ^ (value >> 8)
}

/// Updates the checksum with one byte.
#[must_use]
#[cfg_attr(feature = "small-table", inline(never))]
#[cfg_attr(not(feature = "small-table"), inline)]
pub fn push(value: u16, byte: u8) -> u16 {
    lookup::table((value as u8) ^ byte) ^ (value >> 8)
}

/// Updates the checksum with a slice.
#[must_use]
#[inline]
pub fn push_slice(value: u16, bytes: &[u8]) -> u16 {
    let (chunks, rest) = bytes.as_chunks::<{ chunk::LEN }>();
    let value = chunks.iter().fold(value, |value, bytes| chunk::push(value, *bytes));
    rest.iter().fold(value, |value, &byte| push(value, byte))
}

/// Updates the checksum with `source` while copying it to the front of `target`, which must be at least as long.
#[inline]
pub(crate) fn push_copied(value: u16, source: &[u8], target: &mut [u8]) -> u16 {
    let mut value = value;
    let (chunks, rest) = source.as_chunks::<{ chunk::LEN }>();
    let (slots, _) = target.as_chunks_mut::<{ chunk::LEN }>();
    for (slot, bytes) in slots.iter_mut().zip(chunks) {
        *slot = *bytes;
        value = chunk::push(value, *bytes);
    }
    let done = source.len().wrapping_sub(rest.len());
    for (slot, &byte) in target.get_mut(done..).unwrap_or(&mut []).iter_mut().zip(rest) {
        *slot = byte;
        value = push(value, byte);
    }
    value
}

// Tests cover both chunk lengths on every processor.
#[cfg(any(feature = "small-table", not(target_pointer_width = "64")))]
use chunk_of_4 as chunk;
#[cfg(not(any(feature = "small-table", not(target_pointer_width = "64"))))]
use chunk_of_8 as chunk;

/// Updates the checksum with several bytes at once.
///
/// [`push`] is linear, so the checksum and all bytes share one word that is shifted by a byte per step. Only the table
/// look-ups are made byte by byte.
#[cfg(any(test, feature = "small-table", not(target_pointer_width = "64")))]
mod chunk_of_4 {
    use super::lookup;

    pub(super) const LEN: usize = 4;

    #[inline]
    pub(super) fn push(value: u16, bytes: [u8; LEN]) -> u16 {
        let word = u32::from_le_bytes(bytes) ^ u32::from(value);
        let word = (0..LEN).fold(word, |word, _| (word >> 8) ^ u32::from(lookup::table(word as u8)));
        word as u16
    }
}

/// Updates the checksum with several bytes at once, for targets with enough flash. Each byte of the word has its own
/// table (4 KiB in total), so no look-up depends on the previous one.
#[cfg(any(test, not(any(feature = "small-table", not(target_pointer_width = "64")))))]
mod chunk_of_8 {
    pub(super) const LEN: usize = 8;

    /// The contribution of a byte that is followed by `index` more bytes.
    static TABLES: [[u16; 256]; LEN] = {
        let mut tables = [[0; 256]; LEN];
        let mut index = 0usize;
        while index < 256 {
            let mut value = super::update(0, index as u8);
            let mut behind = 0usize;
            while behind < LEN {
                #[expect(
                    clippy::indexing_slicing,
                    reason = "the loops end at the tables' length, at compile time"
                )]
                {
                    tables[behind][index] = value;
                }
                value = super::update(value, 0);
                behind = behind.wrapping_add(1);
            }
            index = index.wrapping_add(1);
        }
        tables
    };

    #[inline]
    pub(super) fn push(value: u16, bytes: [u8; LEN]) -> u16 {
        let word = (u64::from_le_bytes(bytes) ^ u64::from(value)).to_le_bytes();
        #[expect(
            clippy::indexing_slicing,
            reason = "a u8 always indexes 256 entries, so no bounds check is generated"
        )]
        let part = |(table, byte): (&[u16; 256], u8)| table[byte as usize];
        TABLES.iter().rev().zip(word).map(part).fold(0, |sum, part| sum ^ part)
    }
}

/// Returns the checksum of a whole message, including its preamble.
#[must_use]
pub fn of(bytes: &[u8]) -> u16 {
    push_slice(START, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_entries_are_those_of_the_manual() {
        for (index, printed) in
            [(0, 0x0000), (1, 0x1021), (2, 0x2042), (31, 0xE3DE), (128, 0x9188), (255, 0x1EF0)]
        {
            assert_eq!(lookup::table(index), printed, "T[{index}]");
        }
    }

    #[test]
    fn table_and_bitwise_update_agree_for_every_byte() {
        for byte in 0..=255 {
            for value in [0u16, 1, 0x50F5, 0xABCD, 0xFFFF] {
                assert_eq!(push(value, byte), update(value, byte));
            }
        }
    }

    #[test]
    fn table_is_linear_so_16_entries_serve() {
        for index in 0..=255 {
            let high = entry(index >> 4);
            assert_eq!(entry(index & 0xF0), (high << 4) ^ entry((high >> 12) as u8));
            assert_eq!(entry(index), entry(index & 0xF0) ^ entry(index & 0x0F));
        }
    }

    #[test]
    fn slices_are_taken_in_like_their_bytes_at_every_length() {
        let bytes: std::vec::Vec<u8> = (0..40u8).map(|n| n.wrapping_mul(37) ^ 0x5A).collect();
        for length in 0..=bytes.len() {
            for value in [0, START, AFTER_PREAMBLE] {
                let slice = &bytes[..length];
                let by_byte = slice.iter().fold(value, |value, &byte| update(value, byte));
                assert_eq!(push_slice(value, slice), by_byte, "{length} bytes");
                let mut copy = [0xEE; 40];
                assert_eq!(push_copied(value, slice, &mut copy[..length]), by_byte, "{length} bytes");
                assert!(copy[..length] == *slice && copy[length..].iter().all(|&byte| byte == 0xEE));
            }
        }
    }

    /// Asserts that both chunk lengths give the same result as their bytes one by one.
    #[track_caller]
    fn assert_chunks_agree(value: u16, bytes: [u8; chunk_of_8::LEN]) {
        let by_byte = |bytes: &[u8]| bytes.iter().fold(value, |value, &byte| update(value, byte));
        let [a, b, c, d, ..] = bytes;
        assert_eq!(chunk_of_4::push(value, [a, b, c, d]), by_byte(&[a, b, c, d]), "{value:04X} {bytes:02X?}");
        assert_eq!(chunk_of_8::push(value, bytes), by_byte(&bytes), "{value:04X} {bytes:02X?}");
    }

    #[test]
    fn chunks_of_either_length_are_taken_in_like_their_bytes() {
        for n in 0..1_000u128 {
            // Reproducible pseudo-random bits: multiples of the golden ratio.
            let bits = n.wrapping_mul(0x9E37_79B9_7F4A_7C15_F39C_C060_5CED_C835);
            assert_chunks_agree((bits >> 112) as u16, (bits as u64).to_le_bytes());
        }
    }

    #[test]
    fn preamble_leaves_50f5h() {
        assert_eq!(AFTER_PREAMBLE, 0x50F5);
        assert_eq!(of(&[0xAA; 3]), AFTER_PREAMBLE);
    }

    #[test]
    fn appending_the_checksum_low_byte_first_leaves_zero() {
        let mut bytes = std::vec![0x12, 0xAA, 0x00, 0xFF, 0x7E];
        let [low, high] = of(&bytes).to_le_bytes();
        bytes.extend([low, high]);
        assert_eq!(of(&bytes), 0);
    }
}
