//! Registers that the HAL leaves alone, or serves with waits that have no end: written here.
//!
//! Chapters and names are those of Raspberry Pi's RP2040 data sheet.

use rp2040_hal::pac::generic::{Reg, Writable};

/// Writes a whole register.
pub(crate) fn write<R: Writable<Ux = u32>>(register: &Reg<R>, value: u32) {
    // SAFETY: the registers that this firmware writes reach no memory: those of clocks, resets, UARTs, SPI, timer, watchdog and
    // pins. DMA is not used.
    unsafe { register.as_ptr().write_volatile(value) };
}

/// The registers of a peripheral.
macro_rules! peripheral {
    ($name:ident) => {{
        // SAFETY: they are always there, and each has one user: what is shared with a handler says so.
        unsafe { &*rp2040_hal::pac::$name::PTR }
    }};
}
pub(crate) use peripheral;

/// Resets these peripherals (RESETS, 2.14), and takes them out of reset; whether all came.
pub(crate) fn reset(peripherals: u32) -> bool {
    let resets = peripheral!(RESETS);
    write(resets.reset(), resets.reset().read().bits() | peripherals);
    write(resets.reset(), resets.reset().read().bits() & !peripherals);
    wait_until(|| resets.reset_done().read().bits() & peripherals == peripherals)
}

/// Bits of RESETS.
pub(crate) mod reset_bit {
    pub(crate) const PLL_SYS: u32 = 1 << 12;
    pub(crate) const PLL_USB: u32 = 1 << 13;
    pub(crate) const SPI0: u32 = 1 << 16;
    pub(crate) const TIMER: u32 = 1 << 21;
    pub(crate) const UART0: u32 = 1 << 22;
    pub(crate) const UART1: u32 = 1 << 23;
    pub(crate) const USBCTRL: u32 = 1 << 24;
}

/// Looks at a bit before the wait for it is given up. A look takes at least 4 cycles: 10 ms at the 12 MHz at most of the start, where
/// the crystal needs 1 ms, the longest of all.
const MAX_LOOKS: u32 = 30_000;

/// Waits for something that takes microseconds; whether it came.
pub(crate) fn wait_until(ready: impl Fn() -> bool) -> bool {
    (0..MAX_LOOKS).any(|_| ready())
}
