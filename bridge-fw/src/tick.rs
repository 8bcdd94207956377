//! Milliseconds, and the microseconds between them, by a timer that counts down from one millisecond to the next: SysTick of a
//! Cortex-M. The board gives the timer and its interrupt.

use core::sync::atomic::{AtomicU32, Ordering};

/// The time since the start, of a timer that counts `CYCLES_PER_MS` to a millisecond, a multiple of 1 000; a plain `static`.
///
/// ```
/// use wsg_bridge_fw::tick::Tick;
///
/// static TICK: Tick<80_000> = Tick::new();
///
/// // In the handler of the timer.
/// TICK.count();
/// assert_eq!(TICK.now_ms(), 1);
/// // A quarter of the next millisecond has gone by.
/// assert_eq!(TICK.now_us(59_999, false), 1_250);
/// ```
#[derive(Debug)]
pub struct Tick<const CYCLES_PER_MS: u32> {
    now_ms: AtomicU32,
}

impl<const CYCLES_PER_MS: u32> Tick<CYCLES_PER_MS> {
    /// What the timer counts down from, 0 included. SysTick has 24 bits for it.
    pub const RELOAD: u32 = {
        assert!(CYCLES_PER_MS > 0 && CYCLES_PER_MS.is_multiple_of(1_000) && CYCLES_PER_MS - 1 <= 0x00FF_FFFF);
        CYCLES_PER_MS - 1
    };

    /// No millisecond yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { now_ms: AtomicU32::new(0) }
    }

    /// Counts a millisecond. For the timer's handler.
    #[inline]
    pub fn count(&self) {
        // Written here alone, so a load and a store do.
        self.now_ms.store(self.now_ms().wrapping_add(1), Ordering::Relaxed);
    }

    /// Milliseconds since the start; starts again from 0 after 49 days.
    #[inline]
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.now_ms.load(Ordering::Relaxed)
    }

    /// Microseconds since the start, while the timer has `left` cycles to go; starts again from 0 after 71 minutes.
    ///
    /// Call it with interrupts masked. `is_pending`, read behind `left`, is whether the timer's interrupt waits for that to end: it
    /// may have begun anew meanwhile.
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
    fn microseconds_never_go_back_over_a_millisecond_whose_interrupt_is_late() {
        let tick = after(6);
        let mut before = tick.now_us(Tick::<CYCLES_PER_MS>::RELOAD, false);
        assert_eq!(before, 6_000);
        // The counter goes on from 0 at its start, and the interrupt waits for the first half of that.
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
    fn an_interrupt_that_comes_behind_the_look_at_the_counter_counts_for_the_next_millisecond() {
        assert_eq!(after(6).now_us(0, true), 6_999);
    }

    #[test]
    fn time_starts_again_from_0() {
        let tick = after(u32::MAX);
        assert_eq!(tick.now_us(0, false), u32::MAX.wrapping_mul(1_000).wrapping_add(999));
        tick.count();
        assert_eq!((tick.now_ms(), tick.now_us(Tick::<CYCLES_PER_MS>::RELOAD, false)), (0, 0));
    }
}
