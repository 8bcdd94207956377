//! The format of a record: see the module above.

use crc::{CRC_32_ISO_HDLC, Crc, Table};

use super::flash::{NorFlash, Page, Unreadable};

/// Bit by bit: a table of 1 KiB would be more than all other code of the storage.
static CRC: Crc<u32, Table<0>> = Crc::<u32, Table<0>>::new(&CRC_32_ISO_HDLC);

pub(super) const ERASED: u64 = u64::MAX;

/// Bytes in a double word.
pub(super) const BYTES: usize = 8;

/// Double words of a record beside its payload: the first and the last.
pub(super) const OVERHEAD: usize = 2;

/// The lowest byte of a record.
const MARK: u64 = 0xA5;

/// The first double word of a record.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) len: u16,
    pub(super) version: u16,
    /// Up to [`Self::MAX_SEQUENCE`].
    pub(super) sequence: u32,
}

impl Header {
    /// Two pages of 256 double words that endure 10 000 erases each are worn at less than a sixth of it.
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

    /// Double words of the whole record.
    pub(super) const fn record_len(self) -> usize {
        OVERHEAD.saturating_add((self.len as usize).div_ceil(BYTES))
    }
}

/// A record but for its payload.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Located {
    pub(super) page: Page,
    /// Of its first double word.
    pub(super) index: usize,
    pub(super) header: Header,
    /// The last double word.
    pub(super) trailer: u64,
}

/// What begins at a double word.
pub(super) enum Found {
    Record(Located),
    /// A double word that begins no record: erased, zero, or anything else.
    Other(Result<u64, Unreadable>),
    /// A first double word, and not the rest of that record.
    Damaged(Header),
}

impl Located {
    /// The index after the record.
    pub(super) const fn end(&self) -> usize {
        self.index.saturating_add(self.header.record_len())
    }

    /// The double word `n` of the record with this payload.
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

    /// Whether flash holds exactly this record with this payload.
    pub(super) fn is_stored<F: NorFlash>(&self, flash: &F, payload: &[u8]) -> bool {
        (0..self.header.record_len())
            .all(|n| flash.read(self.page, self.index.saturating_add(n)) == Ok(self.double_word(n, payload)))
    }
}

/// The CRC of a record while its double words pass by; 0 before the first.
#[derive(Clone, Copy)]
pub(super) struct Checksum(u32);

impl Checksum {
    pub(super) const fn new() -> Self {
        Self(0)
    }

    pub(super) fn push(&mut self, double_word: u64) {
        // Goes on from the CRC of what was before: its digest, which would take a reference to CRC along, is the CRC
        // inverted; and an initial value is given in the order of the polynomial's bits.
        let mut digest = CRC.digest_with_initial((!self.0).reverse_bits());
        digest.update(&double_word.to_le_bytes());
        self.0 = digest.finalize();
    }

    /// The last double word of a record whose others were pushed.
    pub(super) const fn trailer(self) -> u64 {
        self.0 as u64 | (!self.0 as u64) << 32
    }
}

/// Reads what begins at `index`, and copies the payload's begin into `payload`, as much as that holds.
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
    for n in 1..last {
        let Ok(double_word) = flash.read(page, index.saturating_add(n)) else {
            return Found::Damaged(header);
        };
        checksum.push(double_word);
        for (byte, of_flash) in room.next().unwrap_or_default().iter_mut().zip(double_word.to_le_bytes()) {
            *byte = of_flash;
        }
    }
    let trailer = checksum.trailer();
    if flash.read(page, index.saturating_add(last)) == Ok(trailer) {
        Found::Record(Located { page, index, header, trailer })
    } else {
        Found::Damaged(header)
    }
}
