//! The harness: the flashed image in an emulator, a virtual gripper on its line, a PLC on its wires.
//!
//! | module | holds |
//! |---|---|
//! | [`mod@bench`] | the bridge library and a virtual gripper in virtual time |
//! | [`emulator`] | the board in QEMU: inputs, outputs, lines, memory |
//! | [`mod@example`] | where cargo puts an example |
//! | [`gripper_end`] | the virtual gripper at the other end of the line, and what can be done to that line |
//! | [`masters`] | Modbus masters that nobody here wrote |
//! | [`rig`] | board, gripper and PLC together |
//! | [`trace`] | what happened, as a person reads it and as a test compares it |
//!
//! The emulator needs QEMU and the image: `cargo xtask test` sets both up. On systems without Unix sockets the harness
//! is empty.

pub mod bench;
#[cfg(unix)]
pub mod emulator;
pub mod example;
#[cfg(unix)]
pub mod gripper_end;
pub mod masters;
#[cfg(unix)]
pub mod qtest;
#[cfg(unix)]
pub mod rig;
pub mod trace;
