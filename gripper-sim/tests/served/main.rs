//! The virtual gripper on real sockets, serial lines and terminals.
//!
//! All tests share one program, because they mostly wait and can run in parallel. Pseudo terminals require Unix.

mod binary;
#[cfg(unix)]
mod can;
mod commands;
#[path = "../common/mod.rs"]
mod common;
mod control;
#[cfg(target_os = "linux")]
mod ethernetip;
mod gcl;
#[cfg(unix)]
mod in_chromium;
mod modbus;
#[cfg(unix)]
mod profibus;
mod python;
mod rig;
mod scripts;
mod scripts_of_the_page;
mod settings;
mod system_log;
#[cfg(unix)]
mod unix;
