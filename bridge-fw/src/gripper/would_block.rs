//! The one error of the lines to a gripper.

use core::fmt;

use embedded_io::{Error, ErrorKind};

/// Where a line would have to wait: no byte has come, there is no room for another, or not all have been sent. On CAN also
/// where there is no bus, and where the beginning of a message was lost with it.
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
