//! The 144 MHz core clock from the PLL and the board's crystal X3 (RM0440, RCC).

use wsg_bridge_fw::NoClock;
use wsg_stm32::pac::flash::vals::Latency;
use wsg_stm32::pac::rcc::vals::{Hpre, Pllm, Plln, Pllr, Pllsrc, Sw};
use wsg_stm32::pac::{FLASH, RCC};

/// Clock of the core and, undivided, of all buses. All Modbus rates and most PROFIBUS rates divide it, and it needs no boost
/// mode.
pub const HCLK_HZ: u32 = 144_000_000;

/// Frequency of the crystal, which also clocks CAN.
pub const HSE_HZ: u32 = 24_000_000;
const PLL_M: (Pllm, u32) = (Pllm::DIV4, 4);
const PLL_N: (Plln, u32) = (Plln::MUL48, 48);
const PLL_R: (Pllr, u32) = (Pllr::DIV2, 2);
const _: () = assert!(HSE_HZ / PLL_M.1 * PLL_N.1 / PLL_R.1 == HCLK_HZ);

/// Wait states for 120 to 150 MHz in voltage range 1 without boost, which is selected after reset (RM0440, FLASH, "Read access
/// latency").
const FLASH_WAIT_STATES: Latency = Latency::WS4;

/// A switch from below 80 MHz to above needs at least 1 µs at half the clock (RM0440, RCC, "System clock (SYSCLK) selection").
const CYCLES_AT_HALF: u32 = HCLK_HZ / 1_000_000;

/// Maximum number of reads of a ready bit. One read takes at least 4 cycles, so the time-out is at least 20 ms at the 16 MHz
/// of reset. The crystal needs about 2 ms, the PLL about 40 µs.
const MAX_LOOKS: u32 = 80_000;

/// Switches from the 16 MHz of reset to 144 MHz.
pub(super) fn start() -> Result<(), NoClock> {
    FLASH.acr().modify(|w| w.set_latency(FLASH_WAIT_STATES));
    wait_until(|| FLASH.acr().read().latency() == FLASH_WAIT_STATES)?;

    RCC.cr().modify(|w| w.set_hseon(true));
    wait_until(|| RCC.cr().read().hserdy())?;

    RCC.pllcfgr().write(|w| {
        w.set_pllsrc(Pllsrc::HSE);
        w.set_pllm(PLL_M.0);
        w.set_plln(PLL_N.0);
        w.set_pllr(PLL_R.0);
        w.set_pllren(true);
    });
    RCC.cr().modify(|w| w.set_pllon(true));
    wait_until(|| RCC.cr().read().pllrdy())?;

    RCC.cfgr().modify(|w| {
        w.set_hpre(Hpre::DIV2);
        w.set_sw(Sw::PLL1_R);
    });
    wait_until(|| RCC.cfgr().read().sws() == Sw::PLL1_R)?;
    cortex_m::asm::delay(CYCLES_AT_HALF);
    RCC.cfgr().modify(|w| w.set_hpre(Hpre::DIV1));
    Ok(())
}

fn wait_until(ready: impl Fn() -> bool) -> Result<(), NoClock> {
    if (0..MAX_LOOKS).any(|_| ready()) { Ok(()) } else { Err(NoClock) }
}
