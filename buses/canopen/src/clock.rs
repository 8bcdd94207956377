//! Arithmetic on a millisecond clock that wraps.

/// Greatest time that [`age`] returns, 12 days in milliseconds.
pub(crate) const MAX_AGE_MS: u32 = 1 << 30;

/// Returns the milliseconds from `then_ms` to `now_ms`, or 0 if `then_ms` is in the future.
pub(crate) const fn since(now_ms: u32, then_ms: u32) -> u32 {
    let passed_ms = now_ms.wrapping_sub(then_ms);
    if passed_ms < 1 << 31 { passed_ms } else { 0 }
}

/// Returns the milliseconds from `then_ms` to `now_ms`, at most [`MAX_AGE_MS`]. From then on, `then_ms` follows the clock at
/// this distance, if the call is repeated at least once in 12 days. Otherwise a time that is compared for longer than 24 days
/// would seem recent again.
pub(crate) const fn age(now_ms: u32, then_ms: &mut u32) -> u32 {
    let passed_ms = since(now_ms, *then_ms);
    if passed_ms <= MAX_AGE_MS {
        return passed_ms;
    }
    *then_ms = now_ms.wrapping_sub(MAX_AGE_MS);
    MAX_AGE_MS
}
