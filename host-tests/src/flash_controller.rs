//! Model of the flash interface of STM32L4 and STM32G4 (RM0351, RM0440, chapter 3): its registers, the pages of records at the
//! end of bank 2 and, for a boot loader, both slots. QEMU itself serves loads from the slots.
//!
//! The text of RM0351 was not available. Registers and bits follow ST's register header for the STM32L475. The rules
//! follow RM0440, whose dual-bank STM32G4 has the same interface under the same section numbers. Fast programming,
//! mass erase, option bytes and interrupts are rejected.
//!
//! [`FlashController::violations`] records accesses that the manual forbids, including those that the hardware merely
//! delays. The manual does not say whether a second load of an unreadable double word raises a second NMI (3.3.2: the
//! current buffer may still hold it); in this model it does.

use std::collections::{BTreeSet, VecDeque};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Result, bail, ensure};
use wsg_bridge_fw::storage::Page;

use crate::flash_pages::{FlashPages, Operation, PAGE_LEN, Tear};
use crate::load_store::Width;
use crate::registers::{Machine, RegisterModel, ensure_word};

/// Base address and register offsets (RM0351, table 1; 3.7).
pub(crate) const FLASH: u32 = 0x4002_2000;
const LEN: u32 = 0x400;
const ACR: u32 = 0x00;
const KEYR: u32 = 0x08;
const SR: u32 = 0x10;
const CR: u32 = 0x14;
const ECCR: u32 = 0x18;
const OPTR: u32 = 0x20;

/// What differs between microcontrollers.
#[derive(Debug)]
pub struct Layout {
    /// The pages of records: two each for rollback counter, boot loader's state and settings.
    memory: Range<u32>,
    /// Start of bank 2 and of slot B.
    bank_two: u32,
    /// PNB in CR (3.7.6).
    pnb: u32,
    /// Bits of ACR (3.7.1), and their value after a reset.
    acr: u32,
    acr_reset: u32,
    /// BK_ECC in ECCR (3.7.7).
    bk_ecc: u32,
    /// OPTR of a new chip (3.7.8), if the driver depends on it.
    optr: Option<u32>,
}

impl Layout {
    /// STM32L475VG: 1 MiB.
    pub const STM32L475: Self = Self {
        memory: 0x080F_D000..0x0810_0000,
        bank_two: 0x0808_0000,
        pnb: 0xFF << 3,
        acr: 0x0000_7F07,
        acr_reset: 0x0000_0600,
        bk_ecc: 1 << 19,
        optr: None,
    };

    /// STM32G474RE: 512 KiB, in two banks.
    pub const STM32G474: Self = Self {
        memory: 0x0807_D000..0x0808_0000,
        bank_two: 0x0804_0000,
        pnb: 0x7F << 3,
        acr: 0x0004_7F0F,
        acr_reset: 0x0004_0600,
        bk_ecc: 1 << 21,
        optr: Some(0xFFEF_F8AA),
    };
}

/// Start of the flash.
const START: u32 = 0x0800_0000;
/// Start of slot A.
const SLOT_A: u32 = START + 0x8000;
const PAGE_BYTES: u32 = 8 * PAGE_LEN as u32;

/// Numbers of pages: records, with the settings' last, then slot A, then slot B.
const RECORDS: usize = 6;
const BOOT_STATE: usize = 2;
const SETTINGS: usize = 4;
const IN_SLOT_A: usize = wsg_update::SLOT_LEN as usize / (8 * PAGE_LEN);
const SLOT_B_AT: usize = RECORDS + IN_SLOT_A;
const WITH_SLOTS: usize = SLOT_B_AT + IN_SLOT_A + 1;

/// OPTR of the STM32G4 (RM0440, 3.7.8): two banks.
const DBANK: u32 = 1 << 22;

/// Bits of ACR (3.7.1): instruction and data cache enable and reset.
const ICEN: u32 = 1 << 9;
const DCEN: u32 = 1 << 10;
const ICRST: u32 = 1 << 11;
const DCRST: u32 = 1 << 12;

/// Unlock keys of CR (3.3.5).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// A bit of SR (3.7.5), in addition to the flags of [`ErrorFlag`].
const BSY: u32 = 1 << 16;

