//! The virtual gripper without a server: bytes in and out, in virtual time.

#[path = "../common/mod.rs"]
mod common;
mod connection;
mod fieldbus;
mod fieldbus_invariants;
mod gcl;
mod images;
mod motion;
mod observed;
mod profibus;
mod script;
mod settings;
mod updates;
