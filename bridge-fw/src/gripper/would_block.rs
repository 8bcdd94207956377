//! Error of the lines to a gripper.

use core::fmt;

use embedded_io::{Error, ErrorKind};

/// Error: the line would have to wait for received bytes, for room, or for the end of transmission. On CAN it also means that
/// there is no bus, or that the start of the message was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WouldBlock;

impl fmt::Display for WouldBlock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the line would have to wait")
    }
}

impl core::error::Error for WouldBlock {}

impl Error for WouldBlock {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}
