//! What a panic, a fault and an unexpected interrupt do: they reset the MCU.

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;

/// A reset puts every output low and lets the bridge start from what it can know for sure.
#[cfg(not(feature = "prove-panic-free"))]
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    SCB::sys_reset()
}

#[cfg(feature = "prove-panic-free")]
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    unsafe extern "C" {
        safe fn a_panic_can_be_reached() -> !;
    }
    a_panic_can_be_reached()
}

// SAFETY: the handler uses nothing of the program that was interrupted.
#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    SCB::sys_reset()
}

/// An interrupt that nobody enabled is as much a fault as a bus error.
// SAFETY: the handler uses nothing of the program that was interrupted.
#[exception]
unsafe fn DefaultHandler(_interrupt: i16) -> ! {
    SCB::sys_reset()
}
