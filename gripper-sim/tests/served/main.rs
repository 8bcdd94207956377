//! The virtual gripper over real sockets, serial lines and terminals.
//!
//! One program, because these tests wait more than they compute: several run at a time. Pseudo terminals need Unix.

mod binary;
#[cfg(unix)]
mod can;
#[path = "../common/mod.rs"]
mod common;
mod control;
mod gcl;
#[cfg(unix)]
mod in_chromium;
mod modbus;
#[cfg(unix)]
mod profibus;
mod python;
#[cfg(feature = "script")]
mod scripts;
#[cfg(unix)]
mod unix;
