//! Two pages of flash as an STM32L4 has them, and what goes wrong with them: power cuts, wear, no flash at all.

use std::cell::RefCell;

use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Unreadable};

use crate::chance::Chance;

/// Double words in a page.
pub const PAGE_LEN: usize = 256;

/// How an operation that a power cut interrupted left its double words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tear {
    /// As before.
    NotBegun,
    /// As if it had ended.
    Complete,
    /// All ones, and still not to be programmed.
    SeemsErased,
    /// More wrong bits than can be put right.
    Unreadable,
    /// Some bits as before, some as they should be.
    SomeBits,
    /// Otherwise with each read.
    Changing,
    /// Each double word has one of the above.
    Mixed,
}

impl Tear {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::NotBegun,
        Self::Complete,
        Self::SeemsErased,
        Self::Unreadable,
        Self::SomeBits,
        Self::Changing,
        Self::Mixed,
    ];
}

/// What is wrong with the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Reads this throughout and swallows stores, as an emulator without a flash controller does.
    Swallows(u64),
    /// Every operation is refused.
    Protected,
    /// No operation ends.
    Stuck,
    /// Pages keep a zero bit here when they are erased.
    Worn(usize),
    /// This double word cannot be programmed.
    Unprogrammable(Page, usize),
}

#[derive(Clone, Copy)]
enum DoubleWord {
    Erased,
    Programmed(u64),
    Unreadable,
    /// Between two values.
    Changing(u64, u64),
}

#[derive(Clone, Copy)]
enum Operation {
    Program(Page, usize, u64),
    Erase(Page),
}

/// The flash.
#[derive(Clone)]
pub struct FlashModel {
    pages: [[DoubleWord; PAGE_LEN]; 2],
    running: Option<(Operation, u32)>,
    /// Answers "it still runs" before an operation ends.
    pub busy_polls: u32,
    /// What is wrong, if anything.
    pub fault: Option<Fault>,
    /// The operation, counted from 0 as [`Self::operations`] does, in which the power goes.
    pub cut: Option<(u32, Tear)>,
    is_off: bool,
    /// Operations started.
    pub operations: u32,
    /// Erases of each page.
    pub erases: [u32; 2],
    /// Double words that were to be programmed a second time.
    pub refused: u32,
    chance: RefCell<Chance>,
}

impl FlashModel {
    /// Erased flash.
    #[must_use]
    pub fn new() -> Self {
        Self {
            pages: [[DoubleWord::Erased; PAGE_LEN]; 2],
            running: None,
            busy_polls: 0,
            fault: None,
            cut: None,
            is_off: false,
            operations: 0,
            erases: [0; 2],
            refused: 0,
            chance: RefCell::new(Chance::new(1)),
        }
    }

    /// Whether the power was cut. No operation ends then.
    #[must_use]
    pub fn is_off(&self) -> bool {
        self.is_off
    }

    /// Power comes back.
    pub fn reboot(&mut self) {
        self.cut = None;
        self.is_off = false;
        self.running = None;
    }

    /// Sets what a double word holds; [`None`] if it cannot be read.
    pub fn set(&mut self, page: Page, index: usize, value: Option<u64>) {
        self.pages[page as usize][index] = value.map_or(DoubleWord::Unreadable, DoubleWord::Programmed);
    }

    /// Lets a double word read otherwise with each read: this, what it held, or not at all.
    pub fn set_changing(&mut self, page: Page, index: usize, value: u64) {
        let double_word = &mut self.pages[page as usize][index];
        *double_word = DoubleWord::Changing(value, double_word.value());
    }

    fn end(&mut self, operation: Operation) -> Result<(), FlashError> {
        match (self.fault, operation) {
            (Some(Fault::Swallows(_)), _) => {}
            (Some(Fault::Unprogrammable(page, index)), Operation::Program(of, n, _))
                if (page, index) == (of, n) =>
            {
                return Err(FlashError::Failed);
            }
            (_, Operation::Program(page, index, value)) => {
                let double_word = &mut self.pages[page as usize][index];
                if !matches!(double_word, DoubleWord::Erased) && value != 0 {
                    self.refused += 1;
                    return Err(FlashError::NotErased);
                }
                *double_word = DoubleWord::Programmed(value);
            }
            (fault, Operation::Erase(page)) => {
                self.pages[page as usize] = [DoubleWord::Erased; PAGE_LEN];
                if let Some(Fault::Worn(index)) = fault {
                    self.pages[page as usize][index] = DoubleWord::Programmed(!(1 << 40));
                }
            }
        }
        Ok(())
    }

    fn tear(&mut self, operation: Operation, tear: Tear) {
        let before = self.pages;
        let _ = self.end(operation);
        let (page, range) = match operation {
            Operation::Program(page, index, _) => (page as usize, index..index + 1),
            Operation::Erase(page) => (page as usize, 0..PAGE_LEN),
        };
        let chance = self.chance.get_mut();
        for index in range {
            let (before, after) = (before[page][index], &mut self.pages[page][index]);
            let how = match tear {
                Tear::Mixed => Tear::ALL[chance.below(6) as usize],
                _ => tear,
            };
            *after = match how {
                Tear::NotBegun => before,
                Tear::Complete | Tear::Mixed => *after,
                Tear::SeemsErased => DoubleWord::Programmed(u64::MAX),
                Tear::Unreadable => DoubleWord::Unreadable,
                Tear::SomeBits => {
                    let mask = chance.number();
                    DoubleWord::Programmed(before.value() & mask | after.value() & !mask)
                }
                Tear::Changing => DoubleWord::Changing(before.value(), after.value()),
            };
        }
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
            self.erases[page as usize] += 1;
        }
        self.running = Some((operation, self.busy_polls));
        Ok(())
    }
}

impl Default for FlashModel {
    fn default() -> Self {
        Self::new()
    }
}

impl DoubleWord {
    fn value(self) -> u64 {
        match self {
            Self::Erased => u64::MAX,
            Self::Programmed(value) | Self::Changing(_, value) => value,
            Self::Unreadable => 0x0123_4567_89AB_CDEF,
        }
    }
}

impl NorFlash for FlashModel {
    const PAGE_LEN: usize = PAGE_LEN;

    /// # Panics
    /// While an operation runs: that is the caller's fault.
    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        assert!(self.running.is_none(), "read while an operation runs");
        if let Some(Fault::Swallows(value)) = self.fault {
            return Ok(value);
        }
        match self.pages[page as usize].get(index) {
            None | Some(DoubleWord::Unreadable) => Err(Unreadable),
            Some(DoubleWord::Changing(one, other)) => match self.chance.borrow_mut().below(3) {
                0 => Ok(*one),
                1 => Ok(*other),
                _ => Err(Unreadable),
            },
            Some(double_word) => Ok(double_word.value()),
        }
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        self.begin(Operation::Program(page, index, value))
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.begin(Operation::Erase(page))
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
