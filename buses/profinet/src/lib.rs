//! A sans-I/O PROFINET IO device: Ethernet frames and UDP datagrams in, frames and datagrams out, over the
//! application's outputs, inputs and faults.
//!
//! Implements IEC 61158-5-10 and -6-10, conformance class A, real time class 1.
//!
//! | item | contents |
//! |---|---|
//! | [`Device`] | DCP, the connection to a controller (CM over RPC), cyclic data, alarms, records, LLDP |
//! | [`Profile`] | fixed properties of a device: numbers, modules, faults |
//! | [`Gsdml`] | the GSDML file, generated from the same profile |
//! | [`Stored`] | persistent data: name, IP parameters, I&M 1 to 3 |
//!
//! Ethernet driver, ARP, IP, UDP and clock are the caller's responsibility. Controllers and real time classes 2 (with a
//! switch) and 3 are not supported.
//!
//! ```
//! use bus_profinet::{Device, MAX_FRAME_LEN, MacAddress, Module, Profile, Stored, Submodule, Transmit};
//!
//! /// One byte of outputs, one byte of inputs.
//! static PROFILE: Profile = Profile {
//!     vendor_id: 0x1234,
//!     device_id: 0x0001,
//!     station_type: "example",
//!     order_id: "EX-8-8",
//!     serial_number: "1",
//!     hardware_revision: 1,
//!     software_revision: [1, 0, 0],
//!     min_interval: 32,
//!     modules: &[
//!         Module {
//!             slot: 0,
//!             ident: 1,
//!             name: "example",
//!             submodules: &[
//!                 Submodule { subslot: 1, ident: 1, input_len: 0, output_len: 0 },
//!                 Submodule { subslot: 0x8000, ident: 2, input_len: 0, output_len: 0 },
//!                 Submodule { subslot: 0x8001, ident: 3, input_len: 0, output_len: 0 },
//!             ],
//!         },
//!         Module {
//!             slot: 1,
//!             ident: 2,
//!             name: "8 inputs, 8 outputs",
//!             submodules: &[Submodule { subslot: 1, ident: 1, input_len: 1, output_len: 1 }],
//!         },
//!     ],
//!     faults: &[],
//! };
//! const _: () = assert!(PROFILE.fits(1, 1));
//!
//! let mac = MacAddress([0x02, 0, 0, 0, 0, 0x10]);
//! let mut device = Device::<1, 1>::new(&PROFILE, mac, Stored::NONE, 0);
//! // A controller searches for devices (DCP Identify, all) without a response delay.
//! let request = [
//!     0x01, 0x0E, 0xCF, 0, 0, 0, 0x02, 0, 0, 0, 0, 0x01, 0x88, 0x92, // multicast, from a controller, PROFINET
//!     0xFE, 0xFE, 5, 0, 0, 0, 0, 1, 0, 1, 0, 4, 0xFF, 0xFF, 0, 0,
//! ];
//! assert_eq!(device.receive(0, &request), None);
//! let mut buffer = [0; MAX_FRAME_LEN];
//! let Some(Transmit::Frame(len)) = device.poll_transmit(0, &mut buffer) else { panic!() };
//! assert_eq!(buffer[14..18], [0xFE, 0xFF, 5, 1]);
//! assert!(buffer[..len].windows(7).any(|text| text == b"example"));
//! // LLDP follows, then nothing for 5 s.
//! assert!(matches!(device.poll_transmit(0, &mut buffer), Some(Transmit::Frame(_))));
//! assert_eq!(device.poll_transmit(0, &mut buffer), None);
//! assert_eq!(device.poll_timeout(0), 5_000_000);
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

mod alarm;
mod connect;
mod cursor;
mod cyclic;
mod dcp;
mod device;
mod epm;
mod frame;
mod gsdml;
mod lldp;
mod profile;
mod records;
mod rpc;
mod state;
mod station;

pub use device::{Counters, Device, Transmit};
pub use frame::{MAX_FRAME_LEN, MacAddress};
pub use gsdml::{Gsdml, GsdmlFacts};
pub use profile::{Fault, MAX_SUBMODULES, Module, Priority, Profile, Submodule};
pub use rpc::{Endpoint, RPC_PORT};
pub use state::{Cause, Event, State};
pub use station::{IpParameters, Maintenance, StationName, Stored};

/// Compiles the README's example as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
