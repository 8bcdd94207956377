//! A sans-I/O PROFIBUS DP-V0 slave: characters and silences in, answers out, over the
//! application's outputs, inputs and diagnosis.
//!
//! Implements EN 50170-2 (now IEC 61158, type 3, and IEC 61784, CPF 3/1): the data link layer (FDL) of a passive
//! station, and the services of DP-V0.
//!
//! | item | contents |
//! |---|---|
//! | [`Slave`] | telegrams, frame count bit, services, the states Wait_Prm, Wait_Cfg and Data_Exch, the watchdog |
//! | [`Profile`] | fixed properties of a device: ident number, configuration, modes |
//! | [`BaudSearch`] | automatic detection of the bus's baud rate |
//! | [`Gsd`] | the GSD file, generated from the same profile |
//!
//! UART, driver direction, timers and clocks are the caller's responsibility. Masters and DP-V1 are not supported.
//!
//! ```
//! use bus_profibus::{Address, Answer, Cause, Character, Event, Outcome, Profile, Slave, State};
//!
//! /// One byte of outputs, one byte of inputs.
//! static PROFILE: Profile = Profile {
//!     ident: 0x1234,
//!     config: &[0x20, 0x10],
//!     sync: false,
//!     freeze: false,
//!     fail_safe: false,
//!     set_address: false,
//! };
//!
//! type Device = Slave<1, 1, 0>;
//!
//! /// Sends a telegram at a time in milliseconds, after 33 bit times of silence. Returns event and answer.
//! fn send(slave: &mut Device, now_ms: u32, telegram: &[u8]) -> (Option<Event>, Vec<u8>) {
//!     let mut result = (None, Vec::new());
//!     for (at, byte) in telegram.iter().enumerate() {
//!         let silence_bits = if at == 0 { 33 } else { 0 };
//!         if let Some(Outcome { event, answer }) = slave.push(Character::Byte(*byte), silence_bits, now_ms) {
//!             result = (event, answer.map_or(Vec::new(), |answer| answer.bytes.to_vec()));
//!         }
//!     }
//!     result
//! }
//!
//! const SC: u8 = 0xE5;
//! let mut slave = Device::new(&PROFILE, Address::new(7));
//! slave.show_inputs(&[0xAA]);
//! // Master 2 sends parameters (with a watchdog of 100 ms), then the configuration.
//! let set_prm = [0x68, 12, 12, 0x68, 0x87, 0x82, 0x6C, 61, 62, 0x88, 1, 10, 11, 0x12, 0x34, 0, 0xD4, 0x16];
//! assert_eq!(send(&mut slave, 0, &set_prm), (None, vec![SC]));
//! let chk_cfg = [0x68, 7, 7, 0x68, 0x87, 0x82, 0x5C, 62, 62, 0x20, 0x10, 0x11, 0x16];
//! assert_eq!(send(&mut slave, 1, &chk_cfg), (None, vec![SC]));
//! assert_eq!(slave.state(), State::DataExch);
//! // Exchange outputs and inputs.
//! let data_exchange = [0x68, 4, 4, 0x68, 0x07, 0x02, 0x7D, 0x55, 0xDB, 0x16];
//! let inputs = vec![0x68, 4, 4, 0x68, 0x02, 0x07, 0x08, 0xAA, 0xBB, 0x16];
//! assert_eq!(send(&mut slave, 2, &data_exchange), (Some(Event::Outputs), inputs));
//! assert_eq!(slave.outputs(), &[0x55]);
//! // The master stops sending, and the watchdog expires.
//! assert_eq!(slave.poll(102), None);
//! assert_eq!(slave.poll(103), Some(Event::Left(Cause::Watchdog)));
//! assert_eq!(slave.outputs(), &[0]);
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

mod baud;
mod dp;
mod gsd;
mod profile;
mod receiver;
mod slave;
mod state;
mod telegram;

pub use baud::{BAUD_LOST_MS, Baud, BaudSearch};
pub use gsd::{Gsd, GsdFacts};
pub use profile::{Address, DEFAULT_ADDRESS, MAX_DATA_LEN, Profile, STANDARD_DIAGNOSIS_LEN, identifiers_fit};
pub use receiver::{Character, Counters, SYNC_BITS};
pub use slave::{Answer, MIN_TSDR_BITS, Outcome, Slave};
pub use state::{Cause, Event, State};

/// Compiles the README's example as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
