//! Modbus RTU as a PLC side beside the wires: what it serves, and how it is set.
//!
//! The registers are documented in `docs/registers.md`, which is made from the tables here. Framing and functions are
//! `bus_modbus`'s; who commands is decided in `arbiter`.

mod config;
mod port;
mod report;
mod settings;
mod side;

pub use config::{BusConfig, Format};
pub use port::{BusPort, NoBus};
pub use report::{FIRST_REPORT, Link, MAP_VERSION, REPORTS, Report, ResetCause};
pub use settings::{FIRST_SETTING, SETTINGS, Setting};
pub use side::IDENTIFICATION;

pub(crate) use report::{CAN_REPORTS, Subjects};
pub(crate) use settings::Settings;
pub(crate) use side::ModbusSide;
