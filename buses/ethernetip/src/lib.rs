//! A sans-I/O EtherNet/IP adapter: frames of TCP connections and UDP datagrams in, answers and cyclic packets out, over
//! the application's outputs, inputs and registers.
//!
//! Implements the target of class 1 and class 3 connections of CIP on EtherNet/IP (volumes 1 and 2 of the CIP networks
//! library, chapters as far as public sources cite them).
//!
//! | item | contents |
//! |---|---|
//! | [`Device`] | encapsulation, objects, connection manager, cyclic data |
//! | [`Profile`] | fixed properties of a device: identity, assemblies |
//! | [`Receiver`] | frames in the bytes of a TCP connection |
//! | [`Registers`] | the application's values for explicit messages |
//! | [`Eds`] | the EDS file, generated from the same profile |
//!
//! Sockets, TCP, IP and clock are the caller's responsibility. The README shows an I/O module.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects
    )
)]

#[cfg(test)]
extern crate std;

mod connection;
mod cursor;
mod device;
mod eds;
mod encapsulation;
mod forward_open;
mod path;
mod profile;
mod state;

pub use connection::Client;
pub use device::{Counters, DSCP, Device, EXPLICIT_CONNECTIONS, IO_CONNECTIONS, SESSIONS, Transmit};
pub use eds::{Eds, EdsFacts};
pub use encapsulation::{IO_PORT, MAX_FRAME_LEN, PORT, Receiver};
pub use profile::{Network, Profile, Registers, Status};
pub use state::{Cause, Event, Reset, State};

/// Compiles the README's example as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
