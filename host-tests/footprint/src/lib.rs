//! What a Cortex-M image takes, by its ELF file: flash, static RAM, and the deepest stack.
//!
//! [`uf2`] writes it as the RP2040 takes it.
//!
//! The stack is found by a walk over all calls. Every path counts as possible, and a call of what a register holds as one
//! of any function whose address is taken. The compiler tells the frames in the section `.stack_sizes`
//! (`-Zemit-stack-sizes`); where it does not, the code does.

mod calls;
mod frames;
mod graph;
mod sections;
mod thumb;
mod uf2;

pub use calls::Program;
pub use graph::{Deepest, Path};
pub use sections::{Footprint, Section, sections_of};
pub use uf2::uf2;
