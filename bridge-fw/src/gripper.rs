//! The lines to a gripper: a UART, or CAN. To the bridge both are lines that it reads and writes byte by byte.

mod can;
mod serial;
mod would_block;

pub use can::GripperLink;
pub use serial::{BAUD, LostBytes, ReceiveErrors, TO_SEND_MAX, Uart, UartBuffers, UartLine};
pub use would_block::WouldBlock;

use wsg_protocol::DeviceTag;

/// The longest reply that a bridge asks for: a device tag behind its status code. Everything longer is not for it.
pub const MAX_REPLY_LEN: usize = DeviceTag::MAX_LEN + 2;

/// The line that the gripper is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GripperLine {
    /// RS-232.
    Serial,
    /// CAN.
    Can,
}
