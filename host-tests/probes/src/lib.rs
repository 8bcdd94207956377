//! What the probes share: a panic handler that does not link, and inputs that the compiler knows nothing of.
//!
//! A probe is a program for the thumb target that is never run: it is linked, and `cargo xtask size` takes what it holds
//! beside the program `empty`. It links only if no panic can be reached in it (`cargo xtask panics`).
#![no_std]

#[cfg(feature = "modbus")]
pub mod gripper;
#[cfg(feature = "on-target")]
mod on_target;

#[cfg(feature = "on-target")]
pub use on_target::{bytes, keep, opaque};
