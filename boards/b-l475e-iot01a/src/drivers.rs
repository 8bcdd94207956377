//! What the firmware and the programs that measure it drive: clock, wires, the line to the gripper, and CAN.

#![deny(clippy::undocumented_unsafe_blocks)]

#[expect(unsafe_code, reason = "interrupts are unmasked, which only their handlers' author can call safe")]
pub mod can1;
pub mod clock;
pub mod pins;
#[expect(unsafe_code, reason = "an interrupt is unmasked, which only its handler's author can call safe")]
pub mod uart;
