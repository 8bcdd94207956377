//! Milliseconds and microseconds from a timer that counts down once per millisecond, such as SysTick of a Cortex-M. The board
//! provides the timer and its interrupt.

use core::sync::atomic::{AtomicU32, Ordering};

/// Time since the start, from a timer with `CYCLES_PER_MS` cycles per millisecond, a multiple of 1 000; a plain `static`.
///
/// ```
/// use wsg_bridge_fw::tick::Tick;
///
/// static TICK: Tick<80_000> = Tick::new();
///
/// // In the handler of the timer.
/// TICK.count();
/// assert_eq!(TICK.now_ms(), 1);
/// // After a quarter of the next millisecond.
/// assert_eq!(TICK.now_us(59_999, false), 1_250);
/// ```
#[derive(Debug)]
pub struct Tick<const CYCLES_PER_MS: u32> {
    now_ms: AtomicU32,
}

impl<const CYCLES_PER_MS: u32> Tick<CYCLES_PER_MS> {
    /// Reload value of the timer, which counts down to 0. SysTick has 24 bits for it.
    pub const RELOAD: u32 = {
        assert!(CYCLES_PER_MS > 0 && CYCLES_PER_MS.is_multiple_of(1_000) && CYCLES_PER_MS - 1 <= 0x00FF_FFFF);
        CYCLES_PER_MS - 1
    };

    /// Creates a counter at 0 ms.
    #[must_use]
    pub const fn new() -> Self {
        Self { now_ms: AtomicU32::new(0) }
    }

    /// Counts a millisecond, in the timer's handler.
    #[inline]
    pub fn count(&self) {
        // Only written here, so a load and a store suffice.
        self.now_ms.store(self.now_ms().wrapping_add(1), Ordering::Relaxed);
    }

    /// Returns the milliseconds since the start. Wraps after 49 days.
    #[inline]
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.now_ms.load(Ordering::Relaxed)
    }

    /// Returns the microseconds since the start, with the timer at `left` cycles. Wraps after 71 minutes.
    ///
    /// Call it with interrupts masked. `is_pending`, read after `left`, is whether the timer's interrupt is pending. The
    /// timer may have reloaded in the meantime.
    #[inline]
    #[must_use]
    pub fn now_us(&self, left: u32, is_pending: bool) -> u32 {
        let late = is_pending && left > CYCLES_PER_MS / 2;
        let ms = self.now_ms().wrapping_add(u32::from(late));
        let cycles = Self::RELOAD.saturating_sub(left);
        ms.wrapping_mul(1_000).wrapping_add(cycles / (CYCLES_PER_MS / 1_000))
    }
}

impl<const CYCLES_PER_MS: u32> Default for Tick<CYCLES_PER_MS> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLES_PER_MS: u32 = 80_000;

    fn after(ms: u32) -> Tick<CYCLES_PER_MS> {
        Tick { now_ms: AtomicU32::new(ms) }
    }

    #[test]
    fn microseconds_never_decrease_despite_a_late_interrupt() {
        let tick = after(6);
        let mut before = tick.now_us(Tick::<CYCLES_PER_MS>::RELOAD, false);
        assert_eq!(before, 6_000);
        // The counter reloads after 0, and the interrupt is pending during the first half of the next millisecond.
        let counts = (0..CYCLES_PER_MS).rev().map(|left| (left, false));
        let late = (CYCLES_PER_MS / 2 + 1..CYCLES_PER_MS).rev().map(|left| (left, true));
        for (left, is_pending) in counts.chain(late) {
            let now = tick.now_us(left, is_pending);
            assert!(now == before || now == before + 1, "{before}, then {now}, with {left} left");
            before = now;
        }
        assert_eq!(before, 7_499);
    }

    #[test]
    fn interrupt_after_reading_the_counter_belongs_to_the_next_ms() {
        assert_eq!(after(6).now_us(0, true), 6_999);
        assert_eq!(after(6).now_us(CYCLES_PER_MS / 2, true), 6_499);
    }

    #[test]
    fn time_wraps_to_0() {
        let tick = after(u32::MAX);
        assert_eq!(tick.now_us(0, false), u32::MAX.wrapping_mul(1_000).wrapping_add(999));
        tick.count();
        assert_eq!((tick.now_ms(), tick.now_us(Tick::<CYCLES_PER_MS>::RELOAD, false)), (0, 0));
    }
}
