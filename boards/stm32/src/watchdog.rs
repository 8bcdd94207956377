//! The independent watchdog: resets the MCU unless the main loop comes round (RM0351, chapter 36; RM0440, IWDG).

use stm32_metapac::IWDG;
use stm32_metapac::iwdg::regs::Kr;
use stm32_metapac::iwdg::vals::Pr;

use crate::chip::RESET_HZ;

/// Time without a turn of the main loop after which the MCU resets, with the watchdog's own 32 kHz
/// clock at its nominal rate; 94 to 109 ms over its tolerance.
const TIMEOUT_MS: u32 = 100;
const COUNTS_PER_MS: u32 = 32 / 4;
const RELOAD: u32 = TIMEOUT_MS * COUNTS_PER_MS - 1;
const _: () = assert!(RELOAD <= 0xFFF);

const KEY_RELOAD: Kr = Kr(0xAAAA);
const KEY_UNLOCK: Kr = Kr(0x5555);
const KEY_START: Kr = Kr(0xCCCC);

/// Reads of the status register before the wait for new values is given up: at least 10 ms at the clock of reset, because a read takes
/// 4 cycles or more. The watchdog takes some of its 32 kHz cycles.
const MAX_READS: u32 = RESET_HZ / 400;

/// The running watchdog.
pub(crate) struct Watchdog(());

/// Starts the watchdog; nothing stops it again but a reset.
pub(crate) fn start() -> Watchdog {
    IWDG.kr().write_value(KEY_START);
    IWDG.kr().write_value(KEY_UNLOCK);
    IWDG.pr().write(|w| w.set_pr(Pr::DIVIDE_BY4));
    IWDG.rlr().write(|w| w.0 = RELOAD);
    // Should the values never be taken over, the watchdog runs with those of its reset: 512 ms.
    let _ = (0..MAX_READS).any(|_| IWDG.sr().read().0 == 0);
    let watchdog = Watchdog(());
    watchdog.feed();
    watchdog
}

impl Watchdog {
    /// Starts the time anew. For the main loop alone: fed from an interrupt it would watch nothing.
    pub(crate) fn feed(&self) {
        IWDG.kr().write_value(KEY_RELOAD);
    }
}
