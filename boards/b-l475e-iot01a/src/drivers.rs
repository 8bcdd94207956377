//! What the firmware and the programs that measure it drive: clock, wires, and the line to the gripper.

#![deny(clippy::undocumented_unsafe_blocks)]

pub mod clock;
pub mod pins;
#[expect(unsafe_code, reason = "an interrupt is unmasked, which only its handler's author can call safe")]
pub mod uart;
