//! A board's flash for the boot loader: both slots and the pages of both records, with the geometry of its chip.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;

use embedded_storage::nor_flash::{self, ErrorType, NorFlashErrorKind, ReadNorFlash};
use wsg_boot::Flash;
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
}

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
        Self(Rc::new(RefCell::new(State { pages, slot, observer: None, operations: 0 })))
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

    /// Returns the number of operations.
    #[must_use]
    pub fn operations(&self) -> u32 {
        self.0.borrow().operations
    }

    /// Returns the parts.
    #[must_use]
    pub fn parts(&self) -> Flash<Part<PAGE, UNIT>, Part<PAGE, UNIT>, Part<PAGE, UNIT>, Part<PAGE, UNIT>> {
        let slot = self.0.borrow().slot;
        let part = |range| Part(self.clone(), range);
        let records = 2 * slot + 1;
        Flash {
            a: part(0..slot),
            b: part(slot..records),
            state: part(records..records + 2),
            trust: part(records + 2..records + 4),
        }
    }

    fn read(&self, page: usize, index: usize) -> Result<u64, Unreadable> {
        let state = &mut *self.0.borrow_mut();
        match state.pages.read(page, index) {
            Err(Unreadable) if UNIT > BYTES => Ok(state.pages.bits(page, index)),
            read => read,
        }
    }

    fn run(&self, operations: &[Operation]) -> Result<(), FlashError> {
        let (observed, page, range) = {
            let state = &mut *self.0.borrow_mut();
            let before = state.observer.is_some().then(|| state.pages.clone());
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
                [] => return Ok(()),
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

impl<const PAGE: usize, const UNIT: usize> ErrorType for Part<PAGE, UNIT> {
    type Error = NorFlashErrorKind;
}

impl<const PAGE: usize, const UNIT: usize> ReadNorFlash for Part<PAGE, UNIT> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        if !offset.is_multiple_of(4) || offset as usize + bytes.len() > self.capacity() {
            return Err(NorFlashErrorKind::OutOfBounds);
        }
        for (half, at) in bytes.chunks_mut(4).zip((offset as usize..).step_by(4)) {
            let read = self.0.read(self.1.start + at / PAGE, at % PAGE / BYTES);
            let value = read.map_err(|Unreadable| NorFlashErrorKind::Other)?.to_le_bytes();
            half.copy_from_slice(&value[at % BYTES..][..half.len()]);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.1.len() * PAGE
    }
}

impl<const PAGE: usize, const UNIT: usize> nor_flash::NorFlash for Part<PAGE, UNIT> {
    const WRITE_SIZE: usize = UNIT;
    const ERASE_SIZE: usize = PAGE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        assert!((from as usize).is_multiple_of(PAGE) && (to as usize).is_multiple_of(PAGE));
        for page in from as usize / PAGE..to as usize / PAGE {
            assert!(page < self.1.len(), "erase outside of the slot");
            self.0.run(&[Operation::Erase(self.1.start + page)]).map_err(|_| NorFlashErrorKind::Other)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        assert!((offset as usize).is_multiple_of(UNIT) && bytes.len().is_multiple_of(UNIT));
        assert!(offset as usize + bytes.len() <= self.capacity(), "write outside of the slot");
        for (unit, at) in bytes.chunks(UNIT).zip((offset as usize..).step_by(UNIT)) {
            let page = self.1.start + at / PAGE;
            let double_words = unit.as_chunks::<BYTES>().0.iter().zip(at % PAGE / BYTES..);
            let program = |(bytes, index): (&[u8; BYTES], _)| {
                Operation::Program(page, index, u64::from_le_bytes(*bytes))
            };
            let operations: Vec<_> = double_words.map(program).collect();
            self.0.run(&operations).map_err(|_| NorFlashErrorKind::Other)?;
        }
        Ok(())
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
        Ok(())
    }
}
