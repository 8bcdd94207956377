//! Drivers shared by the STM32 boards: pins, UARTs, flash, watchdog and timers.
//!
//! A board implements `board::Stm32Board` with its pins, clocks and UARTs. Its crate also holds the interrupt vectors, the
//! memory layout and the CAN controller. A feature selects the chip, and `chip` holds the differences between the chips. On
//! the host, only the tables and the arithmetic are compiled.

#![no_std]
#![deny(unsafe_code)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![deny(clippy::undocumented_unsafe_blocks)]
#![cfg_attr(test, allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod bit_timing;
mod divider;
mod wires;

pub use bit_timing::{BitTiming, Segments};
pub use divider::Divider;
pub use wires::{
    InputWire, LinePin, OutputWire, Port, Pull, output_pins, outputs_from_port, port_from_outputs,
};

#[cfg(target_os = "none")]
pub mod board;
#[cfg(all(target_os = "none", feature = "boot"))]
#[expect(unsafe_code, reason = "the jump to an image")]
mod boot;
#[cfg(target_os = "none")]
pub mod bus;
#[cfg(target_os = "none")]
mod chip;
#[cfg(target_os = "none")]
#[expect(
    unsafe_code,
    reason = "the linker finds the settings by their symbol, and reads of them are volatile"
)]
mod delivered;
#[cfg(all(target_os = "none", feature = "faults"))]
#[expect(unsafe_code, reason = "fault handlers are unsafe to define")]
mod faults;
#[cfg(target_os = "none")]
#[expect(unsafe_code, reason = "flash is read and programmed by address; NMI has a separate handler")]
mod flash;
#[cfg(target_os = "none")]
pub mod gpio;
#[cfg(target_os = "none")]
pub mod gripper_line;
#[cfg(target_os = "none")]
mod reset;
#[cfg(target_os = "none")]
mod run;
#[cfg(target_os = "none")]
pub mod tick;
#[cfg(target_os = "none")]
#[expect(unsafe_code, reason = "unmasking interrupts is safe only with regard to their handlers")]
pub mod uart;
#[cfg(target_os = "none")]
mod unique_id;
#[cfg(target_os = "none")]
mod watchdog;

#[cfg(all(target_os = "none", feature = "boot"))]
pub use boot::boot;
#[cfg(target_os = "none")]
pub use run::run;
#[cfg(target_os = "none")]
pub use stm32_metapac as pac;
