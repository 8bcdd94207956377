//! Panics, faults and unexpected interrupts reset the MCU.

use core::panic::PanicInfo;

use cortex_m_rt::exception;

use crate::watchdog;

/// A reset sets every output low and restarts the bridge from a known state.
#[cfg(not(feature = "prove-panic-free"))]
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    watchdog::reset()
}

#[cfg(feature = "prove-panic-free")]
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    unsafe extern "C" {
        safe fn a_panic_can_be_reached() -> !;
    }
    a_panic_can_be_reached()
}

// SAFETY: the handler uses no state of the interrupted program.
#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    watchdog::reset()
}

/// An interrupt without a handler is treated like a fault.
// SAFETY: the handler uses no state of the interrupted program.
#[exception]
unsafe fn DefaultHandler(_interrupt: i16) -> ! {
    watchdog::reset()
}
