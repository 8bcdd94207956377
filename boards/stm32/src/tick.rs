//! Milliseconds since the start, by the core's SysTick.

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use wsg_bridge_fw::tick::Tick;

/// The time by SysTick, of a core with so many cycles in a millisecond; a plain `static`. Its handler calls [`count`](Self::count).
pub struct SysTick<const CYCLES_PER_MS: u32>(Tick<CYCLES_PER_MS>);

impl<const CYCLES_PER_MS: u32> SysTick<CYCLES_PER_MS> {
    /// No millisecond yet.
    #[expect(clippy::new_without_default, reason = "there is one")]
    #[must_use]
    pub const fn new() -> Self {
        Self(Tick::new())
    }

    /// Starts counting.
    pub fn start(&self, systick: &mut SYST) {
        systick.set_clock_source(SystClkSource::Core);
        systick.set_reload(Tick::<CYCLES_PER_MS>::RELOAD);
        systick.clear_current();
        systick.enable_interrupt();
        systick.enable_counter();
    }

    /// Counts a millisecond. For the handler of SysTick.
    #[inline]
    pub fn count(&self) {
        self.0.count();
    }

    /// Returns milliseconds since [`start`](Self::start); starts again from 0 after 49 days.
    #[inline]
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.0.now_ms()
    }

    /// Returns microseconds since [`start`](Self::start); starts again from 0 after 71 minutes. Also for interrupt handlers.
    #[must_use]
    pub fn now_us(&self) -> u32 {
        cortex_m::interrupt::free(|_| self.0.now_us(SYST::get_current(), SCB::is_pendst_pending()))
    }
}
