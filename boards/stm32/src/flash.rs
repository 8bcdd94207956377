//! The flash: the pages of records at the end of bank 2, and the slots of a boot loader (RM0351, chapter 3; RM0440, FLASH of
//! category 3 devices).
//!
//! The program runs from bank 1, so it continues while bank 2 is programmed or erased. The settings' pages are tested on the default board in the
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

#[cfg(feature = "updates")]
pub(crate) mod slot;

const PAGE_BYTES: usize = 2048;
const DOUBLE_WORD_BYTES: usize = 8;

const FLASH_START: usize = FLASH_END - 2 * FLASH_BANK_BYTES;
const _: () = assert!(FLASH_BANK_BYTES / PAGE_BYTES <= 256);

/// Bytes of two pages for records.
const RECORDS: usize = 2 * PAGE_BYTES;

/// Key sequence that unlocks FLASH_CR (RM0351, 3.3.5).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// The state of [`read`] for the NMI handler.
static READ: AtomicU8 = AtomicU8::new(NO_READ);
const NO_READ: u8 = 0;
const READING: u8 = 1;
const UNREADABLE: u8 = 2;

/// Two pages for records, at this address. `board-memory.x` reserves them.
pub(crate) struct RecordPages(usize);

/// Returns the settings' pages. Call it once.
const fn settings_pages() -> RecordPages {
    RecordPages(FLASH_END - RECORDS)
}

/// The flash of the firmware.
#[cfg(not(feature = "slot"))]
pub(crate) type FirmwareFlash = RecordPages;
#[cfg(feature = "slot")]
pub(crate) type FirmwareFlash = wsg_boot::FlashWithSlot<RecordPages, slot::Slot, RecordPages, RecordPages>;

/// Returns the flash of the firmware of this board. Call it once.
#[cfg(not(feature = "slot"))]
pub(crate) const fn open(_: &str) -> FirmwareFlash {
    settings_pages()
}

/// Returns the flash of the firmware of this board. Call it once.
#[cfg(feature = "slot")]
pub(crate) fn open(board: &str) -> FirmwareFlash {
    let firmware = wsg_boot::Firmware::of(&slot::A, board, slot::verify(), || SCB::sys_reset());
    let updater =
        firmware.map(|firmware| wsg_boot::Updater::new(slot::B, slot::STATE, slot::TRUST, firmware));
    FirmwareFlash { settings: settings_pages(), updater }
}

impl RecordPages {
    /// Returns the address of a double word.
    fn address(&self, page: Page, index: usize) -> Option<usize> {
        let page = match page {
            Page::First => self.0,
            Page::Second => self.0.wrapping_add(PAGE_BYTES),
        };
        (index < Self::PAGE_LEN).then(|| page.wrapping_add(index.wrapping_mul(DOUBLE_WORD_BYTES)))
    }
}

impl NorFlash for RecordPages {
    const PAGE_LEN: usize = PAGE_BYTES / DOUBLE_WORD_BYTES;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        read(self.address(page, index).ok_or(Unreadable)?)
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        start_program(self.address(page, index).ok_or(FlashError::Failed)?, value)
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        start_erase(self.address(page, 0).ok_or(FlashError::Failed)?)
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        poll()
    }
}

/// Unlocks FLASH_CR and clears earlier error flags, some of which block an operation (RM0351, 3.3.7).
fn prepare() -> Result<(), FlashError> {
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

/// Reads the double word at an address in flash.
fn read(at: usize) -> Result<u64, Unreadable> {
    let low = with_exposed_provenance::<u32>(at);
    // While a flag is set, the next uncorrectable double word is not detected (RM0351, 3.7.7).
    clear_ecc_flags();
    READ.store(READING, Ordering::SeqCst);
    // SAFETY: the callers pass addresses of double words in flash. Only this driver writes them, by registers.
    let (low, high) = unsafe { (low.read_volatile(), low.wrapping_add(1).read_volatile()) };
    // A pending NMI is taken here at the latest.
    dsb();
    isb();
    match READ.swap(NO_READ, Ordering::SeqCst) {
        READING => Ok(u64::from(low) | u64::from(high) << 32),
        _ => Err(Unreadable),
    }
}

/// Starts to program the double word at an address in flash.
fn start_program(at: usize, value: u64) -> Result<(), FlashError> {
    let low = with_exposed_provenance::<u32>(at).cast_mut();
    prepare()?;
    // An abandoned operation may have left the other bit set.
    FLASH.cr().modify(|w| {
        w.set_per(false);
        w.set_pg(true);
    });
    // SAFETY: with PG set, two stores to one double word program it (RM0351, 3.3.7). The callers pass addresses in pages of
    // records or slots, to which no reference exists, and which only `read_volatile` reads.
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

/// Starts to erase the page at an address.
fn start_erase(at: usize) -> Result<(), FlashError> {
    prepare()?;
    let offset = at.wrapping_sub(FLASH_START);
    FLASH.cr().modify(|w| {
        w.set_pg(false);
        w.set_per(true);
        w.set_bker(offset >= FLASH_BANK_BYTES);
        w.set_pnb((offset % FLASH_BANK_BYTES / PAGE_BYTES) as u8);
    });
    FLASH.cr().modify(chip::start_erase);
    dsb();
    Ok(())
}

/// Returns the result of the last operation.
fn poll() -> nb::Result<(), FlashError> {
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

/// Handles uncorrectable flash data. In records and slots, a power failure may cause it, and a reset would repeat forever, so the
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
