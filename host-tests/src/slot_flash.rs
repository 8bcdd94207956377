//! A board's flash for the boot loader: both slots and the pages of both records, with the geometry of its chip.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;

use wsg_boot::{Blocking, Flash, PolledFlash};
use wsg_bridge_fw::storage::{self, FlashError, Page, Unreadable};

use crate::flash_pages::{FlashPages, Operation};

const BYTES: usize = 8;

/// Called with the flash before and after an operation, and with the page and the double words that it changes.
pub type Observer = Rc<dyn Fn(&FlashPages, &FlashPages, usize, Range<usize>)>;

/// Flash with pages of `PAGE` bytes; slots are written in units of `UNIT` bytes. Clones share it.
///
/// Units of a double word have error detection and refuse to be written twice, as in an STM32. Larger units have neither, as
/// in the RP2040's flash.
#[derive(Clone)]
pub struct SlotFlash<const PAGE: usize, const UNIT: usize>(Rc<RefCell<State>>);

struct State {
    pages: FlashPages,
    slot: usize,
    observer: Option<Observer>,
    operations: u32,
    /// Number of busy results before an operation ends.
    busy_polls: u32,
    /// Busy results to come.
    busy: u32,
    /// Operation, as in `operations`, that ends without an effect.
    fails_at: Option<u32>,
}

/// The flash of the boot loader.
pub type Parts<const PAGE: usize, const UNIT: usize> =
    Flash<Blocking<Part<PAGE, UNIT>>, Blocking<Part<PAGE, UNIT>>, Part<PAGE, UNIT>, Part<PAGE, UNIT>>;

/// Pages of a slot or of a record.
#[derive(Clone)]
pub struct Part<const PAGE: usize, const UNIT: usize>(SlotFlash<PAGE, UNIT>, Range<usize>);

impl<const PAGE: usize, const UNIT: usize> SlotFlash<PAGE, UNIT> {
    /// Creates erased flash with slots of this number of pages.
    #[must_use]
    pub fn new(slot: usize) -> Self {
        Self::with(FlashPages::of(2 * slot + 1 + 4, PAGE / BYTES), slot)
    }

    /// Creates flash with this content.
    #[must_use]
    pub fn with(pages: FlashPages, slot: usize) -> Self {
        Self(Rc::new(RefCell::new(State {
            pages,
            slot,
            observer: None,
            operations: 0,
            busy_polls: 0,
            busy: 0,
            fails_at: None,
        })))
    }

    /// Returns a copy of the content.
    #[must_use]
    pub fn content(&self) -> FlashPages {
        self.0.borrow().pages.clone()
    }

    /// Observes each later operation.
    pub fn observe(&self, observer: Option<Observer>) {
        self.0.borrow_mut().observer = observer;
    }

    /// Makes each later operation last this number of polls.
    pub fn set_busy_polls(&self, busy_polls: u32) {
        self.0.borrow_mut().busy_polls = busy_polls;
    }

    /// Makes the operation after this number of others end without an effect.
    pub fn fail_after(&self, operations: u32) {
        let state = &mut *self.0.borrow_mut();
        state.fails_at = Some(state.operations + operations);
    }

    /// Returns the number of operations.
    #[must_use]
    pub fn operations(&self) -> u32 {
        self.0.borrow().operations
    }

    /// Returns the parts.
    #[must_use]
    pub fn parts(&self) -> Parts<PAGE, UNIT> {
        let slot = self.0.borrow().slot;
        let part = |range| Part(self.clone(), range);
        let records = 2 * slot + 1;
        Flash {
            a: Blocking(part(0..slot)),
            b: Blocking(part(slot..records)),
            state: part(records..records + 2),
            trust: part(records + 2..records + 4),
        }
    }

    fn poll(&self) -> nb::Result<(), FlashError> {
        let state = &mut *self.0.borrow_mut();
        if state.busy == 0 {
            return Ok(());
        }
        state.busy -= 1;
        Err(nb::Error::WouldBlock)
    }

