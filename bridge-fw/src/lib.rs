//! A bridge between a PLC and a WSG gripper, independent of the board. All code that accesses no register also runs on the
//! host.
//!
//! `PLC side -> fieldbus::Controller -> Session -> line`, and back. A PLC side ([`plc::PlcSide`]) produces the output image
//! and consumes the input image of the fieldbus manual. The PLC sides are the wires and at most one bus.
//!
//! Rules when both are connected:
//! - FASTSTOP and STOP/ACK of either side always take effect, including a low FASTSTOP wire. Without wires, tie it high.
//! - The bus moves the fingers only while all command wires are low. Edges of the bus in the meantime are lost, and a jog of
//!   the bus ends when a command wire rises.
//! - The first write of a bus, after power-up or after a time-out, gives no edge.
//! - A motion keeps the parameters of the side that started it.
#![no_std]
#![forbid(unsafe_code)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg_attr(test, allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic))]

#[cfg(test)]
extern crate std;

mod arbiter;
mod atomic;
mod bridge;
pub mod byte_queue;
pub mod can;
pub mod gripper;
pub mod handler;
pub mod indicator;
pub mod io;
mod liveness;
mod log;
pub mod plc;
mod recipe;
mod register;
pub mod run;
mod station;
pub mod storage;
mod stored_settings;
pub mod tick;
mod update;
pub mod usb_serial;

pub use arbiter::ControlSource;
pub use bridge::{Bridge, Counters};
pub use gripper::{GripperLine, MAX_REPLY_LEN};
pub use plc::{BoardId, BusConfig, BusPort, Config, Format, NoBus, PlcBus, ProfibusConfig, WiresConfig};
pub use recipe::{RECIPE_COUNT, RECIPES, Recipe};
pub use register::ResetCause;
pub use run::{Board, Hardware, NoClock, run};
pub use station::Station;

/// The bridge's own registers: settings and reports, independent of the bus that carries them.
///
/// The PLC sides, `docs/registers.md` and the EDS file all derive from these tables.
pub mod registers {
    pub use crate::can::CanReports;
    pub use crate::plc::{FIRST_START_SETTING, REPORTS, Record, SETTINGS, WrongSetting};
    pub use crate::register::{
        BusCounts, COMMAND_KEY, COMMANDS, CommandRegister, EVENTS, EVENTS_KEPT, EventCode, EventText,
        FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, Link, MAP_VERSION, RegisterCommand, RegisterError,
        Report, ResetCause, SaveState, Setting, SettingsFrom, StoreCommand, UpdateCommand, UpdateRefusal,
    };
    pub use crate::update::update_crc;
}
