//! A sans-I/O MODBUS server: turns requests into responses over tables that the application supplies.
//!
//! Implements the *MODBUS application protocol specification V1.1b3*: [`serve`] turns a request PDU into a response PDU
//! over a [`Device`], independent of the transport. [`rtu`] implements the serial line (*MODBUS over serial line
//! V1.02*). [`tcp`] implements the TCP header (*messaging implementation guide V1.0b*).
//!
//! Supports FC 1, 2, 3, 4, 5, 6, 15, 16, 21, 22, 23 and 43/14, and FC 8 and 17 on a serial line. Does not include a client,
//! ASCII framing, sockets, UARTs or clocks. The caller owns bytes and time.
//!
//! ```
//! use bus_modbus::{Bits, Device, Exception, Identification, MAX_PDU_LEN, Words, serve};
//!
//! /// One holding register.
//! struct Setpoint(u16);
//!
//! impl Device for Setpoint {
//!     fn holding_register(&self, address: u16) -> Result<u16, Exception> {
//!         if address == 0 { Ok(self.0) } else { Err(Exception::IllegalDataAddress) }
//!     }
//!
//!     fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
//!         match (first, values.len(), values.iter().next()) {
//!             (0, 1, Some(value)) => self.0 = value,
//!             _ => return Err(Exception::IllegalDataAddress),
//!         }
//!         Ok(())
//!     }
//!     // The other tables are empty.
//! #   fn coil(&self, _: u16) -> Result<bool, Exception> { Err(Exception::IllegalDataAddress) }
//! #   fn discrete_input(&self, _: u16) -> Result<bool, Exception> { Err(Exception::IllegalDataAddress) }
//! #   fn input_register(&self, _: u16) -> Result<u16, Exception> { Err(Exception::IllegalDataAddress) }
//! #   fn write_coils(&mut self, _: u16, _: Bits<'_>) -> Result<(), Exception> { Err(Exception::IllegalDataAddress) }
//! #   fn identification(&self) -> Identification {
//! #       Identification { vendor_name: "V", product_code: "P", revision: "1", regular: None }
//! #   }
//! }
//!
//! let mut device = Setpoint(0);
//! let mut response = [0; MAX_PDU_LEN];
//! // Write Single Register: 0 = 288, then read it back.
//! let len = serve(&[0x06, 0x00, 0x00, 0x01, 0x20], &mut device, &mut response);
//! assert_eq!(response[..len], [0x06, 0x00, 0x00, 0x01, 0x20]);
//! let len = serve(&[0x03, 0x00, 0x00, 0x00, 0x01], &mut device, &mut response);
//! assert_eq!(response[..len], [0x03, 0x02, 0x01, 0x20]);
//! // Holding register 4 does not exist: exception 02.
//! let len = serve(&[0x03, 0x00, 0x04, 0x00, 0x01], &mut device, &mut response);
//! assert_eq!(response[..len], [0x83, 0x02]);
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects
    )
)]
#![cfg_attr(docsrs, feature(doc_cfg))]

#[cfg(test)]
extern crate std;

mod device;
mod exception;
mod identification;
mod pdu;
pub mod rtu;
pub mod tcp;

pub use device::{Bits, Device, FileRecord, FileRecords, Words};
pub use exception::Exception;
pub use identification::Identification;
use pdu::serve_as;
pub use pdu::{Function, MAX_PDU_LEN, serve};

#[cfg(test)]
mod tests;

/// Compiles the README's example as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
