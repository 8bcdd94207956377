//! The watchdog: resets the MCU unless the main loop comes round (RP2040, 4.7), and why the MCU was reset.

use wsg_bridge_fw::ResetCause;

use crate::clock::CRYSTAL_HZ;
use crate::registers::{peripheral, write};

/// Time without a turn of the main loop after which the MCU resets.
const TIMEOUT_MS: u32 = 100;
/// The counter goes down by two in each microsecond (erratum RP2040-E1).
const LOAD: u32 = TIMEOUT_MS * 1_000 * 2;
const _: () = assert!(LOAD <= 0xFF_FFFF);

/// What an erase of flash may take, in which the main loop does not come round.
const FLASH_LOAD: u32 = 1_000_000 * 2;

/// TICK: running, and cycles of CLK_REF in a microsecond, the timer's as well.
const TICK_ENABLE: u32 = 1 << 9;
const TICK_CYCLES: u32 = CRYSTAL_HZ / 1_000_000;

/// CTRL.
const ENABLE: u32 = 1 << 30;
/// A debugger that halts a core stops the time.
const PAUSE_DEBUG: u32 = 0b111 << 24;

/// PSM_WDSEL: everything but the two oscillators.
const RESET_ALL: u32 = 0x1_FFFF & !0b11;

/// REASON, and CHIP_RESET (2.12.8).
const REASON_FORCED: u32 = 1 << 1;
const REASON_TIMER: u32 = 1 << 0;
const HAD_POR: u32 = 1 << 8;
const HAD_RUN: u32 = 1 << 16;

/// The running watchdog.
pub(crate) struct Watchdog(());

/// Starts the watchdog; nothing stops it again but a reset. Until the crystal runs, its time is up to seven times as long.
pub(crate) fn start() -> Watchdog {
    let registers = peripheral!(WATCHDOG);
    write(peripheral!(PSM).wdsel(), RESET_ALL);
    write(registers.tick(), TICK_ENABLE | TICK_CYCLES);
    write(registers.load(), LOAD);
    write(registers.ctrl(), ENABLE | PAUSE_DEBUG);
    Watchdog(())
}

impl Watchdog {
    /// Starts the time anew. For the main loop alone: fed from an interrupt it would watch nothing.
    pub(crate) fn feed(&self) {
        write(peripheral!(WATCHDOG).load(), LOAD);
    }
}

/// Lets the MCU be for a second, as an erase of flash needs. The next turn's [`Watchdog::feed`] ends that.
pub(crate) fn wait_for_flash() {
    write(peripheral!(WATCHDOG).load(), FLASH_LOAD);
}

/// Resets the MCU: a fault, or a panic.
pub(crate) fn reset() -> ! {
    rp2040_hal::reset()
}

/// Why the MCU was reset.
pub(crate) fn reset_cause() -> ResetCause {
    let reason = peripheral!(WATCHDOG).reason().read().bits();
    let chip = peripheral!(VREG_AND_CHIP_RESET).chip_reset().read().bits();
    if reason & REASON_TIMER != 0 {
        ResetCause::Watchdog
    } else if reason & REASON_FORCED != 0 {
        ResetCause::Firmware
    } else if chip & HAD_POR != 0 {
        ResetCause::PowerOn
    } else if chip & HAD_RUN != 0 {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}
