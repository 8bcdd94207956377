//! A virtual gripper of the WSG series.
//!
//! The core, [`VirtualGripper`], takes bytes and the time and gives bytes: it speaks the binary protocol, and its
//! fingers really travel. It knows no clock and no I/O, and allocates nothing (`no_std`). With the feature `std` (the
//! default) come the servers around it and the binary `wsg-sim`.
//!
//! | module | changes with |
//! |---|---|
//! | `model` | what is known about the models |
//! | `config` | what can be set on the real one's web interface |
//! | `axis`, `thermal`, `finger` | the physics |
//! | `device`, `motion`, `commands` | the manual: states and flags; motions; commands |
//! | `updates`, `port`, `deframer` | the manual's rules for connections, and what clients make of them |
//! | `gcl` | the text protocol: its connections and requests |
//! | `fieldbus`, `modbus` | the registers and their rules; Modbus/TCP, which carries them |
//! | `gripper` | the contract with the caller |
//! | `server` | TCP, UDP, serial lines (feature `std`) |
//!
//! It is a model, not a copy: the fingers stop dead on Stop, FAST STOP and contact, a part is an ideal spring, and the
//! force is exact. What was decided where the manual is silent stands in `docs/models.md`.
#![cfg_attr(not(feature = "std"), no_std)]
#![forbid(unsafe_code)]

mod axis;
mod commands;
mod config;
mod deframer;
mod device;
mod faults;
mod fieldbus;
mod finger;
mod gcl;
mod gripper;
mod modbus;
mod model;
mod motion;
mod port;
#[cfg(feature = "std")]
pub mod server;
mod thermal;
mod time;
mod updates;

pub use axis::{Direction, Part};
pub use config::{Config, Tag};
pub use faults::Fault;
pub use finger::{Finger, Jaw};
pub use gripper::{DEFAULT_PORTS, State, VirtualGripper};
pub use model::{Model, Parameters};
pub use port::{FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind};
pub use time::Time;
