//! The independent watchdog: resets the MCU if the main loop stalls (RM0351, chapter 36; RM0440, IWDG).

use stm32_metapac::IWDG;
use stm32_metapac::iwdg::regs::Kr;
use stm32_metapac::iwdg::vals::Pr;

use crate::chip::RESET_HZ;

/// Time-out without an iteration of the main loop, at the nominal 32 kHz of the watchdog's clock; 94 to 109 ms over its
/// tolerance.
const TIMEOUT_MS: u32 = 100;
const COUNTS_PER_MS: u32 = 32 / 4;
const RELOAD: u32 = TIMEOUT_MS * COUNTS_PER_MS - 1;
const _: () = assert!(RELOAD <= 0xFFF);

const KEY_RELOAD: Kr = Kr(0xAAAA);
const KEY_UNLOCK: Kr = Kr(0x5555);
const KEY_START: Kr = Kr(0xCCCC);

/// Maximum number of status reads while waiting for new values: at least 10 ms at the reset clock, because a read takes 4
/// cycles or more. The update needs some cycles of 32 kHz.
const MAX_READS: u32 = RESET_HZ / 400;

pub(crate) struct Watchdog(());

/// Starts the watchdog. Only a reset stops it.
pub(crate) fn start() -> Watchdog {
    start_with(Pr::DIVIDE_BY4)
}

/// Starts the watchdog with 32 times the time-out, for a check of a signature at the reset clock.
#[cfg(feature = "boot")]
pub(crate) fn start_for_boot() -> Watchdog {
    start_with(Pr::DIVIDE_BY128)
}

fn start_with(prescaler: Pr) -> Watchdog {
    IWDG.kr().write_value(KEY_START);
    IWDG.kr().write_value(KEY_UNLOCK);
    IWDG.pr().write(|w| w.set_pr(prescaler));
    IWDG.rlr().write(|w| w.0 = RELOAD);
    // If the values are never accepted, the watchdog uses its reset values: 512 ms.
    let _ = (0..MAX_READS).any(|_| IWDG.sr().read().0 == 0);
    let watchdog = Watchdog(());
    watchdog.feed();
    watchdog
}

/// Sets five times the time-out for a check of a signature, or the usual one again, and restarts it.
#[cfg(feature = "slot")]
pub(crate) fn set_patient(is_patient: bool) {
    IWDG.kr().write_value(KEY_UNLOCK);
    IWDG.rlr().write(|w| w.0 = if is_patient { 0xFFF } else { RELOAD });
    // The value is accepted within some cycles of 32 kHz. If it never is, the watchdog resets the MCU.
    let _ = (0..MAX_READS).any(|_| IWDG.sr().read().0 == 0);
    Watchdog(()).feed();
}

impl Watchdog {
    /// Restarts the time-out. Call it only from the main loop; in an interrupt handler it would not detect a stalled main
    /// loop.
    pub(crate) fn feed(&self) {
        IWDG.kr().write_value(KEY_RELOAD);
    }
}
