//! Interface to slot B of the flash, and to the boot loader that exchanges the slots.

use wsg_protocol::Instant;

use super::error::{FlashError, Unreadable};
use crate::register::UpdateRefusal;

/// Bytes that are programmed at once.
pub const SLOT_PAGE_LEN: usize = 256;

/// Version of an image: major, minor, patch. All 0: no image.
pub type ImageVersion = [u8; 3];

/// Slot B, which receives an image, on a board whose boot loader can exchange the slots.
///
/// Operations of the flash are started and polled, and share its controller with the settings: the bridge never starts one of
/// both while the other runs.
pub trait Slot {
    /// Returns the bytes available for an image and its signature.
    fn len(&self) -> u32;

    /// Returns whether there is no room.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the bytes of a sector, the unit of an erase: a multiple of [`SLOT_PAGE_LEN`].
    fn sector_len(&self) -> u32;

    /// Returns the number of the board in the manifests of its images.
    fn target(&self) -> u32;

    /// Returns the version of the image in the slot, as far as it can be read. Called once, at the start.
    fn version(&self) -> ImageVersion;

    /// Returns whether the running image has not confirmed itself. Until then, slot B contains the previous image, and nothing
    /// may be written to the slot or to the settings, which the previous image would refuse.
    fn is_on_trial(&self) -> bool;

    /// Starts to erase the sector at this offset. [`poll`](Self::poll) returns the result.
    ///
    /// # Errors
    /// The reason why the operation did not start.
    fn start_erase(&mut self, at: u32) -> Result<(), FlashError>;

    /// Starts to program an erased page at this offset. The bytes are copied. [`poll`](Self::poll) returns the result.
    ///
    /// # Errors
    /// The reason why the operation did not start.
    fn start_program(&mut self, at: u32, page: &[u8; SLOT_PAGE_LEN]) -> Result<(), FlashError>;

    /// Returns the result of the last operation. Called once per turn of the main loop; does not wait.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] during the operation, then its error if it failed.
    fn poll(&mut self, now: Instant) -> nb::Result<(), FlashError>;

    /// Reads eight bytes at this offset, a multiple of 8. Not called during an operation.
    ///
    /// # Errors
    /// [`Unreadable`] for damage that the flash detects.
    fn read(&self, at: u32) -> Result<u64, Unreadable>;

    /// Checks by the rules of the boot loader that the first `len` bytes of the slot are an image and its signature. Each call does
    /// a part; the first one after an erase begins. Returns the version of the image.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] before the last part, then the reason why the boot loader would refuse the image.
    fn check(&mut self, len: u32) -> nb::Result<ImageVersion, UpdateRefusal>;

    /// Requests the exchange of the slots from the boot loader. Each call does a part.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] before the last part, then its error if it failed.
    fn mark(&mut self, now: Instant) -> nb::Result<(), FlashError>;

    /// Confirms the running image, so that the boot loader does not return the previous one. Each call does a part.
    ///
    /// # Errors
    /// [`nb::Error::WouldBlock`] before the last part, then its error if it failed.
    fn confirm(&mut self, now: Instant) -> nb::Result<(), FlashError>;

    /// Resets the MCU. It returns only in a model.
    fn restart(&mut self);
}
