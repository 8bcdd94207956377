//! Damaged bytes on the line: reactions of the bridge, the driver and the fingers.

mod driver;
mod scenarios;
#[cfg(unix)]
mod soak;
