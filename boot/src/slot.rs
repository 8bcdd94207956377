//! A slot as `embassy-boot` and the checks see it.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use wsg_update::{SlotReader, Unreadable};

use crate::flash::{DOUBLE_WORD, ERASED};

/// The first pages of a slot, to be copied.
///
/// Damaged data reads erased: it is outside of the image, which was checked before. Erased data is not programmed, because it
/// could not be programmed later on flash with ECC. Programmed data is read back.
pub(crate) struct Slot<'a, F> {
    flash: &'a mut F,
    len: usize,
    feed: &'a dyn Fn(),
}

impl<'a, F> Slot<'a, F> {
    pub(crate) fn new(flash: &'a mut F, len: usize, feed: &'a dyn Fn()) -> Self {
        Self { flash, len, feed }
    }
}

impl<F> ErrorType for Slot<'_, F> {
    type Error = NorFlashErrorKind;
}

impl<F: NorFlash> ReadNorFlash for Slot<'_, F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        for (part, at) in bytes.chunks_mut(DOUBLE_WORD).zip((offset..).step_by(DOUBLE_WORD)) {
            if self.flash.read(at, part).is_err() {
                part.fill(ERASED);
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.len
    }
}

impl<F: NorFlash> NorFlash for Slot<'_, F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let result = self.flash.erase(from, to);
        (self.feed)();
        result.map_err(|_| NorFlashErrorKind::Other)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for (part, at) in bytes.chunks(Self::WRITE_SIZE).zip((offset..).step_by(Self::WRITE_SIZE)) {
            if part.iter().any(|byte| *byte != ERASED) {
                self.flash.write(at, part).map_err(|_| NorFlashErrorKind::Other)?;
                (self.feed)();
            }
        }
        for (part, at) in bytes.chunks(DOUBLE_WORD).zip((offset..).step_by(DOUBLE_WORD)) {
            let mut written = [0; DOUBLE_WORD];
            let written = written.get_mut(..part.len()).unwrap_or_default();
            if self.flash.read(at, written).is_err() || written != part {
                return Err(NorFlashErrorKind::Other);
            }
        }
        Ok(())
    }
}

/// Reads a slot for a check, from an offset.
pub(crate) struct Reader<'a, F> {
    pub(crate) slot: &'a mut F,
    pub(crate) from: u32,
}

impl<F: ReadNorFlash> SlotReader for Reader<'_, F> {
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Unreadable> {
        self.slot.read(self.from.saturating_add(offset), bytes).map_err(|_| Unreadable)
    }
}
