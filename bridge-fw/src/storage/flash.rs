//! What a board gives of its flash.
//!
//! `embedded-storage` has no such trait: its operations block until they are done, and its `read` fails as a whole
//! where one double word cannot be read.

/// Two pages of NOR flash that hold nothing else, programmed in double words of 64 bits.
///
/// Erased is all ones. A double word is programmed once after an erase, or to all zeros. Operations are started and
/// then asked about, so that no caller waits for one.
pub trait NorFlash {
    /// Double words in a page.
    const PAGE_LEN: usize;

    /// Reads a double word. No operation is running.
    ///
    /// # Errors
    /// [`Unreadable`] for what a power cut left half programmed or half erased, as far as the flash notices, and from
    /// [`Self::PAGE_LEN`] on. Flash that does not notice returns anything.
    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable>;

    /// Starts to program a double word; [`poll`](Self::poll) says when it is done.
    ///
    /// # Errors
    /// A reason why it was not started.
    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError>;

    /// Starts to erase a page; [`poll`](Self::poll) says when it is done.
    ///
    /// # Errors
    /// A reason why it was not started.
    fn start_erase(&mut self, page: Page) -> Result<(), FlashError>;

    /// Returns how the operation ended that was started last. Does not wait.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] while it runs; then the flash's own report, if it failed.
    fn poll(&mut self) -> nb::Result<(), FlashError>;
}

/// One of the two pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Page {
    /// The one at the lower address.
    First,
    /// The one at the higher address.
    Second,
}

impl Page {
    /// Both, in the order of their addresses.
    pub const ALL: [Self; 2] = [Self::First, Self::Second];

    /// The page that this is not.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }
}

/// A double word has more wrong bits than its error correction can put right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unreadable;

/// Why the flash did not program or erase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FlashError {
    /// The operation before still runs.
    Busy,
    /// The page is write protected, or the flash cannot be unlocked.
    Protected,
    /// The double word is programmed already.
    NotErased,
    /// Any other failure of the operation.
    Failed,
}

impl core::fmt::Display for FlashError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Busy => "the flash is busy with the operation before",
            Self::Protected => "the flash is write protected",
            Self::NotErased => "the double word is programmed already",
            Self::Failed => "the flash reports a failed operation",
        })
    }
}

impl core::error::Error for FlashError {}

/// No flash, for a board that keeps no settings: a start finds none, and a save fails.
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
