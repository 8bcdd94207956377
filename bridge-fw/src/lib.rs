//! A bridge between a PLC and a WSG gripper, without the board: everything that needs no register runs on the host as
//! well.
//!
//! `PLC side -> fieldbus::Controller -> Session -> line`, and back. A PLC side ([`plc::PlcSide`]) produces the output image
//! and consumes the input image of the fieldbus manual: the wires, and beside them one bus at the most.
//!
//! Who commands, when both are connected:
//! - FASTSTOP and STOP/ACK of either side always count; so does a FASTSTOP wire that is low. Without wires, that one must
//!   be tied high.
//! - The bus moves the fingers only while no command wire is high. What rises meanwhile is lost, and a jog of the bus
//!   ends when a command wire rises.
//! - What a bus writes first, after power-up or after it was silent, gives no edge.
//! - A motion goes on with the parameters of the side that began it.
#![no_std]
#![forbid(unsafe_code)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic))]

#[cfg(test)]
extern crate std;

mod arbiter;
mod atomic;
mod bridge;
pub mod byte_queue;
pub mod can;
mod config;
pub mod gripper;
pub mod handler;
pub mod indicator;
pub mod io;
mod liveness;
mod log;
pub mod plc;
pub mod registers;
pub mod run;
mod station;
pub mod storage;
mod stored_settings;
pub mod tick;
pub mod usb_serial;

pub use arbiter::ControlSource;
pub use bridge::{Bridge, Counters};
pub use config::{
    BoardId, BusConfig, Config, Format, GripperLine, MAX_REPLY_LEN, PlcBus, ProfibusConfig, RECIPE_COUNT,
    RECIPES, Recipe,
};
pub use plc::{BusPort, NoBus};
pub use registers::ResetCause;
pub use run::{Board, Hardware, NoClock, run};
pub use station::Station;
