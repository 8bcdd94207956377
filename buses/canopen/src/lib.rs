//! A CANopen device without I/O (CiA 301): frames in, frames out, over an object dictionary that the application supplies.
//!
//! | part | holds |
//! |---|---|
//! | [`Device`] | NMT, heartbeats both ways, SYNC, PDOs of the predefined connection set, the SDO server, EMCY |
//! | [`Dictionary`] | what the application gives to the SDO server; [`Object`], [`entries`] and [`find`] for a table of it |
//! | [`Fault`] | what emergencies tell |
//! | [`Eds`] | the EDS file (CiA 306), from the same table |
//!
//! A master is watched. Once its heartbeat was heard, the heartbeat has to go on; before that, its RPDOs. When neither comes
//! in time, or the bus is lost, or the master restarts, the device leaves operation, says so ([`Event::Left`]), and waits for
//! a master that starts it again.
//!
//! Not here: a controller, bit timing, bus-off recovery and clocks, which are the caller's; a master; what the README lists.
//!
//! ```
//! use bus_canopen::{Abort, Config, Device, Dictionary, Entry, Event, NmtState, Profile, Rpdo};
//! use bus_slcan::ClassicFrame;
//! use embedded_can::{Frame, StandardId};
//!
//! /// One RPDO of a byte, one TPDO of two, no faults.
//! static PROFILE: Profile<1, 1> =
//!     Profile { rpdos: [Rpdo { len: 1, keep: [0; 8] }], tpdos: [2], faults: &[] };
//! const CONFIG: Config<1> =
//!     Config { node: 0x10, master: 0x7F, heartbeat_ms: 500, emergency_inhibit: 0, inhibit: [0], event_ms: [0] };
//!
//! /// A dictionary without objects. `examples/io_module.rs` has one with some.
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
//! // It announces itself; a master starts it, and commands.
//! assert_eq!(device.poll_transmit(0), Some(frame(0x710, &[0])));
//! device.on_frame(1, &frame(0x000, &[0x01, 0x10]));
//! assert_eq!(device.state(), NmtState::Operational);
//! device.on_frame(1, &frame(0x210, &[0x55]));
//! let data = [0x55, 0, 0, 0, 0, 0, 0, 0];
//! assert_eq!(device.poll_event(1, &mut Nothing), Some(Event::Rpdo { number: 0, data }));
//! assert_eq!(device.poll_event(1, &mut Nothing), None);
//! // It answers by its TPDO.
//! device.show_tpdo(0, [0xAA, 0x01, 0, 0, 0, 0, 0, 0]);
//! assert_eq!(device.poll_transmit(1), Some(frame(0x190, &[0xAA, 0x01])));
//! assert_eq!(device.poll_transmit::<ClassicFrame>(1), None);
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::arithmetic_side_effects
)]
#![cfg_attr(
    test,
    allow(
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

/// The README's example is compiled with the others.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
