//! Lines to a gripper: UART or CAN. The bridge reads and writes both byte by byte.

mod can;
mod serial;
mod would_block;

pub use can::GripperLink;
pub use serial::{BAUD, LostBytes, ReceiveErrors, TO_SEND_MAX, Uart, UartBuffers, UartLine};
pub use would_block::WouldBlock;

use wsg_protocol::DeviceTag;

/// Longest reply that the bridge requests: a device tag after its status code. Longer frames are ignored.
pub const MAX_REPLY_LEN: usize = DeviceTag::MAX_LEN + 2;

/// Interface to the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GripperLine {
    /// RS-232.
    Serial,
    /// CAN.
    Can,
}