/// Bits of CR (3.7.6).
const PG: u32 = 1 << 0;
const PER: u32 = 1 << 1;
const BKER: u32 = 1 << 11;
const STRT: u32 = 1 << 16;
const OPTLOCK: u32 = 1 << 30;
const LOCK: u32 = 1 << 31;
const CR_BITS: u32 = PG | PER | BKER | STRT | OPTLOCK | LOCK;

/// Bits of ECCR (3.7.7): address, uncorrectable error in the upper half of a line of a single bank, corrected error,
/// uncorrectable error.
const ADDR_ECC: u32 = 0x0007_FFFF;
const ECCD2: u32 = 1 << 29;
const ECCC: u32 = 1 << 30;
const ECCD: u32 = 1 << 31;

/// Typical durations (data sheet of the STM32L475, table 61).
const PROGRAM_TIME: Duration = Duration::from_micros(82);
const ERASE_TIME: Duration = Duration::from_millis(22);

/// Capacity of the data cache in double words (3.3.4): 8 rows of 4.
const CACHED: usize = 32;

/// An error of an operation; the value is the bit of SR (3.7.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorFlag {
    /// OPERR: needs another error with the error interrupt enabled, so it occurs only as a [`Fault`] here.
    Operation = 1 << 1,
    /// PROGERR: the double word was not erased.
    Programming = 1 << 3,
    /// WRPERR: the page is write protected.
    WriteProtection = 1 << 4,
    /// PGAERR: two stores that do not form a double word.
    Alignment = 1 << 5,
    /// SIZERR: a store of a byte or a halfword.
    Size = 1 << 6,
    /// PGSERR: wrong order of stores or bits, or an operation after an uncleared error.
    Sequence = 1 << 7,
    /// MISERR: in fast programming.
    Miss = 1 << 8,
    /// FASTERR: in fast programming.
    Fast = 1 << 9,
}

impl ErrorFlag {
    /// All errors.
    pub const ALL: [Self; 8] = [
        Self::Operation,
        Self::Programming,
        Self::WriteProtection,
        Self::Alignment,
        Self::Size,
        Self::Sequence,
        Self::Miss,
        Self::Fast,
    ];
}

/// A fault of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Operations fail with this flag and have no effect.
    Reports(ErrorFlag),
    /// No operation ends.
    Stuck,
    /// No key unlocks the interface, as after a wrong one.
    LockedUp,
    /// The next access to the interface coincides with an unreadable word of the program in bank 1.
    UnreadableProgram,
}

/// The interface with its registers; clones share it. The pages survive a reset and a [power
/// cycle](Self::power_cycle).
#[derive(Clone, Debug)]
pub struct FlashController(Arc<Mutex<State>>);

/// The flash up to the machine's next power cycle; later accesses are rejected.
#[derive(Clone, Debug)]
struct Powered {
    flash: FlashController,
    power_cycles: u32,
}

/// The register block as seen by the core, or a part of it.
#[derive(Debug)]
struct Registers(Powered, Range<u32>);

/// The memory of the pages as seen by the core.
#[derive(Debug)]
struct Memory(Powered, Range<u32>);

/// A slot as seen by the core, which loads from QEMU's memory.
#[derive(Debug)]
struct Slot(Powered, Range<u32>);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Lock {
    Locked,
    FirstKey,
    Open,
    /// Until reset.
    LockedUp,
}

#[derive(Debug)]
struct State {
    layout: &'static Layout,
    optr: u32,
    has_slots: bool,
    pages: FlashPages,
    /// Bytes of slots to be written to QEMU's memory, and their addresses.
    written: Vec<(u32, Vec<u8>)>,
    /// Double words with one wrong bit, which is corrected on reading.
    correctable: BTreeSet<usize>,
    acr: u32,
    sr: u32,
    cr: u32,
    eccr: u32,
    lock: Lock,
    first_word: Option<(u32, u32)>,
    running: Option<(Operation, Duration)>,
    /// Data cache: indices of double words across both pages, and their values.
    cached: VecDeque<(usize, u64)>,
    /// Whether cached double words have been erased since.
    is_cache_stale: bool,
    fault: Option<Fault>,
    cut: Option<(u32, Tear)>,
    is_off: bool,
    power_cycles: u32,
    operations: u32,
    erases: u32,
    violations: Vec<String>,
}

