//! Memory use of a Cortex-M image from its ELF file: flash, static RAM, and maximum stack depth.
//!
//! [`bytes_of_flash`], [`uf2`] and others convert the image for debug probes and for the RP2040, and [`place_of`] finds a symbol's bytes.
//!
//! The stack depth results from a walk over all calls. Every path counts as possible, and an indirect call as one of
//! any function whose address is taken. A frame is the total of all pushes in the function's code.

mod calls;
mod flash;
mod graph;
mod sections;
mod thumb;
mod uf2;

pub use calls::Program;
pub use flash::{bytes_of_flash, range_of_flash};
pub use graph::{Deepest, Path};
pub use sections::{Footprint, Section, place_of, sections_of};
pub use uf2::{uf2, uf2_of};
