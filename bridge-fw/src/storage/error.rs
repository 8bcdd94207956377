//! Errors of the flash.

/// Error: a double word has more wrong bits than the error correction can handle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unreadable;

/// Reason for a failed operation of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FlashError {
    /// The previous operation is still running.
    Busy,
    /// The page is write-protected, or the flash cannot be unlocked.
    Protected,
    /// The double word is already programmed.
    NotErased,
    /// Any other failure of the operation.
    Failed,
}

impl core::fmt::Display for FlashError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Busy => "the flash is busy with the previous operation",
            Self::Protected => "the flash is write-protected",
            Self::NotErased => "the double word is already programmed",
            Self::Failed => "the flash reports a failed operation",
        })
    }
}

impl core::error::Error for FlashError {}
