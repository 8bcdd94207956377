//! The settings' two pages at the end of flash bank 2 (RM0351, chapter 3; RM0440, FLASH of category 3 devices).
//!
//! The program runs from bank 1, so it continues while the pages are programmed or erased. Tested on the default board in the
//! emulator with a model of the interface, not on hardware yet. Without the model, the emulator reads 0 and ignores stores;
//! the settings store detects this.

use core::ptr::with_exposed_provenance;
use core::sync::atomic::{AtomicU8, Ordering};

use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use stm32_metapac::FLASH;
use stm32_metapac::flash::regs::Sr;
use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Unreadable};

use crate::chip::{self, FLASH_BANK_BYTES, FLASH_END};

const PAGE_BYTES: usize = 2048;
const DOUBLE_WORD_BYTES: usize = 8;

/// Address of the first page: the end of the flash less two pages. `board-memory.x` reserves them.
const FIRST_PAGE: usize = FLASH_END - 2 * PAGE_BYTES;

/// Number of the first page in its bank.
const FIRST_PAGE_NUMBER: u8 = (FLASH_BANK_BYTES / PAGE_BYTES - 2) as u8;
const _: () = assert!(FLASH_BANK_BYTES / PAGE_BYTES <= 256);

/// Key sequence that unlocks FLASH_CR (RM0351, 3.3.5).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// The state of [`NorFlash::read`] for the NMI handler.
static READ: AtomicU8 = AtomicU8::new(NO_READ);
const NO_READ: u8 = 0;
const READING: u8 = 1;
const UNREADABLE: u8 = 2;

pub(crate) struct SettingsPages(());

/// Returns the settings' pages. Call it once.
pub(crate) const fn settings_pages() -> SettingsPages {
    SettingsPages(())
}

/// Returns the address of a double word.
fn address(page: Page, index: usize) -> Option<usize> {
    let page = match page {
        Page::First => FIRST_PAGE,
        Page::Second => FIRST_PAGE + PAGE_BYTES,
    };
    (index < SettingsPages::PAGE_LEN).then(|| page.wrapping_add(index.wrapping_mul(DOUBLE_WORD_BYTES)))
}

impl SettingsPages {
    /// Unlocks FLASH_CR and clears earlier error flags, some of which block an operation (RM0351, 3.3.7).
    fn prepare(&mut self) -> Result<(), FlashError> {
        if !chip::has_two_banks() {
            return Err(FlashError::Protected);
        }
        if FLASH.sr().read().bsy() {
            return Err(FlashError::Busy);
        }
        // Writing 1 clears a flag.
        FLASH.sr().write_value(errors());
        if FLASH.cr().read().lock() {
            for key in KEYS {
                FLASH.keyr().write_value(key);
            }
        }
        if FLASH.cr().read().lock() {
            return Err(FlashError::Protected);
        }
        // Erratum: reading one bank while the other is written can corrupt the data cache, so disable it like ST's driver. The
        // instruction cache stays enabled.
        FLASH.acr().modify(|w| w.set_dcen(false));
        Ok(())
    }
}

impl NorFlash for SettingsPages {
    const PAGE_LEN: usize = PAGE_BYTES / DOUBLE_WORD_BYTES;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        let low = with_exposed_provenance::<u32>(address(page, index).ok_or(Unreadable)?);
        // While a flag is set, the next uncorrectable double word is not detected (RM0351, 3.7.7).
        clear_ecc_flags();
        READ.store(READING, Ordering::SeqCst);
        // SAFETY: both words are in flash and aligned. Only this driver writes them, by registers.
        let (low, high) = unsafe { (low.read_volatile(), low.wrapping_add(1).read_volatile()) };
        // A pending NMI is taken here at the latest.
        dsb();
        isb();
        match READ.swap(NO_READ, Ordering::SeqCst) {
            READING => Ok(u64::from(low) | u64::from(high) << 32),
            _ => Err(Unreadable),
        }
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        let low = with_exposed_provenance::<u32>(address(page, index).ok_or(FlashError::Failed)?).cast_mut();
        self.prepare()?;
        // An abandoned operation may have left the other bit set.
        FLASH.cr().modify(|w| {
            w.set_per(false);
            w.set_pg(true);
        });
        // SAFETY: with PG set, two stores to one double word of the settings' pages program it (RM0351, 3.3.7). No reference
        // to it exists, and only `read_volatile` reads it.
        unsafe {
            low.write_volatile(value as u32);
            // Ensure that the low word is stored first.
            isb();
            low.wrapping_add(1).write_volatile((value >> 32) as u32);
        }
        // Complete the stores before reading the flags.
        dsb();
        Ok(())
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.prepare()?;
        FLASH.cr().modify(|w| {
            w.set_pg(false);
            w.set_per(true);
            w.set_bker(true);
            w.set_pnb(match page {
                Page::First => FIRST_PAGE_NUMBER,
                Page::Second => FIRST_PAGE_NUMBER + 1,
            });
        });
        FLASH.cr().modify(chip::start_erase);
        dsb();
        Ok(())
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        let status = FLASH.sr().read();
        if status.bsy() {
            return Err(nb::Error::WouldBlock);
        }
        // EOP is set only with its interrupt enabled (RM0351, 3.7.5). A read-back verifies the operation.
        let result = if status.wrperr() {
            Err(FlashError::Protected)
        } else if status.progerr() {
            Err(FlashError::NotErased)
        } else if status.0 & errors().0 != 0 {
            Err(FlashError::Failed)
        } else {
            Ok(())
        };
        FLASH.cr().modify(|w| {
            w.set_pg(false);
            w.set_per(false);
        });
        FLASH.cr().modify(|w| w.set_lock(true));
        // The cache may hold old data. It must be disabled for its reset (RM0351, 3.7.1).
        FLASH.acr().modify(|w| w.set_dcrst(true));
        FLASH.acr().modify(|w| w.set_dcrst(false));
        FLASH.acr().modify(|w| w.set_dcen(true));
        result.map_err(nb::Error::Other)
    }
}

/// Returns all error flags of an operation (RM0351, 3.7.5).
fn errors() -> Sr {
    let mut errors = Sr(0);
    errors.set_operr(true);
    errors.set_progerr(true);
    errors.set_wrperr(true);
    errors.set_pgaerr(true);
    errors.set_sizerr(true);
    errors.set_pgserr(true);
    errors.set_miserr(true);
    errors.set_fasterr(true);
    errors
}

/// Clears the ECC flags by writing 1. The only other writable bit enables an interrupt and stays 0.
fn clear_ecc_flags() {
    FLASH.eccr().write(chip::set_ecc_flags);
}

/// Handles uncorrectable flash data. In the settings, a power failure may cause it, and a reset would repeat forever, so the
/// read only fails. Anywhere else the program is corrupt, so reset.
// SAFETY: the handler shares only an atomic with the interrupted program.
#[exception]
unsafe fn NonMaskableInt() {
    // Each word of a double word may raise NMI. Nothing interrupts this handler, so a separate load and store suffice.
    if chip::is_uncorrectable(FLASH.eccr().read()) && READ.load(Ordering::SeqCst) != NO_READ {
        READ.store(UNREADABLE, Ordering::SeqCst);
        clear_ecc_flags();
    } else {
        SCB::sys_reset();
    }
}
