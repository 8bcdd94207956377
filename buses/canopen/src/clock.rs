//! Milliseconds of a clock that wraps.

/// The milliseconds from then to now; 0 if then is to come.
pub(crate) const fn since(now_ms: u32, then_ms: u32) -> u32 {
    let passed_ms = now_ms.wrapping_sub(then_ms);
    if passed_ms < 1 << 31 { passed_ms } else { 0 }
}
