//! Format of a record, as described in the parent module.

use crc::{CRC_32_ISO_HDLC, Crc, Table};

use super::error::Unreadable;
use super::flash::{NorFlash, Page};

/// Bitwise, because a table of 1 KiB would exceed all other code of the storage.
static CRC: Crc<u32, Table<0>> = Crc::<u32, Table<0>>::new(&CRC_32_ISO_HDLC);

pub(super) const ERASED: u64 = u64::MAX;

/// Bytes per double word.
pub(super) const BYTES: usize = 8;

/// Double words of a record in addition to its payload: the first and the last.
pub(super) const OVERHEAD: usize = 2;

/// Lowest byte of a record.
const MARK: u64 = 0xA5;

/// First double word of a record.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) len: u16,
    pub(super) version: u16,
    /// Up to [`Self::MAX_SEQUENCE`].
    pub(super) sequence: u32,
}

impl Header {
    /// Highest number of a save. Two pages of 256 double words with 10 000 erases each are worn before a sixth of it.
    pub(super) const MAX_SEQUENCE: u32 = 0xFF_FFFF;

    const fn from_bits(bits: u64) -> Option<Self> {
        if bits & 0xFF == MARK {
            Some(Self {
                len: (bits >> 8) as u16,
                version: (bits >> 24) as u16,
                sequence: (bits >> 40) as u32,
            })
        } else {
            None
        }
    }

    const fn bits(self) -> u64 {
        MARK | (self.len as u64) << 8 | (self.version as u64) << 24 | (self.sequence as u64) << 40
    }

    /// Returns the double words of the complete record.
    pub(super) const fn record_len(self) -> usize {
        OVERHEAD.saturating_add((self.len as usize).div_ceil(BYTES))
    }
}

/// Location of a record, without its payload.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Located {
    pub(super) page: Page,
    /// Index of the first double word.
    pub(super) index: usize,
    pub(super) header: Header,
    /// Last double word.
    pub(super) trailer: u64,
}

/// Content that starts at a double word.
pub(super) enum Found {
    Record(Located),
    /// No start of a record: erased, zero, or other data.
    Other(Result<u64, Unreadable>),
    /// First double word of a record whose rest is wrong.
    Damaged {
        header: Header,
        /// A later double word ends a record, so this one was once complete.
        is_ended: bool,
    },
}

impl Located {
    /// Returns the index after the record.
    pub(super) const fn end(&self) -> usize {
        self.index.saturating_add(self.header.record_len())
    }

    /// Returns double word `n` of the record with this payload.
    pub(super) fn double_word(&self, n: usize, payload: &[u8]) -> u64 {
        let Some(of_payload) = n.checked_sub(1) else { return self.header.bits() };
        if n.saturating_add(1) >= self.header.record_len() {
            return self.trailer;
        }
        let mut bytes = ERASED.to_le_bytes();
        for (byte, &of_payload) in bytes.iter_mut().zip(payload.iter().skip(of_payload.saturating_mul(BYTES)))
        {
            *byte = of_payload;
        }
        u64::from_le_bytes(bytes)
    }

    /// Returns whether the flash holds exactly this record with this payload.
    pub(super) fn is_stored<F: NorFlash>(&self, flash: &F, payload: &[u8]) -> bool {
        (0..self.header.record_len())
            .all(|n| flash.read(self.page, self.index.saturating_add(n)) == Ok(self.double_word(n, payload)))
    }
}

/// Running CRC over the double words of a record; 0 before the first.
#[derive(Clone, Copy)]
pub(super) struct Checksum(u32);

impl Checksum {
    pub(super) const fn new() -> Self {
        Self(0)
    }

    pub(super) fn push(&mut self, double_word: u64) {
        // Continues from the previous CRC. Its digest, which would also hold a reference to `CRC`, is the inverted CRC. The
        // initial value is given in the bit order of the polynomial.
        let mut digest = CRC.digest_with_initial((!self.0).reverse_bits());
        digest.update(&double_word.to_le_bytes());
        self.0 = digest.finalize();
    }

    /// Returns the last double word of a record after all others.
    pub(super) const fn trailer(self) -> u64 {
        self.0 as u64 | (!self.0 as u64) << 32
    }
}

/// Reads the content at `index`. Copies as much of the payload as fits into `payload`.
pub(super) fn read<F: NorFlash>(flash: &F, page: Page, index: usize, payload: &mut [u8]) -> Found {
    let first = flash.read(page, index);
    let Some((bits, header)) = first.ok().and_then(|bits| Some((bits, Header::from_bits(bits)?))) else {
        return Found::Other(first);
    };
    let last = header.record_len().saturating_sub(1);
    if index.saturating_add(last) >= F::PAGE_LEN {
        return Found::Other(first);
    }
    let mut checksum = Checksum::new();
    checksum.push(bits);
    let mut room = payload.chunks_mut(BYTES);
    let (mut is_readable, mut is_ended) = (true, false);
    for n in 1..last {
        let Ok(double_word) = flash.read(page, index.saturating_add(n)) else {
            is_readable = false;
            continue;
        };
        is_ended |= ends_record(double_word);
        checksum.push(double_word);
        for (byte, of_flash) in room.next().unwrap_or_default().iter_mut().zip(double_word.to_le_bytes()) {
            *byte = of_flash;
        }
    }
    let trailer = checksum.trailer();
    // Read once, because a double word whose programming was interrupted may read differently each time.
    let end = flash.read(page, index.saturating_add(last));
    if is_readable && end == Ok(trailer) {
        Found::Record(Located { page, index, header, trailer })
    } else {
        Found::Damaged { header, is_ended: is_ended || end.is_ok_and(ends_record) }
    }
}

/// Returns whether this may be the last double word of a record. While it is being programmed it is not, because it then has
/// more ones than zeros.
#[must_use]
pub const fn ends_record(double_word: u64) -> bool {
    double_word as u32 == !((double_word >> 32) as u32)
}
