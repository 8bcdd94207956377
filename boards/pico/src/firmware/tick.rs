//! Milliseconds from the core's SysTick, microseconds and alarms from the timer (RP2040, 4.6).

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SYST};
use cortex_m_rt::exception;
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::tick::Tick;

use crate::clock::SYS_HZ;
use crate::registers::{peripheral, reset, reset_bit, write};

type Systick = Tick<{ SYS_HZ / 1_000 }>;
const _: () = assert!(SYS_HZ.is_multiple_of(1_000));

static TICK: Systick = Tick::new();

/// Alarm 0 triggers the bus's handler.
const ALARM_0: u32 = 1 << 0;

/// Starts counting. The watchdog must run, because the timer counts its ticks.
pub(crate) fn start(systick: &mut SYST) {
    // If the timer stays in reset, its alarms fail: the bus stays silent, and its reports show that.
    let _ = reset(reset_bit::TIMER);
    write(peripheral!(TIMER).inte(), ALARM_0);
    // SAFETY: no critical section depends on this interrupt being masked. The handler shares nothing.
    unsafe { NVIC::unmask(Interrupt::TIMER_IRQ_0) };
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(Systick::RELOAD);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

/// Returns milliseconds since [`start`]. Wraps to 0 after 49 days.
pub(crate) fn now_ms() -> u32 {
    TICK.now_ms()
}

/// Returns microseconds. Wraps to 0 after 71 minutes. Interrupt handlers may call it.
pub(crate) fn now_us() -> u32 {
    peripheral!(TIMER).timerawl().read().bits()
}

/// Triggers the bus's handler after `us`, at least 5. Replaces an earlier request. Call it only from that handler.
pub(crate) fn wake_bus_in(us: u32) {
    // An alarm for a time that has just passed would trigger after 71 minutes, and uncached code takes microseconds. As a
    // fallback, the main loop triggers the handler while the bus transmits.
    write(peripheral!(TIMER).alarm0(), now_us().wrapping_add(us.max(5)));
}

#[interrupt]
fn TIMER_IRQ_0() {
    write(peripheral!(TIMER).intr(), ALARM_0);
    NVIC::pend(Interrupt::UART1_IRQ);
}

#[exception]
fn SysTick() {
    TICK.count();
}
