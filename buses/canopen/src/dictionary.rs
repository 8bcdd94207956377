//! What the application gives to the SDO server.

use crate::{Abort, Entry};

/// The object dictionary of a device, and the values in it that are the application's.
///
/// The device itself serves every [`Source`](crate::Source) but `Application`.
pub trait Dictionary {
    /// Names a value of the application.
    type Key: Copy;

    /// Looks an entry up; [`find`](crate::find) does that in a table.
    ///
    /// # Errors
    /// [`Abort::NoObject`], or [`Abort::NoSubindex`] where only the subindex does not exist.
    fn find(&self, index: u16, sub: u8) -> Result<Entry<Self::Key>, Abort>;

    /// The application's value behind an entry; of a number with a sign, the bits of its two's complement.
    ///
    /// # Errors
    /// Why it cannot be read.
    fn read(&self, key: Self::Key) -> Result<u32, Abort>;

    /// The application's text behind an entry of type [`DataType::Text`](crate::DataType::Text).
    ///
    /// # Errors
    /// Why it cannot be read.
    fn text(&self, _: Self::Key) -> Result<&'static str, Abort> {
        Err(Abort::NoData)
    }

    /// Writes it. The value has the length of the entry's type, and the entry is writable.
    ///
    /// # Errors
    /// Why it is refused; then nothing was written.
    fn write(&mut self, key: Self::Key, value: u32) -> Result<(), Abort>;

    /// Whether what was written has ended, such as the store of parameters (1010h). `None`: it goes on, and the client is not
    /// answered yet. Asked behind each write, and then in each [`poll_event`](crate::Device::poll_event), until it has ended or
    /// the client asks for something else. It must end within the time that a client waits, which is often 500 ms.
    ///
    /// # Errors
    /// Why it failed.
    fn outcome(&self, _: Self::Key) -> Option<Result<(), Abort>> {
        Some(Ok(()))
    }

    /// Within which time the master must be heard again, in milliseconds; 0: it is not watched, neither by its heartbeat nor
    /// by its RPDOs.
    fn consumer_time_ms(&self) -> u16;

    /// Changes it (1016h, 1); never to 0.
    ///
    /// # Errors
    /// Why it is refused; then nothing was changed.
    fn set_consumer_time_ms(&mut self, time_ms: u16) -> Result<(), Abort>;
}
