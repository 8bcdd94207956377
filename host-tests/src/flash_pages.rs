//! Contents of flash pages by double word, and the effects of a power failure.

use std::ops::Range;

use wsg_bridge_fw::storage::Unreadable;

use crate::chance::Chance;

/// Double words in a page of an STM32L4.
pub const PAGE_LEN: usize = 256;

/// State of an operation's double words after a power failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tear {
    /// Unchanged.
    NotBegun,
    /// As after completion.
    Complete,
    /// All ones, but not programmable.
    SeemsErased,
    /// More wrong bits than can be corrected.
    Unreadable,
    /// A mixture of old and new bits.
    SomeBits,
    /// Varying with each read.
    Changing,
    /// One of the above for each double word.
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

/// Error: the double word is already programmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotErased;

#[derive(Clone, Copy, Debug)]
enum DoubleWord {
    Erased,
    Programmed(u64),
    /// Raw bits with more errors than can be corrected.
    Unreadable(u64),
    /// Varies between two values.
    Changing(u64, u64),
}

impl DoubleWord {
    fn value(self) -> u64 {
        match self {
            Self::Erased => u64::MAX,
            Self::Programmed(value) | Self::Unreadable(value) | Self::Changing(_, value) => value,
        }
    }
}

/// A flash operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Programs a double word of a page.
    Program(usize, usize, u64),
    /// Erases a page.
    Erase(usize),
}

/// Pages of flash.
#[derive(Clone, Debug)]
pub struct FlashPages {
    pages: Vec<Vec<DoubleWord>>,
    chance: Chance,
}

impl FlashPages {
    /// Creates the erased pages of the settings.
    #[must_use]
    pub fn new() -> Self {
        Self::of(2, PAGE_LEN)
    }

    /// Creates this number of erased pages of this number of double words.
    #[must_use]
    pub fn of(pages: usize, page_len: usize) -> Self {
        Self { pages: vec![vec![DoubleWord::Erased; page_len]; pages], chance: Chance::new(1) }
    }

    /// Reads a double word; a changing one reads differently each time.
    ///
    /// # Errors
    /// Returns [`Unreadable`] for an uncorrectable double word, and for an index past the page.
    pub fn read(&mut self, page: usize, index: usize) -> Result<u64, Unreadable> {
        match self.pages[page].get(index) {
            None | Some(DoubleWord::Unreadable(_)) => Err(Unreadable),
            Some(DoubleWord::Changing(one, other)) => match self.chance.below(3) {
                0 => Ok(*one),
                1 => Ok(*other),
                _ => Err(Unreadable),
            },
            Some(double_word) => Ok(double_word.value()),
        }
    }

    /// Performs the operation.
    ///
    /// # Errors
    /// Returns [`NotErased`]: after an erase a double word can be programmed once, and then only to zeros.
    pub fn apply(&mut self, operation: Operation) -> Result<(), NotErased> {
        match operation {
            Operation::Program(page, index, value) => {
                let double_word = &mut self.pages[page][index];
                if !matches!(double_word, DoubleWord::Erased) && value != 0 {
                    return Err(NotErased);
                }
                *double_word = DoubleWord::Programmed(value);
            }
            Operation::Erase(page) => self.pages[page].fill(DoubleWord::Erased),
        }
        Ok(())
    }

    /// Leaves the operation's double words as after a power failure, between `before` and their current values.
    pub fn tear(&mut self, before: &Self, operation: Operation, tear: Tear) {
        let (page, range) = match operation {
            Operation::Program(page, index, _) => (page, index..index + 1),
            Operation::Erase(page) => (page, 0..self.pages[page].len()),
        };
        self.tear_range(before, page, range, tear);
    }

    /// Leaves these double words as after a power failure.
    pub fn tear_range(&mut self, before: &Self, page: usize, range: Range<usize>, tear: Tear) {
        for index in range {
            let (before, after) = (before.pages[page][index], &mut self.pages[page][index]);
            let how = match tear {
                Tear::Mixed => Tear::ALL[self.chance.below(6) as usize],
                _ => tear,
            };
            *after = match how {
                Tear::NotBegun => before,
                Tear::Complete | Tear::Mixed => *after,
                Tear::SeemsErased => DoubleWord::Programmed(u64::MAX),
                Tear::Unreadable => DoubleWord::Unreadable(after.value()),
                Tear::SomeBits => {
                    let mask = self.chance.number();
                    DoubleWord::Programmed(before.value() & mask | after.value() & !mask)
                }
                Tear::Changing => DoubleWord::Changing(before.value(), after.value()),
            };
        }
    }

    /// Sets a double word; [`None`] makes it unreadable, with its bits unchanged and a wrong error code.
    pub fn set(&mut self, page: usize, index: usize, value: Option<u64>) {
        let double_word = &mut self.pages[page][index];
        *double_word = value.map_or(DoubleWord::Unreadable(double_word.value()), DoubleWord::Programmed);
    }

    /// Returns the raw bits of an unreadable double word, as seen by a reader that ignores the error.
    #[must_use]
    pub fn bits(&self, page: usize, index: usize) -> u64 {
        self.pages[page][index].value()
    }

    /// Makes reads of a double word vary between this value, its current value and an error.
    pub fn set_changing(&mut self, page: usize, index: usize, value: u64) {
        let double_word = &mut self.pages[page][index];
        *double_word = DoubleWord::Changing(value, double_word.value());
    }
}

impl Default for FlashPages {
    fn default() -> Self {
        Self::new()
    }
}
