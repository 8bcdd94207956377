//! The lines to a gripper: a UART, or CAN. To the bridge both are lines that it reads and writes byte by byte.

mod can;
mod serial;
mod would_block;

pub use can::GripperLink;
pub use serial::{BAUD, LostBytes, ReceiveErrors, TO_SEND_MAX, Uart, UartBuffers, UartLine};
pub use would_block::WouldBlock;
