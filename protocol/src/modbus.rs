//! The server side of MODBUS over the two register images (fieldbus, chapter 4).
//!
//! By the *MODBUS application protocol specification V1.1b3*: [`serve`] turns a request PDU into a response PDU over a
//! [`Device`], whatever carries it. [`Images`] is the device's part that every gripper has. [`rtu`] is the serial line
//! by *MODBUS over serial line V1.02*, [`tcp`] the header on TCP. Not here: sockets.
//!
//! Served are FC 1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43/14, and on a serial line 8.
//!
//! `no_std`, no allocation. By the feature `modbus`.

mod device;
mod exception;
mod identification;
mod images;
mod pdu;
mod register;
pub mod rtu;
pub mod tcp;

pub use device::{Bits, Device, Words};
pub use exception::Exception;
pub use identification::Identification;
pub use images::Images;
use pdu::serve_as;
pub use pdu::{Function, MAX_PDU_LEN, serve};
pub use register::{Content, INPUT_REGISTERS, OUTPUT_REGISTERS, Register};

#[cfg(test)]
#[path = "modbus/tests.rs"]
mod tests;
