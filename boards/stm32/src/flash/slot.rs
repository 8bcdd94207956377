//! The slots and the pages of the boot loader's records (`docs/decisions.md`, "Flash layout"), blocking. The boot loader runs
//! from bank 1, too, so the core stalls while slot A is written.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use wsg_bridge_fw::storage::FlashError;
use wsg_update::SLOT_LEN;

use super::{DOUBLE_WORD_BYTES, FLASH_BANK_BYTES, FLASH_END, FLASH_START, PAGE_BYTES, RECORDS, RecordPages};

/// Bytes reserved for the boot loader.
const BOOT_LOADER: usize = 32 * 1024;

/// Address of slot A.
pub(crate) const SLOT_A: usize = FLASH_START + BOOT_LOADER;

pub(crate) const STATE: RecordPages = RecordPages(FLASH_END - 2 * RECORDS);
pub(crate) const TRUST: RecordPages = RecordPages(FLASH_END - 3 * RECORDS);

/// A slot.
pub(crate) struct Slot {
    start: usize,
    len: usize,
}

pub(crate) const A: Slot = Slot { start: SLOT_A, len: SLOT_LEN as usize };
pub(crate) const B: Slot =
    Slot { start: FLASH_START + FLASH_BANK_BYTES, len: SLOT_LEN as usize + PAGE_BYTES };

impl Slot {
    /// Returns the address of these bytes.
    fn address(&self, offset: u32, len: usize) -> Result<usize, NorFlashErrorKind> {
        let end = (offset as usize).checked_add(len);
        if end.is_none_or(|end| end > self.len) {
            return Err(NorFlashErrorKind::OutOfBounds);
        }
        Ok(self.start.wrapping_add(offset as usize))
    }
}

/// Waits for the end of an operation. If it never ends, the watchdog resets the MCU.
fn finish(started: Result<(), FlashError>) -> Result<(), NorFlashErrorKind> {
    started.and_then(|()| nb::block!(super::poll())).map_err(|_| NorFlashErrorKind::Other)
}

impl ErrorType for Slot {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Slot {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let start = self.address(offset, bytes.len())?;
        for (word, at) in bytes.chunks_mut(4).zip((start..).step_by(4)) {
            let value = super::read(at & !(DOUBLE_WORD_BYTES - 1)).map_err(|_| NorFlashErrorKind::Other)?;
            let half = value >> (8 * (at & 4));
            for (byte, read) in word.iter_mut().zip(half.to_le_bytes()) {
                *byte = read;
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.len
    }
}

impl NorFlash for Slot {
    const WRITE_SIZE: usize = DOUBLE_WORD_BYTES;
    const ERASE_SIZE: usize = PAGE_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let len = to.checked_sub(from).ok_or(NorFlashErrorKind::OutOfBounds)? as usize;
        let start = self.address(from, len)?;
        (start..start.wrapping_add(len)).step_by(PAGE_BYTES).try_for_each(|at| finish(super::start_erase(at)))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let start = self.address(offset, bytes.len())?;
        let (double_words, rest) = bytes.as_chunks();
        if !rest.is_empty() || !start.is_multiple_of(DOUBLE_WORD_BYTES) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        double_words
            .iter()
            .zip((start..).step_by(DOUBLE_WORD_BYTES))
            .try_for_each(|(bytes, at)| finish(super::start_program(at, u64::from_le_bytes(*bytes))))
    }
}
