//! What the firmware and the programs that measure it drive: the board for the shared drivers of `wsg-stm32`, its clock, and CAN.

#![deny(clippy::undocumented_unsafe_blocks)]

mod board;
#[expect(unsafe_code, reason = "interrupts are unmasked, which only their handlers' author can call safe")]
pub mod can1;
pub mod clock;

pub use board::{Iot01a, TICK};
