//! The watchdog, which resets the MCU if the main loop stalls (RP2040, 4.7), and the reset cause.

use wsg_bridge_fw::ResetCause;

use crate::clock::CRYSTAL_HZ;
use crate::registers::{peripheral, write};

/// Time-out without an iteration of the main loop.
const TIMEOUT_MS: u32 = 100;
/// The counter decrements by two per microsecond (erratum RP2040-E1).
const LOAD: u32 = TIMEOUT_MS * 1_000 * 2;
const _: () = assert!(LOAD <= 0xFF_FFFF);

/// Time-out during an erase of flash, which blocks the main loop.
const FLASH_LOAD: u32 = 1_000_000 * 2;

/// TICK: enable bit, and cycles of CLK_REF per microsecond, for the timer too.
const TICK_ENABLE: u32 = 1 << 9;
const TICK_CYCLES: u32 = CRYSTAL_HZ / 1_000_000;

/// Bits of CTRL.
const ENABLE: u32 = 1 << 30;
/// Pauses the counter while a debugger halts a core.
const PAUSE_DEBUG: u32 = 0b111 << 24;

/// PSM_WDSEL: all blocks except the two oscillators.
const RESET_ALL: u32 = 0x1_FFFF & !0b11;

/// Bits of REASON and CHIP_RESET (2.12.8).
const REASON_FORCED: u32 = 1 << 1;
const REASON_TIMER: u32 = 1 << 0;
const HAD_POR: u32 = 1 << 8;
const HAD_RUN: u32 = 1 << 16;

pub(crate) struct Watchdog(());

/// Starts the watchdog. Only a reset stops it. Until the crystal runs, the time-out is up to seven times as long.
pub(crate) fn start() -> Watchdog {
    let registers = peripheral!(WATCHDOG);
    write(peripheral!(PSM).wdsel(), RESET_ALL);
    write(registers.tick(), TICK_ENABLE | TICK_CYCLES);
    write(registers.load(), LOAD);
    write(registers.ctrl(), ENABLE | PAUSE_DEBUG);
    Watchdog(())
}

impl Watchdog {
    /// Restarts the time-out. Call it only from the main loop; in an interrupt handler it would not detect a stalled main
    /// loop.
    pub(crate) fn feed(&self) {
        write(peripheral!(WATCHDOG).load(), LOAD);
    }
}

/// Extends the time-out to 1 s for an erase of flash. The next [`Watchdog::feed`] ends that.
pub(crate) fn wait_for_flash() {
    write(peripheral!(WATCHDOG).load(), FLASH_LOAD);
}

/// Resets the MCU after a fault or a panic.
pub(crate) fn reset() -> ! {
    rp2040_hal::reset()
}

/// Returns the reset cause.
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
