//! The reset cause of the MCU (RM0351, 6.4.29; RM0440, RCC_CSR).

use stm32_metapac::RCC;
use wsg_bridge_fw::ResetCause;

/// Reads the cause and clears it for the next reset.
pub(crate) fn take_cause() -> ResetCause {
    let cause = RCC.csr().read();
    RCC.csr().modify(|w| w.set_rmvf(true));
    // Every reset also sets the pin flag, and a power-on the brown-out flag, so test the rarer causes first.
    if cause.iwdgrstf() {
        ResetCause::Watchdog
    } else if cause.sftrstf() {
        ResetCause::Firmware
    } else if cause.borrstf() {
        ResetCause::PowerOn
    } else if cause.pinrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}
