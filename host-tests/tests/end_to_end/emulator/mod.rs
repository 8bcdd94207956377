//! The flashed image in the emulator: on wires, on its buses, and with masters that others wrote.

mod can;
mod line_errors;
mod line_rates;
mod masters;
mod modbus;
mod profibus;
mod quick_start;
mod service_port;
mod stored_settings;
mod watchdog;
mod wires;

use std::path::PathBuf;

/// The firmware image that this variable names.
fn image(variable: &str) -> PathBuf {
    std::env::var_os(variable)
        .unwrap_or_else(|| panic!("{variable} names no firmware image: run `cargo xtask test`"))
        .into()
}
