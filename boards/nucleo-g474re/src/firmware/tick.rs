//! Milliseconds since start, by the core's SysTick.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;

use crate::clock::HCLK_HZ;

const CYCLES_PER_MS: u32 = HCLK_HZ / 1_000;
const _: () = assert!(HCLK_HZ.is_multiple_of(1_000) && CYCLES_PER_MS - 1 <= 0x00FF_FFFF);

static NOW_MS: AtomicU32 = AtomicU32::new(0);

/// Starts counting.
pub(crate) fn start(mut systick: SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(CYCLES_PER_MS - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

/// Milliseconds since [`start`]; starts again from 0 after 49 days.
pub(crate) fn now_ms() -> u32 {
    NOW_MS.load(Ordering::Relaxed)
}

/// Microseconds since [`start`]; starts again from 0 after 71 minutes. Also for interrupt handlers.
pub(crate) fn now_us() -> u32 {
    cortex_m::interrupt::free(|_| {
        let left = SYST::get_current();
        // The counter may have begun anew while its interrupt waits for this code to end.
        let late = SCB::is_pendst_pending() && left > CYCLES_PER_MS / 2;
        let ms = now_ms().wrapping_add(u32::from(late));
        let cycles = (CYCLES_PER_MS - 1).saturating_sub(left);
        ms.wrapping_mul(1_000).wrapping_add(cycles / (CYCLES_PER_MS / 1_000))
    })
}

#[exception]
fn SysTick() {
    // Written here alone, so a load and a store do.
    NOW_MS.store(now_ms().wrapping_add(1), Ordering::Relaxed);
}