impl FlashController {
    /// Creates erased pages after power-on.
    #[must_use]
    pub fn new(layout: &'static Layout) -> Self {
        Self(Arc::new(Mutex::new(State {
            layout,
            optr: layout.optr.unwrap_or(0),
            has_slots: false,
            pages: FlashPages::of(WITH_SLOTS, PAGE_LEN),
            written: Vec::new(),
            correctable: BTreeSet::new(),
            acr: layout.acr_reset,
            sr: 0,
            cr: OPTLOCK | LOCK,
            eccr: 0,
            lock: Lock::Locked,
            first_word: None,
            running: None,
            cached: VecDeque::new(),
            is_cache_stale: false,
            fault: None,
            cut: None,
            is_off: false,
            power_cycles: 0,
            operations: 0,
            erases: 0,
            violations: Vec::new(),
        })))
    }

    /// Creates flash with slots. They and the pages of the boot loader's state begin with these contents.
    ///
    /// # Panics
    /// Panics when a content exceeds the flash.
    #[must_use]
    pub fn with_slots(layout: &'static Layout, a: &[u8], b: &[u8], boot_state: &[u8]) -> Self {
        let flash = Self::new(layout);
        let mut state = flash.lock();
        state.has_slots = true;
        for (first, content) in [(RECORDS, a), (SLOT_B_AT, b), (BOOT_STATE, boot_state)] {
            for (number, bytes) in content.chunks(8).enumerate() {
                let mut double_word = [0xFF; 8];
                double_word[..bytes.len()].copy_from_slice(bytes);
                let (page, index) = (first + number / PAGE_LEN, number % PAGE_LEN);
                let operation = Operation::Program(page, index, u64::from_le_bytes(double_word));
                // Erased double words remain programmable.
                if double_word != [0xFF; 8] {
                    state.pages.apply(operation).expect("the flash is erased");
                }
            }
        }
        drop(state);
        flash
    }

    /// Returns other flash with the same content, after power-on.
    #[must_use]
    pub fn copy(&self) -> Self {
        let state = self.lock();
        let copy = Self::new(state.layout);
        {
            let copied = &mut *copy.lock();
            (copied.pages, copied.has_slots) = (state.pages.clone(), state.has_slots);
        }
        copy
    }

    /// Returns the addresses and the contents of both slots.
    #[must_use]
    pub fn slots(&self) -> [(u32, Vec<u8>); 2] {
        let state = self.lock();
        let content = |pages: Range<usize>| {
            let places = pages.flat_map(|page| (0..PAGE_LEN).map(move |index| (page, index)));
            places.flat_map(|(page, index)| state.pages.bits(page, index).to_le_bytes()).collect()
        };
        [(SLOT_A, content(RECORDS..SLOT_B_AT)), (state.layout.bank_two, content(SLOT_B_AT..WITH_SLOTS))]
    }

    /// Returns the models of registers and pages, valid until the next [power cycle](Self::power_cycle).
    #[must_use]
    pub fn models(&self) -> Vec<Box<dyn RegisterModel>> {
        let (memory, has_slots) = {
            let state = self.lock();
            (state.layout.memory.clone(), state.has_slots)
        };
        let mut models: Vec<Box<dyn RegisterModel>> =
            vec![Box::new(self.registers(FLASH..FLASH + LEN)), Box::new(Memory(self.powered(), memory))];
        if has_slots {
            models.extend(self.slots().map(|(start, bytes)| {
                let addresses = start..start + bytes.len() as u32;
                Box::new(Slot(self.powered(), addresses)) as Box<dyn RegisterModel>
            }));
        }
        models
    }

    /// Returns the model of FLASH_ACR alone, for a board without the other models.
    #[cfg(unix)]
    pub(crate) fn access_control(&self) -> Box<dyn RegisterModel> {
        Box::new(self.registers(FLASH + ACR..FLASH + ACR + 4))
    }

    fn registers(&self, addresses: Range<u32>) -> Registers {
        Registers(self.powered(), addresses)
    }

    fn powered(&self) -> Powered {
        Powered { flash: self.clone(), power_cycles: self.lock().power_cycles }
    }

