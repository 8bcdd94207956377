//! Runs `wsg gripper` against the virtual gripper over each kind of line.
#![cfg(unix)]

mod bad_input;
mod doctor;
mod ends;
mod golden;
mod rig;
// Requires `setsid --ctty`, which only Linux has.
#[cfg(target_os = "linux")]
mod terminal;
mod transports;
