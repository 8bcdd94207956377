//! The board's drivers for the firmware and its measurement programs: the description for `wsg-stm32`, the clock and CAN.

#![deny(clippy::undocumented_unsafe_blocks)]

mod board;
#[expect(unsafe_code, reason = "unmasking interrupts is safe only with regard to their handlers")]
pub mod can;
pub mod clock;

pub use board::{Nucleo, TICK};