    /// Returns the driver's accesses that the manual forbids.
    #[must_use]
    pub fn violations(&self) -> Vec<String> {
        self.lock().violations.clone()
    }

    /// Returns the number of operations started.
    #[must_use]
    pub fn operations(&self) -> u32 {
        self.lock().operations
    }

    /// Returns the number of pages erased.
    #[must_use]
    pub fn erases(&self) -> u32 {
        self.lock().erases
    }

    /// Returns whether the state is that after reset: no operation in progress, FLASH_CR locked, caches enabled.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let state = self.lock();
        !state.is_busy() && state.cr & LOCK != 0 && state.acr & (ICEN | DCEN) == ICEN | DCEN
    }

    /// Leaves FLASH_CR unlocked and a flag set, as a boot loader or a debugger may.
    pub fn leave_open(&self, flag: ErrorFlag) {
        let state = &mut *self.lock();
        state.sr |= flag as u32;
        state.lock = Lock::Open;
        state.cr &= !LOCK;
    }

    /// Sets the option of an STM32G4 for a single bank, as an integrator may. Its lines have two double words.
    pub fn set_single_bank(&self) {
        self.lock().optr &= !DBANK;
    }

    /// Sets or clears a fault.
    pub fn set_fault(&self, fault: Option<Fault>) {
        self.lock().fault = fault;
    }

    /// Cuts the power during the operation number `count` from now, counted from 0, with the effect `tear` on its
    /// double words. The board continues until it is dropped and finds the flash busy; with slots, its next access to the flash
    /// ends it, because a boot loader waits for its watchdog.
    pub fn cut(&self, count: u32, tear: Tear) {
        let state = &mut *self.lock();
        state.cut = Some((state.operations + count, tear));
    }

    /// Returns whether the power was cut.
    #[must_use]
    pub fn is_off(&self) -> bool {
        self.lock().is_off
    }

    /// Power-cycles the flash: the pages keep their content, and everything else is reset.
    pub fn power_cycle(&self) {
        let state = &mut *self.lock();
        (state.cut, state.is_off) = (None, false);
        state.power_cycles += 1;
        state.reset();
    }

    /// Returns the stored double word; [`None`] if it is unreadable.
    #[must_use]
    pub fn double_word(&self, page: Page, index: usize) -> Option<u64> {
        self.lock().pages.read(SETTINGS + page as usize, index).ok()
    }

    /// Sets a double word; [`None`] makes it unreadable.
    pub fn set(&self, page: Page, index: usize, value: Option<u64>) {
        self.lock().pages.set(SETTINGS + page as usize, index, value);
    }

    /// Gives a double word a correctable error: it reads correctly and sets ECCC.
    pub fn set_correctable(&self, page: Page, index: usize) {
        self.lock().correctable.insert(number(SETTINGS + page as usize, index));
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the index of a double word across all pages.
const fn number(page: usize, index: usize) -> usize {
    page * PAGE_LEN + index
}

impl State {
    /// Returns the double word at this address in a page of the model.
    fn place(&self, address: u32) -> (usize, usize) {
        let page =
            self.page((address - START) / PAGE_BYTES).expect("QEMU stops in the pages of the model alone");
        (page, (address % PAGE_BYTES) as usize / 8)
    }

    /// Returns the first page of records, slot A and slot B, counted from the start of the flash, and their numbers.
    fn starts(&self) -> [(u32, Range<usize>); 3] {
        let page = |address: u32| (address - START) / PAGE_BYTES;
        [
            (page(self.layout.memory.start), 0..RECORDS),
            (page(SLOT_A), RECORDS..SLOT_B_AT),
            (page(self.layout.bank_two), SLOT_B_AT..WITH_SLOTS),
        ]
    }

    /// Returns the number of a page, counted from the start of the flash.
    fn page(&self, of_flash: u32) -> Option<usize> {
        let modelled = self.starts().into_iter().take(if self.has_slots { 3 } else { 1 });
        modelled
            .filter_map(|(start, pages)| Some((of_flash.checked_sub(start)? as usize, pages)))
            .find_map(|(offset, pages)| (offset < pages.len()).then_some(pages.start + offset))
    }

    /// Returns the address of a page.
    fn address(&self, page: usize) -> u32 {
        let starts = self.starts();
        let (start, pages) =
            starts.iter().find(|(_, pages)| pages.contains(&page)).expect("a page of the model");
        START + (*start + (page - pages.start) as u32) * PAGE_BYTES
    }

    /// Resets the interface and discards an operation in progress; [`FlashController::cut`] models partial ones.
    fn reset(&mut self) {
        (self.acr, self.sr, self.cr, self.eccr) = (self.layout.acr_reset, 0, OPTLOCK | LOCK, 0);
        self.lock = Lock::Locked;
        (self.first_word, self.running) = (None, None);
        self.cached.clear();
        self.is_cache_stale = false;
    }

    fn is_busy(&self) -> bool {
        self.running.is_some()
    }

    fn forbidden(&mut self, what: impl Into<String>) {
        self.violations.push(what.into());
    }

    fn fail(&mut self, flag: ErrorFlag) {
        self.sr |= flag as u32;
    }

    /// 3.3.6, 3.3.7: no operation starts before all errors are cleared.
    fn has_stale_error(&mut self) -> bool {
        let is_stale = ErrorFlag::ALL.iter().any(|flag| self.sr & *flag as u32 != 0);
        if is_stale {
            self.fail(ErrorFlag::Sequence);
        }
        is_stale
    }

    fn store(&mut self, offset: u32, value: u32) -> Result<()> {
        match offset {
            ACR => self.store_acr(value),
            KEYR => self.store_key(value),
            // 3.7.5: flags are cleared by writing 1.
            SR => self.sr &= !value,
            CR => self.store_cr(value)?,
            ECCR => self.eccr &= !(value & (ECCC | ECCD2 | ECCD)),
            _ => bail!("the register of FLASH at {offset:#04X} is not modelled"),
        }
        Ok(())
    }

    fn store_acr(&mut self, value: u32) {
        let enabled = self.acr | value;
        if value & DCRST != 0 && enabled & DCEN != 0 || value & ICRST != 0 && enabled & ICEN != 0 {
            self.forbidden("3.3.7: a cache was flushed while enabled");
        } else if value & DCRST != 0 {
            self.cached.clear();
            self.is_cache_stale = false;
        }
        if value & DCEN != 0 && self.is_cache_stale {
            self.forbidden("3.3.7: the data cache was enabled again without a flush after an erase");
        }
        self.acr = value & self.layout.acr;
    }

    fn store_key(&mut self, value: u32) {
        if self.fault == Some(Fault::LockedUp) {
            return;
        }
        self.lock = match self.lock {
            Lock::Locked if value == KEYS[0] => Lock::FirstKey,
            Lock::FirstKey if value == KEYS[1] => {
                self.cr &= !LOCK;
                Lock::Open
            }
            _ => {
                self.forbidden(format!(
                    "3.3.5: wrong key {value:#010X}: a bus error, and locked until reset"
                ));
                self.cr |= LOCK;
                Lock::LockedUp
            }
        };
    }

    fn store_cr(&mut self, value: u32) -> Result<()> {
        if self.is_busy() {
            self.forbidden("3.3.5: a store to FLASH_CR while an operation runs stalls the core");
        }
        if self.cr & LOCK != 0 {
            self.forbidden("3.3.5: a store to FLASH_CR while it is locked");
            return Ok(());
        }
        ensure!(
            value & !(CR_BITS | self.layout.pnb) == 0,
            "{value:#010X}: fast programming, mass erase, option bytes and interrupts are not modelled"
        );
        let selection = PER | self.layout.pnb | BKER;
        if value & STRT != 0 && (self.cr ^ value) & selection != 0 {
            self.forbidden("3.3.6: a page was selected and its erase started by one store");
        }
        // The hardware clears STRT.
        self.cr = value | self.cr & STRT;
        if value & LOCK != 0 {
            self.lock = Lock::Locked;
            if value & (PG | PER) != 0 {
                self.forbidden("3.3.7: PG or PER was left set after the last operation");
            }
        }
        if value & PG == 0 {
            self.first_word = None;
        }
        if value & PG != 0 && value & PER != 0 {
            self.fail(ErrorFlag::Sequence);
        }
        if value & STRT != 0 {
            self.start_erase();
        }
        Ok(())
    }

    fn start_erase(&mut self) {
        let bank = if self.cr & BKER == 0 { 0 } else { (self.layout.bank_two - START) / PAGE_BYTES };
        let page = match self.page(bank + ((self.cr & self.layout.pnb) >> 3)) {
            _ if self.cr & PER == 0 => {
                self.forbidden("3.3.6: an erase was started without PER");
                None
            }
            _ if self.has_stale_error() => None,
            None => {
                self.forbidden(format!("CR {:#010X}: erase of a page outside of the model", self.cr));
                None
            }
            page => page,
        };
        match page {
            Some(page) => {
                self.begin(Operation::Erase(page), ERASE_TIME);
                self.erases += 1;
            }
            None => self.cr &= !STRT,
        }
    }

    fn store_memory(&mut self, address: u32, width: Width, value: u32) {
        if self.is_busy() {
            self.forbidden("3.3.5: a store to the bank that is programmed or erased stalls the core");
        } else if width != Width::Word {
            self.fail(ErrorFlag::Size);
        } else if self.cr & PG == 0 {
            self.fail(ErrorFlag::Sequence);
        } else if !self.has_stale_error() {
            match self.first_word.take() {
                None if address.is_multiple_of(8) => self.first_word = Some((address, value)),
                Some((first, low)) if first + 4 == address => {
                    let (page, index) = self.place(first);
                    let value = u64::from(low) | u64::from(value) << 32;
                    self.begin(Operation::Program(page, index, value), PROGRAM_TIME);
                }
                _ => self.fail(ErrorFlag::Alignment),
            }
        }
    }

    fn begin(&mut self, operation: Operation, time: Duration) {
        if self.acr & DCEN != 0 {
            self.forbidden("erratum: the data cache was on while bank 2 was written and bank 1 read");
        }
        if let Some((at, tear)) = self.cut
            && at == self.operations
        {
            let before = self.pages.clone();
            // A failed operation leaves no change either.
            let _ = self.pages.apply(operation);
            self.pages.tear(&before, operation, tear);
            self.is_off = true;
        }
        self.operations += 1;
        self.running = Some((operation, time));
    }

    fn advance(&mut self, time: Duration) {
        if let Some((operation, left)) = &mut self.running
            && !self.is_off
            && self.fault != Some(Fault::Stuck)
        {
            *left = left.saturating_sub(time);
            if left.is_zero() {
                let operation = *operation;
                self.running = None;
                self.cr &= !STRT;
                self.end(operation);
            }
        }
    }

    fn end(&mut self, operation: Operation) {
        if let Some(Fault::Reports(flag)) = self.fault {
            return self.fail(flag);
        }
        if self.pages.apply(operation).is_err() {
            return self.fail(ErrorFlag::Programming);
        }
        let (page, bytes) = match operation {
            Operation::Program(page, index, value) => (page, (8 * index, value.to_le_bytes().to_vec())),
            Operation::Erase(page) => (page, (0, vec![0xFF; PAGE_BYTES as usize])),
        };
        if page >= RECORDS {
            self.written.push((self.address(page) + bytes.0 as u32, bytes.1));
        }
        // 3.3.7: programming updates the cache, erasing does not.
        match operation {
            Operation::Program(page, index, value) => {
                let cached = self.cached.iter_mut().find(|(of, _)| *of == number(page, index));
                cached.into_iter().for_each(|(_, of_cache)| *of_cache = value);
            }
            Operation::Erase(page) => {
                self.is_cache_stale |= self.cached.iter().any(|(of, _)| of / PAGE_LEN == page);
            }
        }
    }

    /// Returns the loaded value and whether it raises an NMI.
    fn load_memory(&mut self, address: u32, width: Width) -> (u32, bool) {
        if self.is_busy() {
            self.forbidden("3.3.5: a load from the bank that is programmed or erased stalls the core");
        }
        let (page, index) = self.place(address);
        let at = number(page, index);
        let part = |double_word: u64| width.of((double_word >> (8 * (address % 8))) as u32);
        let is_cache_on = self.acr & DCEN != 0;
        if is_cache_on && let Some((_, value)) = self.cached.iter().find(|(of, _)| *of == at) {
            return (part(*value), false);
        }
        match self.pages.read(page, index) {
            Ok(value) => {
                if self.correctable.contains(&at) {
                    self.report(ECCC, address);
                }
                if is_cache_on {
                    self.cached.truncate(CACHED - 1);
                    self.cached.push_front((at, value));
                }
                (part(value), false)
            }
            Err(_) => {
                if self.eccr & (ECCC | ECCD) != 0 {
                    self.forbidden(
                        "3.3.2: a load while a flag of FLASH_ECCR was set: its error stays undetected",
                    );
                }
                let is_upper_half = self.layout.optr.is_some() && self.optr & DBANK == 0 && index % 2 == 1;
                let flag = if is_upper_half { ECCD2 } else { ECCD };
                (part(self.pages.bits(page, index)), self.report(flag, address))
            }
        }
    }

    /// Consumes the fault [`Fault::UnreadableProgram`]. Returns whether it was set.
    fn program_is_unreadable(&mut self) -> bool {
        let is_unreadable = self.fault == Some(Fault::UnreadableProgram);
        if is_unreadable {
            self.fault = None;
            self.eccr = ECCD;
        }
        is_unreadable
    }

    /// 3.3.2: updates ECCR only while its flags are clear. Returns whether it did.
    fn report(&mut self, flag: u32, address: u32) -> bool {
        let is_told = self.eccr & (ECCC | ECCD2 | ECCD) == 0;
        if is_told {
            self.eccr = flag | self.layout.bk_ecc | address & !0b111 & ADDR_ECC;
        }
        is_told
    }
}

impl Powered {
    fn state(&self) -> Result<MutexGuard<'_, State>> {
        let state = self.flash.lock();
        ensure!(state.power_cycles == self.power_cycles, "the flash has been power-cycled");
        ensure!(!(state.is_off && state.has_slots), "the power was cut");
        Ok(state)
    }
}

