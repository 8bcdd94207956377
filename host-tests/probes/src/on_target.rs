//! Target-specific parts of every probe.

use core::hint::black_box;
use core::panic::PanicInfo;

/// Returns the value, hidden from the optimizer.
#[inline(always)]
pub fn opaque<T>(value: T) -> T {
    black_box(value)
}

/// Returns bytes of unknown number and values.
#[inline(always)]
pub fn bytes() -> &'static [u8] {
    static BYTES: [u8; 8] = [0; 8];
    black_box(&BYTES[..])
}

#[cfg(not(any(feature = "bench", feature = "text")))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        safe fn a_panic_can_be_reached() -> !;
    }
    a_panic_can_be_reached()
}

#[cfg(all(feature = "text", not(feature = "bench")))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

/// The bench is executed and reports a panic's message. Its own code may panic.
#[cfg(feature = "bench")]
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m_semihosting::hprintln!("{}", info);
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}
