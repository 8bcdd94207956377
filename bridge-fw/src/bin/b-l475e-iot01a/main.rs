//! The bridge on the board B-L475E-IOT01A (STM32L475VG): start, main loop, faults.
//!
//! This directory holds pins, clocks, interrupts and nothing else; what the bridge does is in the
//! library. Register names are those of ST's RM0351.

#![no_std]
#![no_main]
#![deny(
    clippy::undocumented_unsafe_blocks,
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]

#[cfg(not(feature = "can-plc"))]
mod bus;
#[cfg(any(feature = "can-gripper", feature = "can-plc"))]
mod can;
#[cfg(all(not(feature = "can-over-slcan"), any(feature = "can-gripper", feature = "can-plc")))]
mod can1;
mod clock;
mod log;
#[cfg(any(not(feature = "can-gripper"), feature = "can-over-slcan"))]
mod not_ready;
mod pins;
mod reset;
#[cfg(all(feature = "can-over-slcan", any(feature = "can-gripper", feature = "can-plc")))]
mod slcan_uart;
mod tick;
#[cfg(not(feature = "can-gripper"))]
mod uart;
mod watchdog;

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{entry, exception};
use wsg_bridge_fw::io::{InputPort, OutputPort};
#[cfg(not(feature = "can-plc"))]
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::{Bridge, BusConfig, Config};

/// What this image is built with.
const CONFIG: Config = Config { bus: BusConfig::BUILT, ..Config::DEFAULT };

#[entry]
fn main() -> ! {
    // Too large for the stack. (`entry` lends it safely: it runs once.)
    static mut BRIDGE: Bridge = Bridge::new(CONFIG);
    #[cfg(not(feature = "can-plc"))]
    static mut MODBUS: Modbus = Modbus::new(&CONFIG);
    #[cfg(any(feature = "can-gripper", feature = "can-plc"))]
    static mut CAN: can::Can = can::Can::new();

    // Outputs first: they show "not ready" through everything that may go wrong below.
    let mut pins = pins::init();
    let Some(core) = cortex_m::Peripherals::take() else { SCB::sys_reset() };
    let reset_cause = reset::take_cause();
    BRIDGE.set_reset_cause(reset_cause);
    log::boot(reset_cause);
    let watchdog = watchdog::start();
    if clock::start().is_err() {
        log::no_clock();
        // No PLL, no baud rate to talk to the gripper with: outputs stay low, and the watchdog, not
        // fed from here, starts over.
        loop {
            cortex_m::asm::nop();
        }
    }
    tick::start(core.SYST);
    #[cfg(not(feature = "can-gripper"))]
    let mut gripper_line = uart::start();
    #[cfg(not(feature = "can-plc"))]
    let mut plc_bus = bus::start();
    #[cfg(any(feature = "can-gripper", feature = "can-plc"))]
    CAN.start();
    log::running();

    loop {
        let now_ms = tick::now_ms();
        let inputs = pins.read();
        #[cfg(not(any(feature = "can-gripper", feature = "can-plc")))]
        let outputs = BRIDGE.poll(now_ms, inputs, &mut gripper_line, &mut MODBUS.over(&mut plc_bus));
        #[cfg(all(feature = "can-gripper", not(feature = "can-plc")))]
        let outputs = CAN.turn(BRIDGE, now_ms, inputs, &mut MODBUS.over(&mut plc_bus));
        #[cfg(all(feature = "can-plc", not(feature = "can-gripper")))]
        let outputs = CAN.turn(BRIDGE, now_ms, inputs, &mut gripper_line);
        #[cfg(all(feature = "can-gripper", feature = "can-plc"))]
        let outputs = CAN.turn(BRIDGE, now_ms, inputs);
        pins.write(outputs);
        if BRIDGE.may_feed_watchdog(now_ms) {
            watchdog.feed();
        }
        log::line_errors();
        sleep_unless(|| tick::now_ms() != now_ms || has_received());
    }
}

/// Whether something waits to be read.
fn has_received() -> bool {
    #[cfg(not(feature = "can-gripper"))]
    if uart::has_received() {
        return true;
    }
    #[cfg(any(feature = "can-gripper", feature = "can-plc"))]
    if can::has_received() {
        return true;
    }
    false
}

/// Sleeps until the next interrupt, unless `there_is_work`.
fn sleep_unless(there_is_work: impl FnOnce() -> bool) {
    // An interrupt that comes between the look and `wfi` would be slept over until the next one. With
    // interrupts masked it stays pending instead, and a pending interrupt ends `wfi` at once.
    cortex_m::interrupt::free(|_| {
        if !there_is_work() {
            cortex_m::asm::wfi();
        }
    });
}

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
