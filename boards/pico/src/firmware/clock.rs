//! 125 MHz from the crystal (RP2040, 2.15 to 2.18), and 48 MHz for USB.

use rp2040_hal::pac::pll_sys::RegisterBlock as Pll;
use wsg_bridge_fw::NoClock;

use crate::registers::{peripheral, reset, reset_bit, wait_until, write};

/// Clock of the cores, the UARTs and SPI.
pub(crate) const SYS_HZ: u32 = 125_000_000;

/// Core clock from reset until [`start`]: the ring oscillator, 1.8 to 12 MHz.
pub(crate) const RESET_HZ: u32 = 6_500_000;

/// Frequency of the crystal.
pub(crate) const CRYSTAL_HZ: u32 = 12_000_000;

/// XOSC, 2.16.7: the range 1 to 15 MHz, and the same with the oscillator enabled.
const RANGE_1_15MHZ: u32 = 0xAA0;
const RUNNING: u32 = 0xFAB << 12 | RANGE_1_15MHZ;
const STABLE: u32 = 1 << 31;
/// Start-up delay in units of 256 cycles: 1 ms.
const STARTUP: u32 = CRYSTAL_HZ / 1_000 / 256 + 1;

/// Settings of a PLL: multiplier and post dividers.
struct Setup {
    times: u32,
    by: (u32, u32),
}

const SYS: Setup = Setup { times: 125, by: (6, 2) };
const USB: Setup = Setup { times: 100, by: (5, 5) };
const _: () = assert!(SYS.hz() == SYS_HZ && USB.hz() == 48_000_000);

impl Setup {
    const fn hz(&self) -> u32 {
        CRYSTAL_HZ * self.times / (self.by.0 * self.by.1)
    }
}

/// Bits of a PLL's CS, PWR and PRIM (2.18.4).
const LOCK: u32 = 1 << 31;
const PD: u32 = 1 << 0;
const POSTDIVPD: u32 = 1 << 3;
const VCOPD: u32 = 1 << 5;
const ALL_DOWN: u32 = PD | 1 << 2 | POSTDIVPD | VCOPD;

/// Values of CLK_REF_CTRL, CLK_SYS_CTRL, CLK_PERI_CTRL and CLK_USB_CTRL (2.15.7).
const REF_FROM_ROSC: u32 = 0;
const REF_FROM_XOSC: u32 = 2;
const SYS_FROM_REF: u32 = 0;
/// The auxiliary source, PLL_SYS by default.
const SYS_FROM_AUX: u32 = 1;
const ENABLE: u32 = 1 << 11;

/// Switches from the ring oscillator to 125 MHz.
pub(crate) fn start() -> Result<(), NoClock> {
    let clocks = peripheral!(CLOCKS);
    // First switch away from the PLLs, which a debugger's reset leaves selected.
    let select = |came: bool| if came { Ok(()) } else { Err(NoClock) };
    write(clocks.clk_sys_ctrl(), SYS_FROM_REF);
    select(wait_until(|| clocks.clk_sys_selected().read().bits() == 1 << SYS_FROM_REF))?;
    write(clocks.clk_ref_ctrl(), REF_FROM_ROSC);
    select(wait_until(|| clocks.clk_ref_selected().read().bits() == 1 << REF_FROM_ROSC))?;

    let crystal = peripheral!(XOSC);
    write(crystal.ctrl(), RANGE_1_15MHZ);
    write(crystal.startup(), STARTUP);
    write(crystal.ctrl(), RUNNING);
    select(wait_until(|| crystal.status().read().bits() & STABLE != 0))?;

    select(reset(reset_bit::PLL_SYS | reset_bit::PLL_USB))?;
    select(start_pll(peripheral!(PLL_SYS), &SYS))?;
    select(start_pll(peripheral!(PLL_USB), &USB))?;

    write(clocks.clk_ref_ctrl(), REF_FROM_XOSC);
    select(wait_until(|| clocks.clk_ref_selected().read().bits() == 1 << REF_FROM_XOSC))?;
    write(clocks.clk_sys_ctrl(), SYS_FROM_AUX);
    select(wait_until(|| clocks.clk_sys_selected().read().bits() == 1 << SYS_FROM_AUX))?;
    // Both with their default sources: CLK_SYS and PLL_USB.
    write(clocks.clk_peri_ctrl(), ENABLE);
    write(clocks.clk_usb_ctrl(), ENABLE);
    Ok(())
}

fn start_pll(pll: &Pll, setup: &Setup) -> bool {
    write(pll.pwr(), ALL_DOWN);
    write(pll.cs(), 1);
    write(pll.fbdiv_int(), setup.times);
    write(pll.pwr(), ALL_DOWN & !(PD | VCOPD));
    if !wait_until(|| pll.cs().read().bits() & LOCK != 0) {
        return false;
    }
    write(pll.prim(), setup.by.0 << 16 | setup.by.1 << 12);
    write(pll.pwr(), ALL_DOWN & !(PD | VCOPD | POSTDIVPD));
    true
}
