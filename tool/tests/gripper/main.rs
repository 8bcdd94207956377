//! Runs `wsg gripper` against the virtual gripper over each kind of line.
#![cfg(unix)]

mod bad_input;
mod bench;
mod doctor;
mod ends;
mod golden;
// Requires `setsid --ctty`, which only Linux has.
#[cfg(target_os = "linux")]
mod terminal;
mod transports;
