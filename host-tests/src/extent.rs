//! How much there is of a test that could go on for any time.

/// Set by `cargo xtask ci`: all of it.
const VARIABLE: &str = "WSG_WHOLE";

/// Returns `whole` in `cargo xtask ci`, and a fifth of it elsewhere, where somebody waits.
#[must_use]
pub fn of(whole: usize) -> usize {
    if is_whole() { whole } else { whole / 5 }
}

/// Whether it is all of it.
#[must_use]
pub fn is_whole() -> bool {
    std::env::var_os(VARIABLE).is_some()
}
