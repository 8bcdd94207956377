//! Interface to a board's flash.
//!
//! `embedded-storage` does not fit: its operations block until completion, and its `read` fails completely if one double word
//! is unreadable.

use super::error::{FlashError, Unreadable};
use super::slot::Slot;

/// Two pages of NOR flash for the settings, programmed in double words of 64 bits.
///
/// Erased flash reads all ones. A double word can be programmed once after an erase, or to all zeros. Operations are started
/// and polled, so that no caller waits.
pub trait NorFlash {
    /// Number of double words in a page.
    const PAGE_LEN: usize;

    /// Longest operation before a save fails, in milliseconds. An STM32L4 erases in 25 ms.
    const OPERATION_TIMEOUT_MS: u32 = 200;

    /// Reads a double word. Must not be called during an operation.
    ///
    /// # Errors
    /// [`Unreadable`] for detected remains of a power cut during programming or erasing, and from [`Self::PAGE_LEN`] on.
    /// Flash without detection returns arbitrary data.
    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable>;

    /// Starts to program a double word. [`poll`](Self::poll) returns the result.
    ///
    /// # Errors
    /// The reason why the operation did not start.
    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError>;

    /// Starts to erase a page. [`poll`](Self::poll) returns the result.
    ///
    /// # Errors
    /// The reason why the operation did not start.
    fn start_erase(&mut self, page: Page) -> Result<(), FlashError>;

    /// Returns the result of the last operation. Does not wait.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] during the operation, then its error if it failed.
    fn poll(&mut self) -> nb::Result<(), FlashError>;

    /// Returns slot B, if a boot loader started this image. Without one, updates are refused.
    fn slot(&mut self) -> Option<&mut dyn Slot> {
        None
    }
}

/// Page of the settings' flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Page {
    /// Page at the lower address.
    First,
    /// Page at the higher address.
    Second,
}

impl Page {
    /// Both pages, in the order of their addresses.
    pub const ALL: [Self; 2] = [Self::First, Self::Second];

    /// Returns the other page.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }
}

/// No flash, for a board without persistent settings. A load finds none, and a save fails.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoFlash;

impl NorFlash for NoFlash {
    const PAGE_LEN: usize = 512;

    fn read(&self, _: Page, _: usize) -> Result<u64, Unreadable> {
        Ok(0)
    }

    fn start_program(&mut self, _: Page, _: usize, _: u64) -> Result<(), FlashError> {
        Err(FlashError::Failed)
    }

    fn start_erase(&mut self, _: Page) -> Result<(), FlashError> {
        Err(FlashError::Failed)
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        Err(nb::Error::Other(FlashError::Failed))
    }
}