    fn read(&self, page: usize, index: usize) -> Result<u64, Unreadable> {
        let state = &mut *self.0.borrow_mut();
        assert!(state.busy == 0, "read while an operation runs");
        match state.pages.read(page, index) {
            Err(Unreadable) if UNIT > BYTES => Ok(state.pages.bits(page, index)),
            read => read,
        }
    }

    fn run(&self, operations: &[Operation]) -> Result<(), FlashError> {
        let (observed, page, range) = {
            let state = &mut *self.0.borrow_mut();
            if state.busy > 0 {
                return Err(FlashError::Busy);
            }
            state.busy = state.busy_polls;
            let before = state.observer.is_some().then(|| state.pages.clone());
            let operations = if state.fails_at == Some(state.operations) { &[] } else { operations };
            for operation in operations {
                let operation = match *operation {
                    // Without error detection, bits can be cleared at any time.
                    Operation::Program(page, index, value) if UNIT > BYTES => {
                        let value = value & state.pages.bits(page, index);
                        state.pages.set(page, index, Some(value));
                        continue;
                    }
                    other => other,
                };
                state.pages.apply(operation).map_err(|_| FlashError::NotErased)?;
            }
            state.operations += 1;
            let (page, range) = match operations {
                [Operation::Program(page, index, _), ..] => (*page, *index..index + operations.len()),
                [Operation::Erase(page), ..] => (*page, 0..PAGE / BYTES),
                [] => (0, 0..0),
            };
            let observed = state.observer.clone().zip(before);
            (observed.map(|(observer, before)| (observer, before, state.pages.clone())), page, range)
        };
        if let Some((observer, before, after)) = observed {
            observer(&before, &after, page, range);
        }
        Ok(())
    }
}

impl<const PAGE: usize, const UNIT: usize> Part<PAGE, UNIT> {
    /// Returns the page and the index of a double word at this offset.
    fn place(&self, at: u32) -> (usize, usize) {
        assert!((at as usize) < self.capacity(), "outside of the slot");
        (self.1.start + at as usize / PAGE, at as usize % PAGE / BYTES)
    }
}

impl<const PAGE: usize, const UNIT: usize> PolledFlash for Part<PAGE, UNIT> {
    const SECTOR_LEN: usize = PAGE;
    const UNIT_LEN: usize = UNIT;

    fn capacity(&self) -> usize {
        self.1.len() * PAGE
    }

    fn read(&self, at: u32) -> Result<u64, Unreadable> {
        let (page, index) = self.place(at);
        self.0.read(page, index)
    }

    fn start_erase(&mut self, at: u32) -> Result<(), FlashError> {
        assert!((at as usize).is_multiple_of(PAGE), "{at}");
        self.0.run(&[Operation::Erase(self.place(at).0)])
    }

    fn start_program(&mut self, at: u32, unit: &[u8]) -> Result<(), FlashError> {
        assert!((at as usize).is_multiple_of(UNIT) && unit.len() == UNIT, "{at}");
        let (page, first) = self.place(at);
        let double_words = unit.as_chunks::<BYTES>().0.iter().zip(first..);
        let program =
            |(bytes, index): (&[u8; BYTES], _)| Operation::Program(page, index, u64::from_le_bytes(*bytes));
        self.0.run(&double_words.map(program).collect::<Vec<_>>())
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        self.0.poll()
    }
}

impl<const PAGE: usize, const UNIT: usize> storage::NorFlash for Part<PAGE, UNIT> {
    const PAGE_LEN: usize = PAGE / BYTES;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        self.0.read(self.1.start + page as usize, index)
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        self.0.run(&[Operation::Program(self.1.start + page as usize, index, value)])
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.0.run(&[Operation::Erase(self.1.start + page as usize)])
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        self.0.poll()
    }
}
