//! The binary command protocol of the Weiss Robotics WSG servo grippers.
//!
//! Designed for microcontrollers and machine controllers: `no_std`, no allocation, no `unsafe`, byte-by-byte input. The
//! crate has no clock, I/O port or HAL; the caller owns bytes and time.
//!
//! | module | holds | manual |
//! |---|---|---|
//! | [`checksum`] | the frame checksum and its table | command set, appendix D |
//! | [`frame`] | [`Frame`], [`FrameParser`], [`FrameEncoder`] | command set, 1.2 |
//! | [`command`] | [`Command`], one variant per request; [`CommandId`] and its table | command set, chapter 3 |
//! | [`reply`] | [`Reply`]: status and typed values | command set, 1.2.2 and chapter 3 |
//! | [`limits`] | requests against the gripper's limits | command set, 3.5.4 |
//! | [`Meaning`] | frames as readable text, for logs | |
//! | `editor` | the input language of a command editor (feature `editor`) | command set, 2 |
//! | [`types`] | [`Status`], [`GripperState`], [`SystemFlags`], limits, units | command set, appendices A to C |
//! | [`session`] | the controller's side of a connection | command set, 1.3 |
//! | `driver` | blocking and async drivers (features `embedded-io` and `embedded-io-async`; on a PC `std` and `tokio`) | command set, chapter 3 |
//! | `can` | CAN segmentation and reassembly (feature `embedded-can`) | command set, 1.1 |
//! | `gcl` | the text protocol, both directions (feature `gcl`) | GCL |
//!
//! Requests are encoded to bytes. Received bytes are parsed into frames and decoded into typed values:
//!
//! ```
//! use wsg_protocol::{Command, Event, FrameEncoder, FrameParser, Reply, Status, Value};
//!
//! // To the gripper: grip a 20 mm part at 50 mm/s.
//! let mut line = [0; 32];
//! let grip = Command::GripPart { width: 20.0, speed: 50.0 };
//! let length = FrameEncoder::new(grip.id().code(), grip).write_into(&mut line).unwrap();
//! assert_eq!(line[..6], [0xAA, 0xAA, 0xAA, 0x25, 0x08, 0x00]);
//! assert_eq!(length, 16);
//!
//! // From the gripper: it has understood and is gripping (E_CMD_PENDING).
//! let mut parser = FrameParser::<64>::new();
//! let pending = Reply::status_only(grip.id(), Status::CmdPending);
//! for byte in FrameEncoder::new(0x25, pending) {
//!     if let Some(Event::Frame(frame)) = parser.push(byte) {
//!         let reply = Reply::decode(&frame).unwrap();
//!         assert_eq!(reply.status(), Status::CmdPending);
//!         assert_eq!(reply.value(), None::<Value>);
//!     }
//! }
//! assert_eq!(parser.counters().dropped, 0);
//! ```
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
#![cfg_attr(docsrs, feature(doc_cfg))]

#[cfg(any(test, feature = "std"))]
extern crate std;

#[cfg(feature = "embedded-can")]
pub mod can;
pub mod checksum;
pub mod command;
#[cfg(any(feature = "editor", feature = "gcl"))]
mod decimal;
#[cfg(any(feature = "embedded-io", feature = "embedded-io-async"))]
pub mod driver;
#[cfg(feature = "editor")]
pub mod editor;
mod field;
pub mod frame;
#[cfg(feature = "gcl")]
pub mod gcl;
pub mod limits;
mod meaning;
mod number;
#[doc(hidden)]
pub mod queue;
pub mod reply;
pub mod session;
mod table;
pub mod time;
pub mod types;

/// Derives `defmt::Format` with feature `defmt`, and nothing without it.
#[cfg(feature = "defmt")]
use defmt::Format;
#[cfg(not(feature = "defmt"))]
use wsg_protocol_macros::Format;

pub use command::{Command, CommandId, Kind};
pub use field::DecodeError;
pub use frame::{Event, Frame, FrameCounters, FrameEncoder, FrameParser, Payload};
pub use meaning::{Direction, Meaning};
pub use number::Number;
pub use reply::{Reply, Value};
pub use time::Instant;
pub use types::{
    AutoUpdate, DeviceTag, DeviceType, FingerData, FingerFlags, FingerInfo, FingerType, FirmwareVersion,
    GripperState, GrippingStatistics, HomingDirection, LoopData, PrePositionFlags, SoftLimits, Status,
    SystemFlags, SystemInfo, SystemLimits, Temperature, UpdateFlags,
};
