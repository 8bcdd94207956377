//! The slots, the pages of the boot loader's records, and what boot loader and firmware know of each other.

use wsg_boot::PolledFlash;
use wsg_bridge_fw::storage::{FlashError, NorFlash as _, Unreadable};
use wsg_update::SLOT_LEN;

use super::{PROGRAM_BYTES, RecordSectors, SECTOR_BYTES, double_word};

/// The board's name in the workspace, whose images alone the boot loader accepts.
pub(crate) const ID: &str = "pico";

/// Offsets from the start of flash (`docs/decisions.md`, "Updates in the field").
const SLOT_A: u32 = 32 * 1024;
const SLOT_B: u32 = 1024 * 1024;
const TRUST: u32 = 0x1F_A000;
const STATE: u32 = 0x1F_C000;

/// Address of slot A in flash as cached memory.
pub(crate) const SLOT_A_AT: usize = FLASH_AT + SLOT_A as usize;
const FLASH_AT: usize = 0x1000_0000;

/// A slot, and its pending operation.
pub(crate) struct Slot {
    start: u32,
    len: usize,
    pub(crate) sectors: RecordSectors,
}

pub(crate) const fn a() -> Slot {
    Slot { start: SLOT_A, len: SLOT_LEN as usize, sectors: RecordSectors::at(SLOT_A) }
}

pub(crate) const fn b() -> Slot {
    Slot { start: SLOT_B, len: SLOT_LEN as usize + SECTOR_BYTES, sectors: RecordSectors::at(SLOT_B) }
}

pub(crate) const fn state() -> RecordSectors {
    RecordSectors::at(STATE)
}

pub(crate) const fn trust() -> RecordSectors {
    RecordSectors::at(TRUST)
}

impl Slot {
    /// Returns this offset from the start of flash; `None` if the slot has no `len` bytes there.
    fn offset(&self, at: u32, len: usize) -> Option<u32> {
        self.contains(at, len).then(|| self.start.wrapping_add(at))
    }
}

impl PolledFlash for Slot {
    const SECTOR_LEN: usize = SECTOR_BYTES;
    const UNIT_LEN: usize = PROGRAM_BYTES;

    fn capacity(&self) -> usize {
        self.len
    }

    fn read(&self, at: u32) -> Result<u64, Unreadable> {
        Ok(double_word(self.offset(at, 8).ok_or(Unreadable)?))
    }

    fn start_erase(&mut self, at: u32) -> Result<(), FlashError> {
        self.sectors.begin_erase(self.offset(at, SECTOR_BYTES).ok_or(FlashError::Failed)?);
        Ok(())
    }

    fn start_program(&mut self, at: u32, unit: &[u8]) -> Result<(), FlashError> {
        let at = self.offset(at, PROGRAM_BYTES).ok_or(FlashError::Failed)?;
        self.sectors.begin_program(at, unit.first_chunk().ok_or(FlashError::Failed)?);
        Ok(())
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        self.sectors.poll()
    }
}

/// Returns the driver of slot B, if a boot loader started this image.
#[cfg(feature = "slot")]
pub(crate) fn updater() -> Option<wsg_boot::Updater<Slot, RecordSectors, RecordSectors>> {
    let restart = || crate::watchdog::reset();
    let firmware = wsg_boot::Firmware::of(&a(), ID, boot_loader().map(|_| verify as _), restart)?;
    Some(wsg_boot::Updater::new(b(), state(), trust(), firmware))
}

/// Checks a signature by the boot loader's code. That takes 0.3 s, less than the longest erase.
#[cfg(feature = "slot")]
extern "C" fn verify(
    key: &wsg_update::PublicKey,
    digest: &[u8; 64],
    signature: &[u8; wsg_update::SIGNATURE_LEN],
) -> bool {
    crate::watchdog::wait_for_flash();
    boot_loader().is_some_and(|verify| verify(key, digest, signature))
}

/// Returns the boot loader's check of a signature, if there is a boot loader.
#[cfg(feature = "slot")]
fn boot_loader() -> Option<wsg_boot::Verify> {
    use core::ptr::with_exposed_provenance;

    let at = with_exposed_provenance::<usize>(FLASH_AT + 0x100 + wsg_boot::VERIFY_AT);
    // SAFETY: the address is in flash, aligned, and written by no code of this image.
    let code = unsafe { at.read_volatile() };
    let is_code = code & 1 == 1 && (FLASH_AT..SLOT_A_AT).contains(&code);
    // SAFETY: every boot loader of this board has the address of a function of this type there, and nothing else starts an image
    // in slot A. Without one, flash reads erased.
    is_code.then(|| unsafe {
        core::mem::transmute::<*const (), wsg_boot::Verify>(with_exposed_provenance(code))
    })
}