impl RegisterModel for Registers {
    fn addresses(&self) -> Range<u32> {
        self.1.clone()
    }

    fn load(&mut self, address: u32) -> Result<u32> {
        let state = self.0.state()?;
        Ok(match address - FLASH {
            ACR => state.acr,
            KEYR => 0,
            SR => state.sr | if state.is_busy() { BSY } else { 0 },
            CR => state.cr,
            ECCR => state.eccr,
            OPTR if state.layout.optr.is_some() => state.optr,
            offset => bail!("the register of FLASH at {offset:#04X} is not modelled"),
        })
    }

    fn store(&mut self, address: u32, value: u32) -> Result<()> {
        self.0.state()?.store(address - FLASH, value)
    }

    fn load_through(&mut self, address: u32, width: Width, machine: &mut dyn Machine) -> Result<u32> {
        ensure_word(address, width)?;
        if self.0.state()?.program_is_unreadable() {
            machine.raise_nmi()?;
        }
        self.load(address)
    }

    fn advance(&mut self, time: Duration) {
        if let Ok(mut state) = self.0.state() {
            state.advance(time);
        }
    }

    fn reset(&mut self) {
        if let Ok(mut state) = self.0.state() {
            state.reset();
        }
    }
}

impl RegisterModel for Memory {
    fn addresses(&self) -> Range<u32> {
        self.1.clone()
    }

    fn store_through(&mut self, address: u32, width: Width, value: u32, _: &mut dyn Machine) -> Result<()> {
        self.0.state()?.store_memory(address, width, value);
        Ok(())
    }

    fn load_through(&mut self, address: u32, width: Width, machine: &mut dyn Machine) -> Result<u32> {
        ensure!(address.is_multiple_of(width.bytes()), "a load across words is not modelled");
        let (value, raises_nmi) = self.0.state()?.load_memory(address, width);
        if raises_nmi {
            machine.raise_nmi()?;
        }
        Ok(value)
    }
}

impl RegisterModel for Slot {
    fn addresses(&self) -> Range<u32> {
        self.1.clone()
    }

    fn loads_memory(&self) -> bool {
        true
    }

    fn store_through(&mut self, address: u32, width: Width, value: u32, _: &mut dyn Machine) -> Result<()> {
        self.0.state()?.store_memory(address, width, value);
        Ok(())
    }

    fn take_written(&mut self) -> Vec<(u32, Vec<u8>)> {
        self.0.state().map(|mut state| std::mem::take(&mut state.written)).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests;
