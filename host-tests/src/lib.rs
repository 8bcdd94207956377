//! placeholder

#[cfg(unix)]
pub mod emulator;
#[cfg(unix)]
pub mod qtest;
