//! The settings' two sectors: the last ones of the QSPI flash (RP2040, 2.6 and 2.8.3.1.3; Winbond W25Q16JV). And that chip's number.
//!
//! The program runs from the same flash. While a sector is erased (45 ms, 400 ms at the most) or a page programmed (3 ms at
//! the most) nothing can be read from it, so nothing runs but a few instructions in RAM and the boot ROM's. That is done only
//! while the fingers stand and nothing is being sent. Where there is no boot ROM, as in an emulator, it fails.

use core::ptr::{with_exposed_provenance, with_exposed_provenance_mut};

use rp2040_hal::rom_data;
use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Unreadable};

use crate::watchdog;

/// Where the first sector begins: the end of 2 MiB, less two sectors. memory.x keeps the linker off.
const FIRST_SECTOR: u32 = 2 * 1024 * 1024 - 2 * SECTOR_BYTES as u32;
const SECTOR_BYTES: usize = 4096;
const DOUBLE_WORD_BYTES: usize = 8;

/// What is programmed at once. Bits that stay 1 in it are left alone, so a page is programmed in parts.
const PROGRAM_BYTES: usize = 256;

/// The instruction that erases a sector, which the boot ROM uses where no larger block fits.
const ERASE_BLOCK: u8 = 0xD8;
const BLOCK_BYTES: u32 = 64 * 1024;

/// Flash as memory: past the cache, which would hold what was there before.
const UNCACHED: usize = 0x1300_0000;
/// The second boot stage, at the begin of flash.
const BOOT2_AT: usize = UNCACHED;
const BOOT2_WORDS: usize = 64;

/// What the boot ROM has at address 10h: two letters and a version (2.8.3).
const ROM_MAGIC_AT: usize = 0x10;
const ROM_MAGIC: u32 = 0x01_75_4D;

/// The pin that selects the flash chip (RP2040, 2.19.6.2), driven low or high whatever the interface does; its function stays XIP.
const QSPI_SS_CTRL: usize = 0x4001_800C;
const SELECTED: u32 = 2 << 8;
const DESELECTED: u32 = 3 << 8;
/// The interface (4.10.13): whether a byte was received, and the bytes both ways.
const SSI_SR: usize = 0x1800_0028;
const RFNE: u32 = 1 << 3;
const SSI_DR0: usize = 0x1800_0060;
/// Looks at a byte that takes 0.4 µs.
const MAX_LOOKS: u32 = 1_000;

/// Read Unique ID (W25Q16JV, 8.2.29): the instruction, four bytes without a meaning, and eight of the number.
const READ_UNIQUE_ID: u32 = 0x4B;
const UNIQUE_ID: core::ops::Range<usize> = 5..13;
/// The interface's queues hold all of it.
const _: () = assert!(UNIQUE_ID.end <= 16);

/// What is to be done.
#[derive(Clone, Copy)]
enum Operation {
    Nothing,
    /// The chip's answer to Read Unique ID goes to the page buffer.
    Identify,
    Erase(u32),
    /// The page buffer, at this place.
    Program(u32),
}

/// The two sectors.
pub(crate) struct SettingsSectors {
    operation: Operation,
    /// How the last one ended.
    result: Result<(), FlashError>,
    page: [u8; PROGRAM_BYTES],
    boot2: [u32; BOOT2_WORDS],
}

impl SettingsSectors {
    /// The two sectors. To be asked for once.
    pub(crate) const fn new() -> Self {
        Self {
            operation: Operation::Nothing,
            result: Ok(()),
            page: [0; PROGRAM_BYTES],
            boot2: [0; BOOT2_WORDS],
        }
    }

    /// Does what is to be done, if anything is. Behind a turn of the main loop, while everything may stand still: the fingers
    /// stand, and nothing is being sent.
    pub(crate) fn work(&mut self) {
        let operation = core::mem::replace(&mut self.operation, Operation::Nothing);
        if !matches!(operation, Operation::Nothing) {
            self.result = self.run(operation);
        }
    }

    /// The serial number: of the flash chip's, for the RP2040 has none, what fits into 32 bits. 0 if it has none either. Before the
    /// main loop.
    pub(crate) fn serial_number(&mut self) -> u32 {
        if self.run(Operation::Identify).is_err() {
            return 0;
        }
        let number =
            self.page.get(UNIQUE_ID).and_then(|bytes| Some(u64::from_be_bytes(*bytes.first_chunk()?)));
        match number {
            // Lines that nobody drives.
            None | Some(0 | u64::MAX) => 0,
            Some(number) => ((number >> 32) as u32).rotate_left(11) ^ number as u32,
        }
    }

