//! Why the MCU was reset (RM0351, 6.4.29; RM0440, RCC_CSR).

use stm32_metapac::RCC;
use wsg_bridge_fw::ResetCause;

/// Reads the cause and clears it for the next start.
pub(crate) fn take_cause() -> ResetCause {
    let cause = RCC.csr().read();
    RCC.csr().modify(|w| w.set_rmvf(true));
    // Every reset also pulls the reset pin, and power-on is also a brown-out: the rarer cause first.
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
