//! Milliseconds by the core's SysTick, microseconds by the timer (RP2040, 4.6), and its alarms.

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

/// Alarm 0 runs the handler of the bus.
const ALARM_0: u32 = 1 << 0;

/// Starts counting. The watchdog runs, whose ticks the timer counts.
pub(crate) fn start(systick: &mut SYST) {
    // Should it not come, the alarms do not either: the bus stays silent, and its registers say so.
    let _ = reset(reset_bit::TIMER);
    write(peripheral!(TIMER).inte(), ALARM_0);
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares nothing.
    unsafe { NVIC::unmask(Interrupt::TIMER_IRQ_0) };
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

/// Microseconds; starts again from 0 after 71 minutes. Also for interrupt handlers.
pub(crate) fn now_us() -> u32 {
    peripheral!(TIMER).timerawl().read().bits()
}

/// Runs the bus's handler in so many microseconds, five at the least, and not at a time that was set before. For that handler.
pub(crate) fn wake_bus_in(us: u32) {
    // An alarm at a time that has just gone by would come in 71 minutes; code that is not in the cache takes microseconds. The main
    // loop has the handler run as well while something is being sent.
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
