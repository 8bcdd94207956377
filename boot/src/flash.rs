//! The flash of a slot, whose operations are started and polled, and the same for a boot loader, which waits.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use wsg_bridge_fw::storage::{FlashError, Unreadable};
use wsg_update::SlotReader;

/// Unit of error detection.
pub(crate) const DOUBLE_WORD: usize = 8;

/// Erased flash.
pub(crate) const ERASED: u8 = 0xFF;

/// Flash of a slot. Offsets are from its start.
pub trait PolledFlash {
    /// Bytes of a sector, the unit of an erase.
    const SECTOR_LEN: usize;

    /// Bytes programmed at once: 8, or a power of two of them.
    const UNIT_LEN: usize;

    /// Returns the bytes of the slot.
    fn capacity(&self) -> usize;

    /// Returns whether the slot has `len` bytes at this offset.
    fn contains(&self, at: u32, len: usize) -> bool {
        self.capacity().checked_sub(len).is_some_and(|last| at as usize <= last)
    }

    /// Reads the double word at this offset, a multiple of 8. Not called during an operation.
    ///
    /// # Errors
    /// [`Unreadable`] for damage that the flash detects, and outside of the slot.
    fn read(&self, at: u32) -> Result<u64, Unreadable>;

    /// Starts to erase the sector at this offset. [`poll`](Self::poll) returns the result.
    ///
    /// # Errors
    /// The reason why the operation did not start.
    fn start_erase(&mut self, at: u32) -> Result<(), FlashError>;

    /// Starts to program an erased unit at this offset. The bytes are copied. [`poll`](Self::poll) returns the result.
    ///
    /// # Errors
    /// The reason why the operation did not start.
    fn start_program(&mut self, at: u32, unit: &[u8]) -> Result<(), FlashError>;

    /// Returns the result of the last operation. Does not wait.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] during the operation, then its error if it failed.
    fn poll(&mut self) -> nb::Result<(), FlashError>;
}

/// Reads a slot for a check.
pub(crate) struct Reader<'a, F>(pub(crate) &'a F);

impl<F: PolledFlash> SlotReader for Reader<'_, F> {
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), wsg_update::Unreadable> {
        read(self.0, offset, bytes).map_err(|Unreadable| wsg_update::Unreadable)
    }
}

/// Reads bytes at any offset.
fn read(flash: &impl PolledFlash, offset: u32, bytes: &mut [u8]) -> Result<(), Unreadable> {
    let (mut places, mut skipped) = (bytes.iter_mut(), offset as usize % DOUBLE_WORD);
    let mut at = offset.wrapping_sub(skipped as u32);
    while places.len() > 0 {
        let read = flash.read(at)?.to_le_bytes();
        // `zip` asks the bytes first, so that no place is lost at their end.
        read.iter().skip(skipped).zip(&mut places).for_each(|(read, place)| *place = *read);
        (at, skipped) = (at.wrapping_add(DOUBLE_WORD as u32), 0);
    }
    Ok(())
}

/// The same flash, whose operations wait for their end. If it never comes, the watchdog resets the MCU.
pub struct Blocking<F>(pub F);

impl<F: PolledFlash> Blocking<F> {
    fn finish(&mut self, started: Result<(), FlashError>) -> Result<(), NorFlashErrorKind> {
        started.and_then(|()| nb::block!(self.0.poll())).map_err(|_| NorFlashErrorKind::Other)
    }

    /// Returns the offsets of these sectors or units.
    fn range(
        &self,
        from: u32,
        len: usize,
        unit: usize,
    ) -> Result<impl Iterator<Item = u32> + use<F>, NorFlashErrorKind> {
        self.0.contains(from, len).then_some(()).ok_or(NorFlashErrorKind::OutOfBounds)?;
        let is_aligned = (from as usize).is_multiple_of(unit) && len.is_multiple_of(unit);
        let offsets = (from..from.saturating_add(len as u32)).step_by(unit);
        is_aligned.then_some(offsets).ok_or(NorFlashErrorKind::NotAligned)
    }
}

impl<F> ErrorType for Blocking<F> {
    type Error = NorFlashErrorKind;
}

impl<F: PolledFlash> ReadNorFlash for Blocking<F> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let _ = self.range(offset, bytes.len(), 1)?;
        read(&self.0, offset, bytes).map_err(|Unreadable| NorFlashErrorKind::Other)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: PolledFlash> NorFlash for Blocking<F> {
    const WRITE_SIZE: usize = F::UNIT_LEN;
    const ERASE_SIZE: usize = F::SECTOR_LEN;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let len = to.checked_sub(from).ok_or(NorFlashErrorKind::OutOfBounds)? as usize;
        for at in self.range(from, len, F::SECTOR_LEN)? {
            let started = self.0.start_erase(at);
            self.finish(started)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let range = self.range(offset, bytes.len(), F::UNIT_LEN)?;
        for (at, unit) in range.zip(bytes.chunks(F::UNIT_LEN)) {
            let started = self.0.start_program(at, unit);
            self.finish(started)?;
        }
        Ok(())
    }
}
