//! The boot loader of the Raspberry Pi Pico: its start, the slots, and the jump to the image in slot A.

#![no_std]
#![no_main]
#![deny(
    clippy::undocumented_unsafe_blocks,
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]
#![allow(dead_code, reason = "the modules serve the firmware, too")]

mod clock;
mod faults;
mod flash;
mod pins;
mod registers;
mod watchdog;

use core::ptr::with_exposed_provenance;

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use rp2040_hal::pac;
use wsg_boot::{Flash, Stopped};
use wsg_bridge_fw::storage::{self, FlashError, Page, Unreadable};
use wsg_update::{Keys, SLOT_LEN, Target};

use crate::flash::{PROGRAM_BYTES, RecordSectors, SECTOR_BYTES, double_word};

/// The second boot stage, which makes flash readable as memory. The boot ROM runs it.
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

/// Offsets from the start of flash (`docs/decisions.md`, "Flash layout").
const SLOT_A: u32 = 32 * 1024;
const SLOT_B: u32 = 1024 * 1024;
const TRUST: u32 = 0x1F_A000;
const STATE: u32 = 0x1F_C000;

/// Address of slot A in flash as cached memory.
const SLOT_A_AT: usize = 0x1000_0000 + SLOT_A as usize;

/// For the firmware, at a fixed address.
#[unsafe(link_section = ".verify")]
#[used]
static VERIFY: wsg_boot::Verify = wsg_boot::verify;

/// Duration of each phase of the LED in the safe state, in cycles of the running clock.
const BLINK: u32 = clock::SYS_HZ / 8;

#[entry]
fn main() -> ! {
    // Started before any wait, so that a failed start resets the MCU.
    watchdog::start();
    watchdog::wait_for_flash();
    // SAFETY: `main` runs once, and no other code takes the peripherals.
    let peripherals = unsafe { pac::Peripherals::steal() };
    // Outputs are low from here until the image sets them.
    let (_wires, mut led) = pins::init(peripherals);
    // Without the crystal, a check takes longer than the watchdog waits. The image could not run either.
    let _ = clock::start();
    let mut flash = Flash {
        a: Slot { start: SLOT_A, len: SLOT_LEN as usize, sectors: RecordSectors::at(SLOT_A) },
        b: Slot { start: SLOT_B, len: SLOT_LEN as usize + SECTOR_BYTES, sectors: RecordSectors::at(SLOT_B) },
        state: Records(RecordSectors::at(STATE)),
        trust: Records(RecordSectors::at(TRUST)),
    };
    match flash.start(const { Target::of("pico") }, Keys::BUILT_IN, &watchdog::wait_for_flash) {
        Ok(_) => start_slot_a(),
        Err(Stopped::NoImage(_)) => {
            let mut is_lit = false;
            loop {
                is_lit = !is_lit;
                led.indicate(is_lit);
                watchdog::wait_for_flash();
                cortex_m::asm::delay(BLINK);
            }
        }
        // The watchdog resets the MCU, and the next start tries again.
        Err(Stopped::Flash) => loop {
            cortex_m::asm::nop();
        },
    }
}

/// Jumps to the image in slot A. It starts its clock again, and the watchdog runs.
fn start_slot_a() -> ! {
    // SAFETY: slot A starts with the vector table of a signed image for this board. No interrupt is enabled, so the vector
    // table may change, and nothing of this program is used again.
    unsafe {
        (*SCB::PTR).vtor.write(SLOT_A_AT as u32);
        cortex_m::asm::bootload(with_exposed_provenance(SLOT_A_AT))
    }
}

/// Sectors of a record, written at once.
struct Records(RecordSectors);

impl storage::NorFlash for Records {
    const PAGE_LEN: usize = RecordSectors::PAGE_LEN;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        self.0.read(page, index)
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        self.0.start_program(page, index, value)?;
        self.0.work();
        Ok(())
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.0.start_erase(page)?;
        self.0.work();
        Ok(())
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        self.0.poll()
    }
}

/// A slot, written at once.
struct Slot {
    start: u32,
    len: usize,
    sectors: RecordSectors,
}

impl Slot {
    /// Returns the offset of these bytes from the start of flash.
    fn offset(&self, offset: u32, len: usize) -> Result<u32, NorFlashErrorKind> {
        let end = (offset as usize).checked_add(len);
        if end.is_none_or(|end| end > self.len) {
            return Err(NorFlashErrorKind::OutOfBounds);
        }
        Ok(self.start.wrapping_add(offset))
    }
}

impl ErrorType for Slot {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Slot {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let start = self.offset(offset, bytes.len())?;
        for (word, at) in bytes.chunks_mut(4).zip((start..).step_by(4)) {
            let half = double_word(at & !7) >> (8 * (at & 4));
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
    const WRITE_SIZE: usize = PROGRAM_BYTES;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let len = to.checked_sub(from).ok_or(NorFlashErrorKind::OutOfBounds)?;
        let start = self.offset(from, len as usize)?;
        (start..start.wrapping_add(len))
            .step_by(SECTOR_BYTES)
            .try_for_each(|at| self.sectors.erase(at))
            .map_err(|_| NorFlashErrorKind::Other)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let start = self.offset(offset, bytes.len())?;
        let (pages, rest) = bytes.as_chunks();
        if !rest.is_empty() || !start.is_multiple_of(PROGRAM_BYTES as u32) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        pages
            .iter()
            .zip((start..).step_by(PROGRAM_BYTES))
            .try_for_each(|(page, at)| self.sectors.program(at, page))
            .map_err(|_| NorFlashErrorKind::Other)
    }
}
