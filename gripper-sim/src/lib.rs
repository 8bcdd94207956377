//! A virtual gripper of the WSG series.
//!
//! The core, [`VirtualGripper`], takes received bytes and the current time and returns the bytes to send. It speaks the
//! gripper's protocols and simulates the motion of the fingers. It is `no_std`, allocates nothing, and has no clock and
//! no I/O. The default feature `std` adds the servers and the binary `wsg-sim`.
//!
//! | module | scope |
//! |---|---|
//! | `model` | differences between the models, with sources |
//! | `config` | settings of the real gripper's web interface |
//! | `axis`, `thermal`, `finger` | the physics |
//! | `port` | types shared by the device and its clients |
//! | `settings`, `motion` | motion settings of the clients; start and end of motions, per the manual |
//! | `device` | states, flags and commands, per the manual |
//! | `send_queue` | the frames that wait for a client |
//! | `updates`, `deframer`, `binary` | the binary protocol: connections, framing and automatic updates |
//! | `gcl` | the text protocol: connections and requests |
//! | `fieldbus`, `modbus`, `profibus` | the registers and their rules, and their transports Modbus/TCP and PROFIBUS |
//! | `script` | commands claimed by scripts on the gripper |
//! | `client`, `protocol_client` | the contract of a client of any protocol, and the clients by protocol |
//! | `gripper` | the contract with the caller |
//! | `control` | the control interface without I/O, and a gripper for a page without a server (feature `control`) |
//! | `server` | servers on TCP, UDP, serial lines and CAN (feature `std`) |
//! | `program` | the program `wsg-sim` and its options (feature `std`) |
//! | `text`, `command_line`, `options_file` | text from outside, and what the command lines of all host programs share (feature `std`) |
//! | `rig` | gripper, line and clock for unit tests of client programs (feature `rig`) |
//!
//! Module imports are acyclic.
//!
//! The model is simplified: the fingers stop instantly on Stop, FAST STOP and contact, a part is an ideal spring, and
//! the force is exact. `docs/models.md` records the decisions made where the manual is silent.
#![cfg_attr(not(any(feature = "control", feature = "rig")), no_std)]
#![cfg_attr(target_family = "wasm", allow(dead_code, unused_imports, reason = "a browser has no lines"))]
#![forbid(unsafe_code)]

mod axis;
mod binary;
mod client;
#[cfg(feature = "std")]
pub mod command_line;
mod config;
#[cfg(feature = "control")]
pub mod control;
mod deframer;
mod device;
mod faults;
mod fieldbus;
mod finger;
#[cfg(not(target_family = "wasm"))]
mod gcl;
mod gripper;
mod journal;
#[cfg(not(target_family = "wasm"))]
mod modbus;
mod model;
mod motion;
#[cfg(feature = "std")]
pub mod options_file;
mod port;
#[cfg(not(target_family = "wasm"))]
mod profibus;
#[cfg(feature = "std")]
pub mod program;
mod protocol_client;
#[cfg(feature = "rig")]
mod rig;
mod script;
mod send_queue;
#[cfg(feature = "std")]
pub mod server;
mod settings;
#[cfg(feature = "control")]
pub mod text;
mod thermal;
mod time;
mod updates;

pub use axis::{Direction, Part};
pub use config::{Config, Tag};
pub use faults::Fault;
pub use fieldbus::{Exchange, ExchangeState};
pub use finger::{Finger, Jaw};
pub use gripper::{DEFAULT_PORTS, State, VirtualGripper};
pub use journal::{Cause, JournalEvent};
pub use model::{Model, Parameters};
pub use port::{FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind};
#[cfg(feature = "rig")]
pub use rig::VirtualRig;
pub use script::{MAX_REQUEST_LEN, SCRIPT_IDS, ScriptRequest, ScriptState};
pub use time::Time;
pub use wsg_fieldbus::SilenceReaction;
