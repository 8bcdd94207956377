//! `libwsg`: the session with a WSG gripper for C and C++.
//!
//! The header `include/wsg.h` is the documentation for C programmers; it is generated from this crate. The library has
//! no heap, no clock and no I/O. The caller owns all storage ([`wsg_t`]), bytes and time.
//!
//! | module | holds |
//! |---|---|
//! | [`session`] | storage, bytes and time in, events and bytes out |
//! | [`request`] | one function per request of the command set manual |
//! | [`event`] | events and their values as plain structures |
//! | [`queue`] | events in a queue of the caller's instead of a callback |
//! | [`known`] | the known state and the counters |
//! | [`config`] | time-outs and subscriptions |
//! | [`frame`] | parser and encoder alone, without a session |
//! | [`can`] | messages over classic CAN |
//! | [`fieldbus`] | the register interface: 8 bytes from a PLC, 12 bytes to it |
//! | [`text`] | texts of errors, statuses and commands |
//!
//! # Safety
//! C cannot prove to Rust that its pointers are valid. Every function therefore relies on these rules, which the header
//! repeats. A pointer is null or points to an object of its type, or to an array of the length passed with it. No
//! other thread or interrupt uses the object during the call. Null pointers, lengths and values outside their ranges,
//! uninitialized storage and calls in a wrong order are detected and return a [`wsg_error`].
#![cfg_attr(not(test), no_std)]
#![deny(missing_docs)]
#![deny(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::arithmetic_side_effects,
    clippy::undocumented_unsafe_blocks
)]
// The names are C names, and the rules above apply to every function.
#![allow(non_camel_case_types, clippy::missing_safety_doc)]

// In the order of the header.
pub mod error;

pub mod config;

pub mod event;

pub mod session;

pub mod request;

pub mod known;

pub mod queue;

pub mod frame;

pub mod can;

pub mod fieldbus;

pub mod text;

#[doc(hidden)]
pub mod memory;

pub use config::wsg_config_t;
pub use error::wsg_error;
pub use event::{wsg_event, wsg_event_t, wsg_value, wsg_value_t};
pub use frame::{wsg_frame_t, wsg_parser_t};
pub use known::{wsg_counters_t, wsg_known_t};
pub use queue::wsg_queue_t;
pub use session::wsg_t;

/// No code of the library can reach a panic, so the linker removes this handler. If some code could, a program with the library would
/// not link.
#[cfg(feature = "static-library")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        safe fn a_panic_can_be_reached() -> !;
    }
    a_panic_can_be_reached()
}
