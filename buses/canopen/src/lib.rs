//! A sans-I/O CANopen device (CiA 301): frames in, frames out, over an object dictionary that the application supplies.
//!
//! | item | contents |
//! |---|---|
//! | [`Device`] | NMT, heartbeat producer and consumer, SYNC, PDOs of the predefined connection set, SDO server, EMCY |
//! | [`Dictionary`] | interface of the SDO server to the application; [`Object`], [`entries`] and [`find`] for tables |
//! | [`Fault`] | a fault reported by emergencies |
//! | [`Eds`] | the EDS file (CiA 306), generated from the same table |
//!
//! The device monitors its master. After the first heartbeat it expects further heartbeats; before that, RPDOs. If the
//! master misses the time-out or restarts, or the bus is lost, the device leaves operation and reports [`Event::Left`].
//! It then waits until a master starts it again.
//!
//! Controller, bit timing, bus-off recovery and clocks are the caller's responsibility. The crate has no master;
//! the README lists further limits.
//!
//! ```
//! use bus_canopen::{Abort, Config, Device, Dictionary, Entry, Event, NmtState, Profile, Rpdo};
//! use bus_slcan::ClassicFrame;
//! use embedded_can::{Frame, StandardId};
//!
//! /// One RPDO of one byte, one TPDO of two bytes, no faults.
//! static PROFILE: Profile<1, 1> =
//!     Profile { rpdos: [Rpdo { len: 1, keep: [0; 8] }], tpdos: [2], faults: &[] };
//! const CONFIG: Config<1> =
//!     Config { node: 0x10, master: 0x7F, heartbeat_ms: 500, emergency_inhibit: 0, inhibit: [0], event_ms: [0] };
//!
//! /// An empty dictionary. `examples/io_module.rs` has objects.
//! struct Nothing;
//!
//! impl Dictionary for Nothing {
//!     type Key = ();
//!     fn find(&self, _: u16, _: u8) -> Result<Entry<()>, Abort> { Err(Abort::NoObject) }
//!     fn read(&self, _: ()) -> Result<u32, Abort> { Err(Abort::NoObject) }
//!     fn write(&mut self, _: (), _: u32) -> Result<(), Abort> { Err(Abort::ReadOnly) }
//!     fn consumer_time_ms(&self) -> u16 { 0 }
//!     fn set_consumer_time_ms(&mut self, _: u16) -> Result<(), Abort> { Err(Abort::ReadOnly) }
//! }
//!
//! let frame = |id, data: &[u8]| ClassicFrame::new(StandardId::new(id).unwrap(), data).unwrap();
//! let mut device = Device::<1, 1, 8>::new(&PROFILE, CONFIG);
//! // The device sends its boot-up message; a master starts it and sends a command.
//! assert_eq!(device.poll_transmit(0), Some(frame(0x710, &[0])));
//! device.on_frame(1, &frame(0x000, &[0x01, 0x10]));
//! assert_eq!(device.state(), NmtState::Operational);
//! device.on_frame(1, &frame(0x210, &[0x55]));
//! let data = [0x55, 0, 0, 0, 0, 0, 0, 0];
//! assert_eq!(device.poll_event(1, &mut Nothing), Some(Event::Rpdo { number: 0, data }));
//! assert_eq!(device.poll_event(1, &mut Nothing), None);
//! // The device responds with its TPDO.
//! device.show_tpdo(0, [0xAA, 0x01, 0, 0, 0, 0, 0, 0]);
//! assert_eq!(device.poll_transmit(1), Some(frame(0x190, &[0xAA, 0x01])));
//! assert_eq!(device.poll_transmit::<ClassicFrame>(1), None);
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

#[cfg(test)]
extern crate std;

mod clock;
mod config;
mod device;
mod dictionary;
mod eds;
mod emergency;
mod object;
mod sdo;

pub use config::{Config, is_reserved};
pub use device::{Device, Event, NmtState, Profile, Rpdo};
pub use dictionary::Dictionary;
pub use eds::{Eds, EdsEntry, EdsFacts, EdsValue};
pub use emergency::{Cause, Fault};
pub use object::{DataType, Entry, Object, Pdo, Source, entries, find};
pub use sdo::Abort;

#[cfg(test)]
mod tests;

/// Compiles the README's example as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