    fn run(&mut self, operation: Operation) -> Result<(), FlashError> {
        // SAFETY: the address is the boot ROM's; where there is none, it reads as something else.
        let magic = unsafe { with_exposed_provenance::<u32>(ROM_MAGIC_AT).read_volatile() };
        if magic & 0xFF_FFFF != ROM_MAGIC {
            return Err(FlashError::Failed);
        }
        for (word, at) in self.boot2.iter_mut().zip((BOOT2_AT..).step_by(4)) {
            // SAFETY: the address is in flash, aligned, and nothing writes there.
            *word = unsafe { with_exposed_provenance::<u32>(at).read_volatile() };
        }
        let rom = Rom {
            connect_internal_flash: rom_data::connect_internal_flash::ptr(),
            flash_exit_xip: rom_data::flash_exit_xip::ptr(),
            flash_range_erase: rom_data::flash_range_erase::ptr(),
            flash_range_program: rom_data::flash_range_program::ptr(),
            flash_flush_cache: rom_data::flash_flush_cache::ptr(),
        };
        watchdog::wait_for_flash();
        // SAFETY: interrupts are off, and the function is in RAM with all that it uses: the ROM's functions, and the buffers of
        // this value. What is erased or programmed is in the settings' sectors.
        cortex_m::interrupt::free(|_| unsafe {
            run_in_ram(&rom, operation, &mut self.page, &self.boot2);
        });
        Ok(())
    }
}

/// The boot ROM's functions, looked up while flash can be read.
struct Rom {
    connect_internal_flash: unsafe extern "C" fn(),
    flash_exit_xip: unsafe extern "C" fn(),
    flash_range_erase: unsafe extern "C" fn(u32, usize, u32, u8),
    flash_range_program: unsafe extern "C" fn(u32, *const u8, usize),
    flash_flush_cache: unsafe extern "C" fn(),
}

/// Erases, programs or identifies. In RAM: flash is no memory meanwhile.
///
/// # Safety
/// Interrupts are off, nothing else uses flash, and `boot2` is the second boot stage.
#[unsafe(link_section = ".data.run_in_ram")]
#[inline(never)]
unsafe fn run_in_ram(
    rom: &Rom,
    operation: Operation,
    page: &mut [u8; PROGRAM_BYTES],
    boot2: &[u32; BOOT2_WORDS],
) {
    // SAFETY: in the order that the data sheet asks for. The second boot stage returns where it was called, and leaves flash
    // readable as it was (its address is odd: Thumb).
    unsafe {
        (rom.connect_internal_flash)();
        (rom.flash_exit_xip)();
        match operation {
            Operation::Nothing => {}
            Operation::Identify => identify(page),
            Operation::Erase(at) => (rom.flash_range_erase)(at, SECTOR_BYTES, BLOCK_BYTES, ERASE_BLOCK),
            Operation::Program(at) => (rom.flash_range_program)(at, page.as_ptr(), PROGRAM_BYTES),
        }
        (rom.flash_flush_cache)();
        let boot2 = boot2.as_ptr().wrapping_byte_add(1);
        let make_readable = core::mem::transmute::<*const u32, unsafe extern "C" fn()>(boot2);
        make_readable();
    }
}

/// Has the chip tell its number. The ROM's flush of the cache gives the pin back to the interface.
///
/// # Safety
/// As for [`run_in_ram`], of which it is a part; the interface is as the ROM's exit from XIP leaves it: bytes, one line each way.
#[inline(always)]
unsafe fn identify(answer: &mut [u8; PROGRAM_BYTES]) {
    let [select, status, data] = [QSPI_SS_CTRL, SSI_SR, SSI_DR0].map(with_exposed_provenance_mut::<u32>);
    // SAFETY: they are registers, and nobody else uses them meanwhile.
    unsafe {
        select.write_volatile(SELECTED);
        data.write_volatile(READ_UNIQUE_ID);
        (1..UNIQUE_ID.end).for_each(|_| data.write_volatile(0));
        for place in answer.iter_mut().take(UNIQUE_ID.end) {
            let _ = (0..MAX_LOOKS).any(|_| status.read_volatile() & RFNE != 0);
            *place = data.read_volatile() as u8;
        }
        select.write_volatile(DESELECTED);
    }
}

/// Where a double word is, from the begin of flash.
fn offset(page: Page, index: usize) -> Option<u32> {
    let sector = match page {
        Page::First => FIRST_SECTOR,
        Page::Second => FIRST_SECTOR + SECTOR_BYTES as u32,
    };
    (index < SettingsSectors::PAGE_LEN).then(|| sector.wrapping_add((index * DOUBLE_WORD_BYTES) as u32))
}

impl NorFlash for SettingsSectors {
    const PAGE_LEN: usize = SECTOR_BYTES / DOUBLE_WORD_BYTES;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        let at = UNCACHED.wrapping_add(offset(page, index).ok_or(Unreadable)? as usize);
        let low = with_exposed_provenance::<u32>(at);
        // SAFETY: both words are in flash, aligned, and written by `run_in_ram` alone.
        let (low, high) = unsafe { (low.read_volatile(), low.wrapping_add(1).read_volatile()) };
        Ok(u64::from(low) | u64::from(high) << 32)
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        let at = offset(page, index).ok_or(FlashError::Failed)?;
        let start = at as usize % PROGRAM_BYTES;
        self.page.fill(0xFF);
        let place = self.page.get_mut(start..).and_then(<[u8]>::first_chunk_mut);
        *place.ok_or(FlashError::Failed)? = value.to_le_bytes();
        self.operation = Operation::Program(at - start as u32);
        Ok(())
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.operation = Operation::Erase(offset(page, 0).ok_or(FlashError::Failed)?);
        Ok(())
    }

    /// Whether it did its work, a read tells.
    fn poll(&mut self) -> nb::Result<(), FlashError> {
        match self.operation {
            Operation::Nothing => self.result.map_err(nb::Error::Other),
            _ => Err(nb::Error::WouldBlock),
        }
    }
}
