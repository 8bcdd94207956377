//! Two flash pages of an STM32L4 and their faults: power failures, wear, and missing flash.

use std::cell::RefCell;

use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Progress, Slot, Store, Unreadable};
use wsg_protocol::Instant;

use crate::flash_pages::{FlashPages, Operation};
pub use crate::flash_pages::{PAGE_LEN, Tear};
use crate::slot_model::SlotModel;

/// A fault of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Every read returns this value and stores are ignored, as in an emulator without a flash controller.
    Swallows(u64),
    /// Every operation is rejected.
    Protected,
    /// No operation ends.
    Stuck,
    /// Erasing leaves a zero bit in this double word.
    Worn(usize),
    /// This double word cannot be programmed.
    Unprogrammable(Page, usize),
}

/// The simulated flash.
#[derive(Clone, Default)]
pub struct FlashModel {
    pages: RefCell<FlashPages>,
    running: Option<(Operation, u32)>,
    /// Number of busy results before an operation ends.
    pub busy_polls: u32,
    /// The current fault, if any.
    pub fault: Option<Fault>,
    /// Number of the operation, as in [`Self::operations`], during which power fails.
    pub cut: Option<(u32, Tear)>,
    is_off: bool,
    /// Number of operations started.
    pub operations: u32,
    /// Number of erases per page.
    pub erases: [u32; 2],
    /// Number of attempts to program a double word again.
    pub refused: u32,
    /// Slot B, if there is a boot loader.
    pub slot: Option<SlotModel>,
}

impl FlashModel {
    /// Creates erased flash.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates flash with a record of this version.
    ///
    /// # Panics
    /// Panics when the record is too long.
    #[must_use]
    pub fn with_record(version: u16, words: &[u16]) -> Self {
        let mut flash = Self::new();
        let mut store = Store::<400>::new();
        let _ = store.load(&flash);
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        store.begin(version, &bytes).expect("the record fits");
        while store.poll(&mut flash, Instant::from_millis(0)) == Progress::Saving {}
        flash
    }

    /// Returns whether the power was cut, after which no operation ends.
    #[must_use]
    pub fn is_off(&self) -> bool {
        self.is_off
    }

    /// Restores power.
    pub fn reboot(&mut self) {
        self.cut = None;
        self.is_off = false;
        self.running = None;
    }

    /// Sets a double word; [`None`] makes it unreadable.
    pub fn set(&mut self, page: Page, index: usize, value: Option<u64>) {
        self.pages.get_mut().set(page as usize, index, value);
    }

    /// Makes reads of a double word vary between this value, its current value and an error.
    pub fn set_changing(&mut self, page: Page, index: usize, value: u64) {
        self.pages.get_mut().set_changing(page as usize, index, value);
    }

    fn end(&mut self, operation: Operation) -> Result<(), FlashError> {
        match (self.fault, operation) {
            (Some(Fault::Swallows(_)), _) => return Ok(()),
            (Some(Fault::Unprogrammable(page, index)), Operation::Program(of, n, _))
                if (page as usize, index) == (of, n) =>
            {
                return Err(FlashError::Failed);
            }
            _ => {}
        }
        let pages = self.pages.get_mut();
        if pages.apply(operation).is_err() {
            self.refused += 1;
            return Err(FlashError::NotErased);
        }
        if let (Some(Fault::Worn(index)), Operation::Erase(page)) = (self.fault, operation) {
            pages.set(page, index, Some(!(1 << 40)));
        }
        Ok(())
    }

    fn tear(&mut self, operation: Operation, tear: Tear) {
        let before = self.pages.get_mut().clone();
        let _ = self.end(operation);
        self.pages.get_mut().tear(&before, operation, tear);
    }

    fn begin(&mut self, operation: Operation) -> Result<(), FlashError> {
        if self.is_off {
            return Ok(());
        }
        if self.running.is_some() {
            return Err(FlashError::Busy);
        }
        if self.fault == Some(Fault::Protected) {
            return Err(FlashError::Protected);
        }
        if let Some((at, tear)) = self.cut
            && at == self.operations
        {
            self.tear(operation, tear);
            self.is_off = true;
        }
        self.operations += 1;
        if let Operation::Erase(page) = operation {
            self.erases[page] += 1;
        }
        self.running = Some((operation, self.busy_polls));
        Ok(())
    }
}

impl NorFlash for FlashModel {
    const PAGE_LEN: usize = PAGE_LEN;

    /// # Panics
    /// Panics while an operation is in progress, because the caller must not read then.
    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        assert!(self.running.is_none(), "read while an operation runs");
        if let Some(Fault::Swallows(value)) = self.fault {
            return Ok(value);
        }
        self.pages.borrow_mut().read(page as usize, index)
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        self.begin(Operation::Program(page as usize, index, value))
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.begin(Operation::Erase(page as usize))
    }

    fn slot(&mut self) -> Option<&mut dyn Slot> {
        self.slot.as_mut().map(|slot| slot as _)
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        match self.running {
            _ if self.is_off || self.fault == Some(Fault::Stuck) => Err(nb::Error::WouldBlock),
            None => Ok(()),
            Some((operation, 0)) => {
                self.running = None;
                self.end(operation).map_err(nb::Error::Other)
            }
            Some((operation, polls)) => {
                self.running = Some((operation, polls - 1));
                Err(nb::Error::WouldBlock)
            }
        }
    }
}
