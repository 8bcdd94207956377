//! The register interface of the fieldbus manual: two images, and the controller that converts edges to commands.
//!
//! Every PLC side of a bridge, wires or a bus, writes the 8-byte [`OutputImage`] and reads the 12-byte [`InputImage`]
//! (fieldbus, chapter 5). The [`Controller`] implements chapter 6 between the two. PROFIBUS masters also receive a
//! [`Diagnosis`] block.
//!
//! Features: `modbus` adds `Images`, both images as coils and registers for a server of `bus_modbus`. `profibus`,
//! `profinet` and `ethernetip` each add a module of that name with the device profile for the bus crate.
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
#![cfg_attr(docsrs, feature(doc_cfg))]

#[cfg(test)]
extern crate std;

mod controller;
mod diagnosis;
#[cfg(feature = "ethernetip")]
pub mod ethernetip;
mod image;
mod incident;
mod jog;
#[cfg(feature = "modbus")]
mod modbus;
#[cfg(feature = "profibus")]
pub mod profibus;
#[cfg(feature = "profinet")]
pub mod profinet;
#[cfg(feature = "modbus")]
mod registers;

pub use controller::{Controller, SilenceReaction};
pub use diagnosis::Diagnosis;
pub use image::{CommandFlags, ForceUnit, GripperFlags, InputImage, MaskedFlags, OutputImage};
pub use incident::{Cause, Incident};
#[cfg(feature = "modbus")]
pub use modbus::Images;
#[cfg(feature = "modbus")]
pub use registers::{Content, INPUT_REGISTERS, OUTPUT_REGISTERS, Register};
