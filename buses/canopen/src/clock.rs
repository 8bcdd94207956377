//! Arithmetic on a millisecond clock that wraps.

/// Returns the milliseconds from `then_ms` to `now_ms`, or 0 if `then_ms` is in the future.
pub(crate) const fn since(now_ms: u32, then_ms: u32) -> u32 {
    let passed_ms = now_ms.wrapping_sub(then_ms);
    if passed_ms < 1 << 31 { passed_ms } else { 0 }
}
