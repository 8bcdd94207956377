//! What the firmware and the programs that measure it drive: clock, wires, the line to the gripper, CAN, and the settings' flash.

#![deny(clippy::undocumented_unsafe_blocks)]

#[expect(unsafe_code, reason = "interrupts are unmasked, which only their handlers' author can call safe")]
pub mod can1;
pub mod clock;
#[expect(unsafe_code, reason = "flash is read and programmed by address; NMI is an exception of its own")]
pub mod flash;
pub mod pins;
#[expect(unsafe_code, reason = "an interrupt is unmasked, which only its handler's author can call safe")]
pub mod uart;
