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
//! | `port` | what the device and its clients share |
//! | `settings`, `motion` | the manual: what clients set for motions; how motions start and end |
//! | `device` | the manual: states, flags and commands |
//! | `updates`, `deframer`, `binary` | the binary protocol: its connections, and what clients make of the manual's rules |
//! | `gcl` | the text protocol: its connections and requests |
//! | `fieldbus`, `modbus`, `profibus` | the registers and their rules; Modbus/TCP and PROFIBUS, which carry them |
//! | `script` | what scripts on the gripper share with its clients |
//! | `client` | a client, whatever it speaks |
//! | `gripper` | the contract with the caller |
//! | `server` | TCP, UDP, serial lines (feature `std`) |
//! | `rig` | gripper, line and clock for unit tests of programs (feature `rig`) |
//!
//! No two of them import each other, directly or by way of others.
//!
//! It is a model, not a copy: the fingers stop dead on Stop, FAST STOP and contact, a part is an ideal spring, and the
//! force is exact. What was decided where the manual is silent stands in `docs/models.md`.
#![cfg_attr(not(any(feature = "std", feature = "rig")), no_std)]
#![forbid(unsafe_code)]

mod axis;
mod binary;
mod client;
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
mod profibus;
#[cfg(feature = "rig")]
mod rig;
mod script;
#[cfg(feature = "std")]
pub mod server;
mod settings;
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
#[cfg(feature = "rig")]
pub use rig::VirtualRig;
pub use script::{MAX_REQUEST_LEN, SCRIPT_IDS, ScriptRequest, ScriptState};
pub use time::Time;
pub use wsg_fieldbus::SilenceReaction;

/// The example in the document compiles and runs.
#[cfg(all(doctest, feature = "rig", feature = "std"))]
#[doc = include_str!("../../docs/simulator.md")]
struct Document;
