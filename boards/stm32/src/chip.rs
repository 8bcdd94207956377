//! Differences between the chips, as constants of one name.

#[cfg(feature = "stm32g474re")]
pub(crate) use stm32g474re::*;
#[cfg(feature = "stm32l475vg")]
pub(crate) use stm32l475vg::*;

/// STM32L475VG (RM0351).
#[cfg(feature = "stm32l475vg")]
mod stm32l475vg {
    use stm32_metapac::flash::regs::Cr;
    use stm32_metapac::usart::Lpuart;

    /// Clock of the core from reset until the board has switched: MSI.
    pub(crate) const RESET_HZ: u32 = 4_000_000;

    /// What DBGMCU_IDCODE holds (48.6.1).
    pub(crate) const DEVICE_ID: u16 = 0x415;

    /// The end of the flash of 1 MiB, in two banks.
    pub(crate) const FLASH_END: usize = 0x0810_0000;
    pub(crate) const FLASH_BANK_BYTES: usize = 0x8_0000;

    pub(crate) fn start_erase(control: &mut Cr) {
        control.set_start(true);
    }

    /// Returns whether the flash is organised as the settings' driver needs it.
    pub(crate) const fn has_two_banks() -> bool {
        true
    }

    /// There is no prescaler.
    pub(crate) fn halve_clock(_: Lpuart, _: bool) {}
}

/// STM32G474RE (RM0440, category 3 devices).
#[cfg(feature = "stm32g474re")]
mod stm32g474re {
    use stm32_metapac::FLASH;
    use stm32_metapac::flash::regs::Cr;
    use stm32_metapac::usart::Lpuart;
    use stm32_metapac::usart::vals::Presc;

    /// Clock of the core from reset until the board has switched: HSI16.
    pub(crate) const RESET_HZ: u32 = 16_000_000;

    /// What DBGMCU_IDCODE holds.
    pub(crate) const DEVICE_ID: u16 = 0x469;

    /// The end of the flash of 512 KiB, in two banks.
    pub(crate) const FLASH_END: usize = 0x0808_0000;
    pub(crate) const FLASH_BANK_BYTES: usize = 0x4_0000;

    pub(crate) fn start_erase(control: &mut Cr) {
        control.set_strt(true);
    }

    /// Returns whether the flash is organised as the settings' driver needs it: two banks, as the chip is delivered (option DBANK).
    /// As one bank it has other pages, and the program would stand still while one is erased. The same holds where the banks
    /// have changed places (option BFB2).
    pub(crate) fn has_two_banks() -> bool {
        let options = FLASH.optr().read();
        options.dbank() && !options.bfb2()
    }

    /// Sets the prescaler to two or one.
    pub(crate) fn halve_clock(uart: Lpuart, is_halved: bool) {
        uart.presc().write(|w| w.set_prescaler(if is_halved { Presc::DIV2 } else { Presc::DIV1 }));
    }
}
