//! The slots, and the pages of the boot loader's records (`docs/decisions.md`, "Updates in the field"). The program stands still
//! while its own bank is written: slot A, which the boot loader alone writes.

use wsg_boot::PolledFlash;
use wsg_bridge_fw::storage::{FlashError, Unreadable};
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
    /// Returns the address of this offset; `None` if the slot has no `len` bytes there.
    fn address(&self, at: u32, len: usize) -> Option<usize> {
        self.contains(at, len).then(|| self.start.wrapping_add(at as usize))
    }
}

impl PolledFlash for Slot {
    const SECTOR_LEN: usize = PAGE_BYTES;
    const UNIT_LEN: usize = DOUBLE_WORD_BYTES;

    fn capacity(&self) -> usize {
        self.len
    }

    fn read(&self, at: u32) -> Result<u64, Unreadable> {
        super::read(self.address(at, DOUBLE_WORD_BYTES).ok_or(Unreadable)?)
    }

    fn start_erase(&mut self, at: u32) -> Result<(), FlashError> {
        super::start_erase(self.address(at, PAGE_BYTES).ok_or(FlashError::Failed)?)
    }

    fn start_program(&mut self, at: u32, unit: &[u8]) -> Result<(), FlashError> {
        let at = self.address(at, DOUBLE_WORD_BYTES).ok_or(FlashError::Failed)?;
        let value = unit.first_chunk().ok_or(FlashError::Failed)?;
        super::start_program(at, u64::from_le_bytes(*value))
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        super::poll()
    }
}

/// Returns the check of a signature by the boot loader's code, if there is a boot loader.
#[cfg(feature = "slot")]
pub(crate) fn verify() -> Option<wsg_boot::Verify> {
    boot_loader().map(|_| verify_patiently as _)
}

/// The check takes about 60 ms at 80 MHz, near the time-out of the watchdog.
#[cfg(feature = "slot")]
extern "C" fn verify_patiently(
    key: &wsg_update::PublicKey,
    digest: &[u8; 64],
    signature: &[u8; wsg_update::SIGNATURE_LEN],
) -> bool {
    crate::watchdog::set_patient(true);
    let is_right = boot_loader().is_some_and(|verify| verify(key, digest, signature));
    crate::watchdog::set_patient(false);
    is_right
}

/// Returns the boot loader's check of a signature.
#[cfg(feature = "slot")]
fn boot_loader() -> Option<wsg_boot::Verify> {
    use core::ptr::with_exposed_provenance;

    let at = with_exposed_provenance::<usize>(FLASH_START + wsg_boot::VERIFY_AT);
    // SAFETY: the address is in flash, aligned, and written by no code of this image.
    let code = unsafe { at.read_volatile() };
    let is_code = code & 1 == 1 && (FLASH_START..SLOT_A).contains(&code);
    // SAFETY: every boot loader of this board has the address of a function of this type there, and nothing else starts an image
    // in slot A. Without one, flash reads erased.
    is_code.then(|| unsafe {
        core::mem::transmute::<*const (), wsg_boot::Verify>(with_exposed_provenance(code))
    })
}
