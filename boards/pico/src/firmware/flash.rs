//! Pairs of sectors for records at the end of the QSPI flash, and the chip's ID (RP2040, 2.6 and 2.8.3.1.3; Winbond W25Q16JV).
//!
//! The program runs from the same flash. Erasing a sector takes 45 ms (maximum 400 ms), programming a page up to 3 ms.
//! Meanwhile the flash cannot be read, and only a few instructions in RAM and the boot ROM run. Operations therefore run only
//! while the fingers are at rest and no line transmits. Without a boot ROM, as in an emulator, they fail.

use core::ptr::{with_exposed_provenance, with_exposed_provenance_mut};

use rp2040_hal::rom_data;
use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Unreadable};

use crate::watchdog;

#[cfg(any(feature = "boot", feature = "slot"))]
pub(crate) mod slots;

/// Offset of the first sector: the end of 2 MiB less two sectors. `board-memory.x` reserves them.
const FIRST_SECTOR: u32 = 2 * 1024 * 1024 - 2 * SECTOR_BYTES as u32;
pub(crate) const SECTOR_BYTES: usize = 4096;
const DOUBLE_WORD_BYTES: usize = 8;

/// Number of bytes programmed at once. Bits that stay 1 are unchanged, so a page can be programmed in parts.
pub(crate) const PROGRAM_BYTES: usize = 256;

/// The instruction with which the boot ROM erases a block of 64 KiB, if a range covers one.
const ERASE_BLOCK: u8 = 0xD8;
const BLOCK_BYTES: u32 = 64 * 1024;

/// Flash as memory, bypassing the cache, which could hold old data.
const UNCACHED: usize = 0x1300_0000;
/// The second boot stage, at the start of flash.
const BOOT2_AT: usize = UNCACHED;
const BOOT2_WORDS: usize = 64;

/// The boot ROM's identification at address 10h: two letters and a version (2.8.3).
const ROM_MAGIC_AT: usize = 0x10;
const ROM_MAGIC: u32 = 0x01_75_4D;

/// The chip select of the flash (RP2040, 2.19.6.2). Its output override drives it low or high; its function stays XIP.
const QSPI_SS_CTRL: usize = 0x4001_800C;
const SELECTED: u32 = 2 << 8;
const DESELECTED: u32 = 3 << 8;
/// Registers of the interface (4.10.13): the receive status and the data in both directions.
const SSI_SR: usize = 0x1800_0028;
const RFNE: u32 = 1 << 3;
const SSI_DR0: usize = 0x1800_0060;
/// Maximum number of status reads for a byte, which takes 0.4 µs.
const MAX_LOOKS: u32 = 1_000;

/// Read Unique ID (W25Q16JV, 8.2.29): the instruction, four dummy bytes and eight ID bytes.
const READ_UNIQUE_ID: u32 = 0x4B;
const UNIQUE_ID: core::ops::Range<usize> = 5..13;
/// The interface's FIFOs hold the complete exchange.
const _: () = assert!(UNIQUE_ID.end <= 16);

#[derive(Clone, Copy)]
enum Operation {
    Nothing,
    /// Reads the chip's unique ID into the page buffer.
    Identify,
    Erase(u32),
    /// Programs the page buffer at this offset.
    Program(u32),
}

/// The flash of the firmware.
#[cfg(not(feature = "slot"))]
pub(crate) type FirmwareFlash = RecordSectors;
#[cfg(feature = "slot")]
pub(crate) type FirmwareFlash =
    wsg_boot::FlashWithSlot<RecordSectors, slots::Slot, RecordSectors, RecordSectors>;

/// The flash of the firmware at the start.
#[cfg(not(feature = "slot"))]
pub(crate) const FIRMWARE: FirmwareFlash = RecordSectors::settings();
#[cfg(feature = "slot")]
pub(crate) const FIRMWARE: FirmwareFlash =
    FirmwareFlash { settings: RecordSectors::settings(), updater: None };

/// Returns the settings' sectors.
pub(crate) const fn settings(flash: &mut FirmwareFlash) -> &mut RecordSectors {
    #[cfg(feature = "slot")]
    let flash = &mut flash.settings;
    flash
}

/// Runs the pending operation of the firmware's flash, as [`RecordSectors::work`].
pub(crate) fn work(flash: &mut FirmwareFlash) {
    #[cfg(feature = "slot")]
    if let Some(updater) = &mut flash.updater {
        let (slot, state, trust) = updater.parts();
        [&mut slot.sectors, state, trust].into_iter().for_each(RecordSectors::work);
    }
    settings(flash).work();
}

/// Two sectors for records, and a pending operation.
pub(crate) struct RecordSectors {
    /// Offset of the first sector.
    first: u32,
    operation: Operation,
    /// The result of the last operation.
    result: Result<(), FlashError>,
    page: [u8; PROGRAM_BYTES],
    boot2: [u32; BOOT2_WORDS],
}

impl RecordSectors {
    /// Returns the settings' sectors. Call it once.
    pub(crate) const fn settings() -> Self {
        Self::at(FIRST_SECTOR)
    }

    /// Returns the sectors at this offset from the start of flash.
    pub(crate) const fn at(first: u32) -> Self {
        Self {
            first,
            operation: Operation::Nothing,
            result: Ok(()),
            page: [0; PROGRAM_BYTES],
            boot2: [0; BOOT2_WORDS],
        }
    }

    /// Runs a pending operation. Call it between iterations of the main loop while the program may block: the fingers are at
    /// rest and no line transmits.
    pub(crate) fn work(&mut self) {
        let operation = core::mem::replace(&mut self.operation, Operation::Nothing);
        if !matches!(operation, Operation::Nothing) {
            self.result = self.run(operation);
        }
    }

