//! Access to registers that the HAL does not cover, or covers with unbounded waits.
//!
//! Chapters and names follow Raspberry Pi's RP2040 data sheet.

use rp2040_hal::pac::generic::{Reg, Writable};

/// Writes a complete register.
pub(crate) fn write<R: Writable<Ux = u32>>(register: &Reg<R>, value: u32) {
    // SAFETY: the written registers do not affect memory: clocks, resets, UARTs, SPI, timer, watchdog and pins. DMA is not
    // used.
    unsafe { register.as_ptr().write_volatile(value) };
}

/// Returns the registers of a peripheral.
macro_rules! peripheral {
    ($name:ident) => {{
        // SAFETY: the registers always exist. Each has one user, and registers shared with a handler are documented.
        unsafe { &*rp2040_hal::pac::$name::PTR }
    }};
}
pub(crate) use peripheral;

/// Resets peripherals (RESETS, 2.14) and releases them. Returns whether all left the reset state.
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

/// Maximum number of reads of a bit. A read takes at least 4 cycles, so the time-out is at least 10 ms at the maximum start
/// clock of 12 MHz. The crystal needs the longest, 1 ms.
const MAX_LOOKS: u32 = 30_000;

/// Polls a condition that takes microseconds. Returns whether it became true before the time-out.
pub(crate) fn wait_until(ready: impl Fn() -> bool) -> bool {
    (0..MAX_LOOKS).any(|_| ready())
}
