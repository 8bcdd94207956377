//! Interface from the SDO server to the application.

use crate::{Abort, Entry};

/// The object dictionary of a device, with access to the application's values.
///
/// The device itself serves every [`Source`](crate::Source) except `Application`.
pub trait Dictionary {
    /// Identifies a value of the application.
    type Key: Copy;

    /// Looks up an entry. [`find`](crate::find) implements this for a table.
    ///
    /// # Errors
    /// Returns [`Abort::NoObject`], or [`Abort::NoSubindex`] if only the subindex does not exist.
    fn find(&self, index: u16, sub: u8) -> Result<Entry<Self::Key>, Abort>;

    /// Returns the application's value of an entry. Signed values are in two's complement.
    ///
    /// # Errors
    /// Returns the abort code if the value cannot be read.
    fn read(&self, key: Self::Key) -> Result<u32, Abort>;

    /// Returns the application's text of an entry of type [`DataType::Text`](crate::DataType::Text).
    ///
    /// # Errors
    /// Returns the abort code if the text cannot be read; by default always [`Abort::NoData`].
    fn text(&self, _: Self::Key) -> Result<&'static str, Abort> {
        Err(Abort::NoData)
    }

    /// Writes a value. The device has already checked its length and that the entry is writable.
    ///
    /// # Errors
    /// Returns the abort code if the value is rejected; nothing has been written then.
    fn write(&mut self, key: Self::Key, value: u32) -> Result<(), Abort>;

    /// Starts to write an entry of type [`DataType::Domain`](crate::DataType::Domain). `size` is its length in bytes, if the client
    /// gives it.
    ///
    /// # Errors
    /// Returns the abort code if the write is rejected; by default always [`Abort::ReadOnly`].
    fn begin_domain(&mut self, _: Self::Key, _size: Option<u32>) -> Result<(), Abort> {
        Err(Abort::ReadOnly)
    }

    /// Writes the next bytes of a domain, at most 7. `is_last` is whether they are the last ones.
    ///
    /// # Errors
    /// Returns the abort code if the write is rejected, which ends it; by default always [`Abort::ReadOnly`].
    fn write_domain(&mut self, _: Self::Key, _bytes: &[u8], _is_last: bool) -> Result<(), Abort> {
        Err(Abort::ReadOnly)
    }

    /// Returns the outcome of the last write, or of the last bytes of a domain, for writes that take time, such as storing parameters (1010h). `None`
    /// means that the write is in progress and defers the response to the client.
    ///
    /// The device calls this after each write. While it returns `None`, [`poll_event`](crate::Device::poll_event)
    /// calls it again until the client sends another request. The write must end within the client's time-out,
    /// which is often 500 ms.
    ///
    /// # Errors
    /// Returns the abort code if the write failed.
    fn outcome(&self, _: Self::Key) -> Option<Result<(), Abort>> {
        Some(Ok(()))
    }

    /// Returns the time-out for the master in milliseconds. 0 disables monitoring of its heartbeat and its RPDOs.
    fn consumer_time_ms(&self) -> u16;

    /// Changes the time-out for the master (1016h, 1). Never called with 0.
    ///
    /// # Errors
    /// Returns the abort code if the time is rejected; nothing has changed then.
    fn set_consumer_time_ms(&mut self, time_ms: u16) -> Result<(), Abort>;
}
