//! The register interface of the fieldbus manual: two images, and the controller that turns edges into commands.
//!
//! Every PLC side of a bridge, wires or a bus, writes the 8-byte [`OutputImage`] and reads the 12-byte [`InputImage`]
//! (fieldbus, chapter 5). The [`Controller`] does what chapter 6 says between them. PROFIBUS masters also get a
//! [`Diagnosis`] block.

mod controller;
mod diagnosis;
mod image;
mod jog;

pub use controller::{Controller, SilenceReaction};
pub use diagnosis::Diagnosis;
pub use image::{CommandFlags, ForceUnit, GripperFlags, InputImage, OutputImage};
