//! Parts shared by all probes: a panic handler that does not link, and inputs that the compiler cannot predict.
//!
//! Most probes are only linked for the thumb target, never run. `cargo xtask size` measures their difference from the program
//! `empty`. A probe links only if no panic is reachable (`cargo xtask panics`).
#![no_std]

#[cfg(feature = "modbus")]
pub mod gripper;
#[cfg(feature = "on-target")]
pub mod on_target;
