//! Browsers for tests of web pages, which click, type and look like a user: Chromium, or Firefox after [`use_firefox`].
//!
//! Debian's Chromium runs in headless mode. The DevTools protocol controls it over pipes: JSON terminated by a zero byte.
//! It needs no port, and it ends with the tests in any case, because its pipe closes. Tests are ignored and have
//! `in_chromium` in their names, by which `cargo xtask test` skips them where Chromium is missing; Firefox has `in_firefox`.
//!
//! Without the feature `control`, the crate only serves files.

mod files;
#[cfg(feature = "control")]
mod firefox;
#[cfg(feature = "control")]
mod tab;

pub use files::serve;
#[cfg(feature = "control")]
pub use {
    firefox::use_firefox,
    tab::{MAX_DRAWING_MS, PROBLEMS, Tab, cpu_time},
};

/// Maximum duration of any wait.
#[cfg(feature = "control")]
const BOUND: std::time::Duration = std::time::Duration::from_secs(60);
