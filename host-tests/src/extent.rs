//! Scaling of tests whose number of cases is arbitrary.

/// Set by `cargo xtask ci` to run all cases.
const VARIABLE: &str = "WSG_WHOLE";

/// Returns `whole` in `cargo xtask ci`, and a fifth of it in interactive runs.
#[must_use]
pub fn of(whole: usize) -> usize {
    if is_whole() { whole } else { whole / 5 }
}

/// Returns 1 in `cargo xtask ci`, for every case, and `step` in interactive runs.
#[must_use]
pub fn step(step: usize) -> usize {
    if is_whole() { 1 } else { step }
}

/// Returns whether all cases run.
#[must_use]
pub fn is_whole() -> bool {
    std::env::var_os(VARIABLE).is_some()
}
