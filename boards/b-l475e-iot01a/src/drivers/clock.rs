//! The 80 MHz core clock from the PLL (RM0351, chapter 6).

use wsg_bridge_fw::NoClock;
use wsg_stm32::pac::rcc::vals::{Pllsrc, Sw};
use wsg_stm32::pac::{FLASH, RCC};

/// Clock of the core and, undivided, of all buses.
pub const HCLK_HZ: u32 = 80_000_000;

/// HSI16 replaces the MSI of reset because a UART needs 1 % accuracy over temperature, which the MSI lacks without a crystal.
const HSI_HZ: u32 = 16_000_000;
const PLL_N: u32 = 10;
const PLL_R: u32 = 2;
const _: () = assert!(HSI_HZ * PLL_N / PLL_R == HCLK_HZ);

/// Wait states for 64 to 80 MHz in voltage range 1, which is selected after reset (RM0351, 3.3.3).
const FLASH_WAIT_STATES: u8 = 4;

/// Maximum number of reads of a ready bit. One read takes at least 4 cycles, so the time-out is at least 10 ms at the 4 MHz of
/// reset. HSI16 and PLL need about 10 µs.
const MAX_LOOKS: u32 = 10_000;

/// Switches from the 4 MHz of reset to 80 MHz.
pub(crate) fn start() -> Result<(), NoClock> {
    FLASH.acr().modify(|w| w.0 = (w.0 & !0b111) | u32::from(FLASH_WAIT_STATES));
    // The read ensures that the write takes effect before the clock changes. Its value is ignored, because an emulator without
    // these registers reads 0.
    let _ = FLASH.acr().read();

    RCC.cr().modify(|w| w.set_hsion(true));
    wait_until(|| RCC.cr().read().hsirdy())?;

    RCC.pllcfgr().write(|w| {
        w.set_pllsrc(Pllsrc::HSI);
        // M = 1 and R = 2 are both encoded as 0.
        w.0 |= PLL_N << 8;
        w.set_pllren(true);
    });
    RCC.cr().modify(|w| w.set_pllon(true));
    wait_until(|| RCC.cr().read().pllrdy())?;

    RCC.cfgr().modify(|w| w.set_sw(Sw::PLL1_R));
    wait_until(|| matches!(RCC.cfgr().read().sws(), Sw::PLL1_R))
}

fn wait_until(ready: impl Fn() -> bool) -> Result<(), NoClock> {
    if (0..MAX_LOOKS).any(|_| ready()) { Ok(()) } else { Err(NoClock) }
}
