//! End-to-end tests over real lines and sockets: the released image, the virtual gripper, the drivers, and third-party
//! programs.
//!
//! They form one program because they mostly wait, so several run in parallel.

mod clients;
mod eds;
#[cfg(unix)]
mod emulator;
#[cfg(target_os = "linux")]
mod ethernetip;
mod faults;
mod modbus_tcp;
#[cfg(unix)]
mod profibus;
#[cfg(target_os = "linux")]
mod profinet;
mod signatures;
#[cfg(unix)]
mod update;
#[cfg(unix)]
mod wine;