    /// Returns the serial number: the flash chip's unique ID reduced to 32 bits, because the RP2040 has none. Returns 0 if the
    /// flash chip has none either. Call it before the main loop.
    pub(crate) fn serial_number(&mut self) -> u32 {
        if self.run(Operation::Identify).is_err() {
            return 0;
        }
        let number =
            self.page.get(UNIQUE_ID).and_then(|bytes| Some(u64::from_be_bytes(*bytes.first_chunk()?)));
        match number {
            // An undriven data line.
            None | Some(0 | u64::MAX) => 0,
            Some(number) => ((number >> 32) as u32).rotate_left(11) ^ number as u32,
        }
    }

    /// Starts to erase the sector at this offset from the start of flash.
    pub(crate) const fn begin_erase(&mut self, at: u32) {
        self.operation = Operation::Erase(at);
    }

    /// Starts to program the page at this offset from the start of flash.
    #[cfg(any(feature = "boot", feature = "slot"))]
    pub(crate) const fn begin_program(&mut self, at: u32, page: &[u8; PROGRAM_BYTES]) {
        self.page = *page;
        self.operation = Operation::Program(at);
    }

    /// Returns the offset of a double word from the start of flash.
    fn offset(&self, page: Page, index: usize) -> Option<u32> {
        let sector = match page {
            Page::First => self.first,
            Page::Second => self.first.wrapping_add(SECTOR_BYTES as u32),
        };
        (index < Self::PAGE_LEN).then(|| sector.wrapping_add((index * DOUBLE_WORD_BYTES) as u32))
    }

    fn run(&mut self, operation: Operation) -> Result<(), FlashError> {
        // SAFETY: the address is in the boot ROM. Without a ROM, the read returns another value.
        let magic = unsafe { with_exposed_provenance::<u32>(ROM_MAGIC_AT).read_volatile() };
        if magic & 0xFF_FFFF != ROM_MAGIC {
            return Err(FlashError::Failed);
        }
        for (word, at) in self.boot2.iter_mut().zip((BOOT2_AT..).step_by(4)) {
            // SAFETY: the address is in flash and aligned, and no code writes there.
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
        // SAFETY: interrupts are disabled. The function is in RAM and uses only the ROM's functions and the buffers of this
        // value. It erases and programs only sectors of records and slots.
        cortex_m::interrupt::free(|_| unsafe {
            run_in_ram(&rom, operation, &mut self.page, &self.boot2);
        });
        Ok(())
    }
}

/// The boot ROM's functions, looked up while the flash is readable.
struct Rom {
    connect_internal_flash: unsafe extern "C" fn(),
    flash_exit_xip: unsafe extern "C" fn(),
    flash_range_erase: unsafe extern "C" fn(u32, usize, u32, u8),
    flash_range_program: unsafe extern "C" fn(u32, *const u8, usize),
    flash_flush_cache: unsafe extern "C" fn(),
}

/// Erases, programs or reads the ID. Placed in RAM, because the flash is unreadable meanwhile.
///
/// # Safety
/// Interrupts are disabled, no other code uses the flash, and `boot2` is the second boot stage.
#[unsafe(link_section = ".data.run_in_ram")]
#[inline(never)]
unsafe fn run_in_ram(
    rom: &Rom,
    operation: Operation,
    page: &mut [u8; PROGRAM_BYTES],
    boot2: &[u32; BOOT2_WORDS],
) {
    // SAFETY: the order follows the data sheet. The second boot stage returns to its caller and makes the flash readable again
    // (its address is odd: Thumb).
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

/// Reads the flash chip's unique ID. The ROM's cache flush returns the pin to the interface.
///
/// # Safety
/// As for [`run_in_ram`], which calls it. The ROM's exit from XIP leaves the interface in single-line byte mode.
#[inline(always)]
unsafe fn identify(answer: &mut [u8; PROGRAM_BYTES]) {
    let [select, status, data] = [QSPI_SS_CTRL, SSI_SR, SSI_DR0].map(with_exposed_provenance_mut::<u32>);
    // SAFETY: these are registers that no other code uses meanwhile.
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

/// Reads the double word at an offset from the start of flash, a multiple of 8 in the flash.
pub(crate) fn double_word(at: u32) -> u64 {
    let low = with_exposed_provenance::<u32>(UNCACHED.wrapping_add(at as usize));
    // SAFETY: both words are in flash and aligned. Only `run_in_ram` writes them.
    let (low, high) = unsafe { (low.read_volatile(), low.wrapping_add(1).read_volatile()) };
    u64::from(low) | u64::from(high) << 32
}

impl NorFlash for RecordSectors {
    const PAGE_LEN: usize = SECTOR_BYTES / DOUBLE_WORD_BYTES;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        Ok(double_word(self.offset(page, index).ok_or(Unreadable)?))
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        let at = self.offset(page, index).ok_or(FlashError::Failed)?;
        let start = at as usize % PROGRAM_BYTES;
        self.page.fill(0xFF);
        let place = self.page.get_mut(start..).and_then(<[u8]>::first_chunk_mut);
        *place.ok_or(FlashError::Failed)? = value.to_le_bytes();
        self.operation = Operation::Program(at - start as u32);
        Ok(())
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.begin_erase(self.offset(page, 0).ok_or(FlashError::Failed)?);
        Ok(())
    }

    /// A read-back verifies the operation. A boot loader has nothing else to do, so it runs the operation here.
    fn poll(&mut self) -> nb::Result<(), FlashError> {
        if cfg!(feature = "boot") {
            self.work();
        }
        match self.operation {
            Operation::Nothing => self.result.map_err(nb::Error::Other),
            _ => Err(nb::Error::WouldBlock),
        }
    }
}
