//! The lines to a gripper: a UART, or CAN. To the bridge both are lines that it reads and writes byte by byte.

mod can;
mod serial;

pub use can::GripperLink;
pub use serial::{LostBytes, ReceiveErrors, Uart, UartBuffers, UartLine, WouldBlock};
