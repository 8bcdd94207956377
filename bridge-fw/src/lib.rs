//! A bridge between a PLC and a WSG gripper, without the board: everything that needs no register runs on the host as
//! well.
//!
//! `wires -> DigitalIo -> fieldbus::Controller -> Session -> line`, and back. A PLC side produces the output image and
//! consumes the input image of the fieldbus manual, so another one (Modbus RTU, CAN) takes the place of the wires
//! without a change behind it.
#![no_std]
#![forbid(unsafe_code)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic))]

#[cfg(test)]
extern crate std;

pub mod boards;
mod bridge;
pub mod byte_queue;
mod debounce;
mod digital_io;
pub mod io;
mod log;
mod recipe;

pub use bridge::{Bridge, Config, Counters, MAX_REPLY_LEN};
pub use debounce::Debounce;
pub use digital_io::DigitalIo;
pub use recipe::{RECIPE_COUNT, RECIPES, Recipe};
