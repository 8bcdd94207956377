//! The bridge on the Raspberry Pi Pico (RP2040): start, main loop, faults.
//!
//! Here are pins, clocks, interrupts and nothing else; what the bridge does is in its library. Register names are those of
//! Raspberry Pi's RP2040 data sheet.

#![no_std]
#![no_main]
#![deny(
    clippy::undocumented_unsafe_blocks,
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]

mod board;
mod bus;
mod can;
mod clock;
mod flash;
mod pins;
mod registers;
mod settings;
mod tick;
mod uart;
mod usb;
mod watchdog;

use core::panic::PanicInfo;

use cortex_m_rt::{entry, exception};
use rp2040_hal::pac;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::run::without_clock;
use wsg_bridge_fw::{Board, BoardId, Station};
use wsg_pico::NAME;

use crate::board::Registers;
use crate::can::Can;
use crate::flash::SettingsSectors;

/// Makes flash readable as memory: the boot ROM runs it.
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

#[entry]
fn main() -> ! {
    // Too large for the stack. (`entry` lends it safely: it runs once.)
    static mut STATION: Station<Can> =
        Station::new(CanBus::new(can::controller(), BusOffPolicy::DEFAULT), bus::BUS.profibus());
    static mut FLASH: SettingsSectors = SettingsSectors::new();

    let reset_cause = watchdog::reset_cause();
    // Before everything that waits: whatever does not come up, the MCU starts over.
    let watchdog = watchdog::start();
    // SAFETY: `main` runs once, and nothing else takes them.
    let (mut core, peripherals) = unsafe { (cortex_m::Peripherals::steal(), pac::Peripherals::steal()) };
    // Outputs first: they show "not ready" through everything that may go wrong below.
    let (wires, mut led) = pins::init(peripherals);
    if clock::start().is_err() {
        without_clock(|is_lit| led.indicate(is_lit), || cortex_m::asm::delay(clock::RESET_HZ / 1_000));
    }
    tick::start(&mut core.SYST);
    let board = Board {
        hardware: Registers { led, watchdog, nvic: core.NVIC },
        id: BoardId { name: NAME, serial: FLASH.serial_number() },
        wires,
        gripper: uart::line(),
        bus: &mut bus::line(),
        service: &mut usb::service_line(),
        flash: FLASH,
    };
    wsg_bridge_fw::run(board, STATION, reset_cause)
}

/// A reset puts every output low and lets the bridge start from what it can know for sure.
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

// SAFETY: the handler uses nothing of the program that was interrupted.
#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    watchdog::reset()
}

/// An interrupt that nobody enabled is as much a fault as a bus error.
// SAFETY: the handler uses nothing of the program that was interrupted.
#[exception]
unsafe fn DefaultHandler(_interrupt: i16) -> ! {
    watchdog::reset()
}
