//! `libwsg_host`: blocking calls for C and C++ programs on a computer, over TCP, UDP or a serial port.
//!
//! It contains `libwsg`, so a program links this library alone. The header `include/wsg_host.h` is the documentation for C
//! programmers; it is generated from this crate.
//!
//! | module | holds |
//! |---|---|
//! | [`gripper`] | opening, motions, settings and queries |
//! | [`stop`] | a handle that stops the fingers from another thread |
//! | [`stream`] | timed set-points and the state while the fingers follow them |
//!
//! # Safety
//! Every function relies on these rules, which the header repeats. A pointer is null or points to an object of its type, or
//! to an array of the length passed with it. Objects that the library has created are used until they are closed, and
//! by one thread at a time; stop handles may be used by any thread. Null pointers are detected.
#![deny(missing_docs, clippy::undocumented_unsafe_blocks)]
// The names are C names, and the rules above apply to every function.
#![allow(non_camel_case_types, clippy::missing_safety_doc)]

pub mod error;

pub mod gripper;

pub mod stop;

pub mod stream;

mod line;

pub use error::wsg_host_error;
pub use gripper::wsg_host_t;
pub use stop::wsg_host_stop_t;
pub use stream::wsg_host_stream_t;
