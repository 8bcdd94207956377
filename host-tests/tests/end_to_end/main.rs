//! What works together, over real lines and sockets: the flashed image, the virtual gripper, the drivers, and programs that
//! others wrote.
//!
//! One program, because these tests wait more than they compute: several run at a time.

mod both_protocols;
mod clients;
mod eds;
#[cfg(unix)]
mod emulator;
mod faults;
mod modbus_tcp;
#[cfg(unix)]
mod profibus;
#[cfg(target_os = "linux")]
mod profinet;
#[cfg(unix)]
mod wine;
