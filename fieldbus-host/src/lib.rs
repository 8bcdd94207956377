//! Sockets around a register image: accepts the masters of Modbus/TCP, limits their number and their idle time, and carries their
//! bytes. It is also an EtherNet/IP adapter and, on Linux, a PROFINET device.
//!
//! The owner of the image implements [`Client`] for one connection, and [`Owner`] for these devices: a virtual gripper, or a gateway
//! to a real one. Frames of Modbus/TCP, registers and rules are the owner's. The crate knows no gripper and no HTTP.
//!
//! All futures run in one thread, in a [`LocalSet`](tokio::task::LocalSet).
#![forbid(unsafe_code)]

pub mod accept;
mod client;
pub mod ethernetip;
mod owner;
pub mod profinet;
pub mod stream;
pub mod tcp;

pub use client::{Activity, Client, Dismissal, IDLE_LIMIT};
pub use owner::Owner;
