//! What two pages of an STM32L4's flash hold, double word by double word, and what a power cut leaves of them.

use wsg_bridge_fw::storage::{Page, Unreadable};

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

/// The double word is programmed already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotErased;

#[derive(Clone, Copy, Debug)]
enum DoubleWord {
    Erased,
    Programmed(u64),
    /// More wrong bits than can be put right; these come all the same.
    Unreadable(u64),
    /// Between two values.
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

/// An operation of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Programs a double word.
    Program(Page, usize, u64),
    /// Erases a page.
    Erase(Page),
}

/// The pages.
#[derive(Clone, Debug)]
pub struct FlashPages {
    pages: [[DoubleWord; PAGE_LEN]; 2],
    chance: Chance,
}

impl FlashPages {
    /// Erased ones.
    #[must_use]
    pub fn new() -> Self {
        Self { pages: [[DoubleWord::Erased; PAGE_LEN]; 2], chance: Chance::new(1) }
    }

    /// Reads a double word; what changes reads otherwise each time.
    ///
    /// # Errors
    /// [`Unreadable`] for more wrong bits than can be put right, and from [`PAGE_LEN`] on.
    pub fn read(&mut self, page: Page, index: usize) -> Result<u64, Unreadable> {
        match self.pages[page as usize].get(index) {
            None | Some(DoubleWord::Unreadable(_)) => Err(Unreadable),
            Some(DoubleWord::Changing(one, other)) => match self.chance.below(3) {
                0 => Ok(*one),
                1 => Ok(*other),
                _ => Err(Unreadable),
            },
            Some(double_word) => Ok(double_word.value()),
        }
    }

    /// Does what the operation is about.
    ///
    /// # Errors
    /// [`NotErased`]: a double word is programmed once after an erase, or to zeros.
    pub fn apply(&mut self, operation: Operation) -> Result<(), NotErased> {
        match operation {
            Operation::Program(page, index, value) => {
                let double_word = &mut self.pages[page as usize][index];
                if !matches!(double_word, DoubleWord::Erased) && value != 0 {
                    return Err(NotErased);
                }
                *double_word = DoubleWord::Programmed(value);
            }
            Operation::Erase(page) => self.pages[page as usize] = [DoubleWord::Erased; PAGE_LEN],
        }
        Ok(())
    }

    /// Leaves the double words of the operation as a power cut in it does: between what they were `before` and what they are.
    pub fn tear(&mut self, before: &Self, operation: Operation, tear: Tear) {
        let (page, range) = match operation {
            Operation::Program(page, index, _) => (page as usize, index..index + 1),
            Operation::Erase(page) => (page as usize, 0..PAGE_LEN),
        };
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

    /// Sets what a double word holds; [`None`] if it cannot be read: its bits stay, and what guards them is wrong.
    pub fn set(&mut self, page: Page, index: usize, value: Option<u64>) {
        let double_word = &mut self.pages[page as usize][index];
        *double_word = value.map_or(DoubleWord::Unreadable(double_word.value()), DoubleWord::Programmed);
    }

    /// The bits of a double word that cannot be read, as they come to a reader who does not look whether it can.
    #[must_use]
    pub fn bits(&self, page: Page, index: usize) -> u64 {
        self.pages[page as usize][index].value()
    }

    /// Lets a double word read otherwise with each read: this, what it held, or not at all.
    pub fn set_changing(&mut self, page: Page, index: usize, value: u64) {
        let double_word = &mut self.pages[page as usize][index];
        *double_word = DoubleWord::Changing(value, double_word.value());
    }
}

impl Default for FlashPages {
    fn default() -> Self {
        Self::new()
    }
}
