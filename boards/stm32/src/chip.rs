//! Differences between the chips, as constants and functions with the same names.

#[cfg(feature = "stm32g474re")]
pub(crate) use stm32g474re::*;
#[cfg(feature = "stm32l475vg")]
pub(crate) use stm32l475vg::*;

/// STM32L475VG (RM0351).
#[cfg(feature = "stm32l475vg")]
mod stm32l475vg {
    #[cfg(feature = "boot")]
    use stm32_metapac::RCC;
    use stm32_metapac::flash::regs::{Cr, Eccr};
    #[cfg(feature = "boot")]
    use stm32_metapac::rcc::vals::Sw;
    use stm32_metapac::usart::Lpuart;

    /// Core clock from reset until the board switches it: MSI.
    pub(crate) const RESET_HZ: u32 = 4_000_000;

    /// Value of DBGMCU_IDCODE (48.6.1).
    pub(crate) const DEVICE_ID: u16 = 0x415;

    /// End of the flash: 1 MiB in two banks.
    pub(crate) const FLASH_END: usize = 0x0810_0000;
    pub(crate) const FLASH_BANK_BYTES: usize = 0x8_0000;

    pub(crate) fn start_erase(control: &mut Cr) {
        control.set_start(true);
    }

    /// Returns whether the flash organization suits the settings driver.
    pub(crate) const fn has_two_banks() -> bool {
        true
    }

    pub(crate) fn set_ecc_flags(flags: &mut Eccr) {
        flags.set_eccc(true);
        flags.set_eccd(true);
    }

    /// Returns whether a load found data with two wrong bits.
    pub(crate) fn is_uncorrectable(flags: Eccr) -> bool {
        flags.eccd()
    }

    /// Returns to the clock of reset, for the image that follows a boot loader.
    #[cfg(feature = "boot")]
    pub(crate) fn stop_clock() {
        RCC.cfgr().modify(|w| w.set_sw(Sw::MSI));
        let _ = (0..RESET_HZ / 400).any(|_| RCC.cfgr().read().sws() == Sw::MSI);
        RCC.cr().modify(|w| w.set_pllon(false));
    }

    /// This chip has no prescaler.
    pub(crate) fn halve_clock(_: Lpuart, _: bool) {}
}

/// STM32G474RE (RM0440, category 3 devices).
#[cfg(feature = "stm32g474re")]
mod stm32g474re {
    use stm32_metapac::FLASH;
    use stm32_metapac::flash::regs::{Cr, Eccr};
    use stm32_metapac::usart::Lpuart;
    use stm32_metapac::usart::vals::Presc;

    /// Core clock from reset until the board switches it: HSI16.
    pub(crate) const RESET_HZ: u32 = 16_000_000;

    /// Value of DBGMCU_IDCODE.
    pub(crate) const DEVICE_ID: u16 = 0x469;

    /// End of the flash: 512 KiB in two banks.
    pub(crate) const FLASH_END: usize = 0x0808_0000;
    pub(crate) const FLASH_BANK_BYTES: usize = 0x4_0000;

    pub(crate) fn start_erase(control: &mut Cr) {
        control.set_strt(true);
    }

    /// Returns whether the flash organization suits the settings driver: two banks (option DBANK, the factory default) in
    /// their normal order (option BFB2). A single bank has other pages, and the program would stall while one is erased.
    pub(crate) fn has_two_banks() -> bool {
        let options = FLASH.optr().read();
        options.dbank() && !options.bfb2()
    }

    pub(crate) fn set_ecc_flags(flags: &mut Eccr) {
        flags.set_eccc(true);
        flags.set_eccd(true);
        flags.set_eccc2(true);
        flags.set_eccd2(true);
    }

    /// Returns whether a load found data with two wrong bits. With a single bank, which an integrator may have selected, a load
    /// reads two double words, and the upper one has a flag of its own (3.7.7).
    pub(crate) fn is_uncorrectable(flags: Eccr) -> bool {
        flags.eccd() || flags.eccd2()
    }

    /// The boot loader does not start the clock.
    #[cfg(feature = "boot")]
    pub(crate) const fn stop_clock() {}

    /// Sets the prescaler to 2 or 1.
    pub(crate) fn halve_clock(uart: Lpuart, is_halved: bool) {
        uart.presc().write(|w| w.set_prescaler(if is_halved { Presc::DIV2 } else { Presc::DIV1 }));
    }
}
