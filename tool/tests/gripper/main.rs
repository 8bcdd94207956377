//! `wsg gripper` as a program, with the virtual gripper at the other end of each kind of line.
#![cfg(unix)]

mod bad_input;
mod bench;
mod doctor;
mod ends;
mod golden;
// Terminals of other systems have no `setsid --ctty`.
#[cfg(target_os = "linux")]
mod terminal;
mod transports;
