//! A line on which bytes go wrong: what the bridge and the driver make of it, and what the fingers do.

mod driver;
mod scenarios;
#[cfg(unix)]
mod soak;
