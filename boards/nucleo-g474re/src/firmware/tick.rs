//! Milliseconds since start, by the core's SysTick.

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;
use wsg_bridge_fw::tick::Tick;

use crate::clock::HCLK_HZ;

type Systick = Tick<{ HCLK_HZ / 1_000 }>;
const _: () = assert!(HCLK_HZ.is_multiple_of(1_000));

static TICK: Systick = Tick::new();

/// Starts counting.
pub(crate) fn start(mut systick: SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(Systick::RELOAD);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

/// Milliseconds since [`start`]; starts again from 0 after 49 days.
pub(crate) fn now_ms() -> u32 {
    TICK.now_ms()
}

/// Microseconds since [`start`]; starts again from 0 after 71 minutes. Also for interrupt handlers.
pub(crate) fn now_us() -> u32 {
    cortex_m::interrupt::free(|_| TICK.now_us(SYST::get_current(), SCB::is_pendst_pending()))
}

#[exception]
fn SysTick() {
    TICK.count();
}
