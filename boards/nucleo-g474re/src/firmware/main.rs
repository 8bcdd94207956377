//! The bridge on the board NUCLEO-G474RE (STM32G474RE): entry point, board and CAN. Register names follow ST's RM0440.
//!
//! Executed in QEMU with models of the peripherals that its machine lacks, never on hardware.

#![no_std]
#![no_main]
#![deny(
    clippy::undocumented_unsafe_blocks,
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]

mod board;
mod can;
mod clock;

use cortex_m_rt::entry;
use wsg_bridge_fw::Station;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_stm32::bus;

use crate::board::Nucleo;
use crate::can::Can;

#[entry]
fn main() -> ! {
    // Too large for the stack. `entry` makes this safe, because it runs only once.
    static mut STATION: Station<Can> =
        Station::new(CanBus::new(Can::new(), BusOffPolicy::DEFAULT), bus::BUS.profibus());
    wsg_stm32::run::<Nucleo>(STATION)
}
