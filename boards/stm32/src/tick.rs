//! Milliseconds since the start, counted by the core's SysTick.

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use wsg_bridge_fw::tick::Tick;

/// A clock driven by SysTick, for a core with `CYCLES_PER_MS`. Use it as a `static`, and call [`count`](Self::count) in the
/// SysTick handler.
pub struct SysTick<const CYCLES_PER_MS: u32>(Tick<CYCLES_PER_MS>);

impl<const CYCLES_PER_MS: u32> SysTick<CYCLES_PER_MS> {
    /// Returns a clock at 0 ms.
    #[expect(clippy::new_without_default, reason = "a program has a single value")]
    #[must_use]
    pub const fn new() -> Self {
        Self(Tick::new())
    }

    /// Configures SysTick and starts counting.
    pub fn start(&self, systick: &mut SYST) {
        systick.set_clock_source(SystClkSource::Core);
        systick.set_reload(Tick::<CYCLES_PER_MS>::RELOAD);
        systick.clear_current();
        systick.enable_interrupt();
        systick.enable_counter();
    }

    /// Counts a millisecond. Call it from the SysTick handler.
    #[inline]
    pub fn count(&self) {
        self.0.count();
    }

    /// Returns milliseconds since [`start`](Self::start). Wraps to 0 after 49 days.
    #[inline]
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.0.now_ms()
    }

    /// Returns microseconds since [`start`](Self::start). Wraps to 0 after 71 minutes. Interrupt handlers may call it.
    #[must_use]
    pub fn now_us(&self) -> u32 {
        cortex_m::interrupt::free(|_| self.0.now_us(SYST::get_current(), SCB::is_pendst_pending()))
    }
}
