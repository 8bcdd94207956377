//! The bridge on the Raspberry Pi Pico (RP2040): start and main loop.
//!
//! This program contains only pins, clocks and interrupts; the library implements the bridge. Register names follow Raspberry
//! Pi's RP2040 data sheet.

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
mod faults;
mod flash;
mod pins;
mod registers;
mod settings;
mod tick;
mod uart;
mod usb;
mod watchdog;

use cortex_m_rt::entry;
use rp2040_hal::pac;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::run::without_clock;
use wsg_bridge_fw::{Board, BoardId, Station};
use wsg_pico::NAME;

use crate::board::Registers;
use crate::can::Can;
use crate::flash::FirmwareFlash;

/// The second boot stage, which makes flash readable as memory. The boot ROM runs it. With a boot loader, that one contains it.
#[cfg(not(feature = "slot"))]
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

#[entry]
fn main() -> ! {
    // Too large for the stack. `entry` makes this safe, because it runs only once.
    static mut STATION: Station<Can> =
        Station::new(CanBus::new(can::controller(), BusOffPolicy::DEFAULT), bus::BUS.profibus());
    static mut FLASH: FirmwareFlash = flash::FIRMWARE;

    let reset_cause = watchdog::reset_cause();
    // Started before any wait, so that a failed start resets the MCU.
    let watchdog = watchdog::start();
    // SAFETY: `main` runs once, and no other code takes the peripherals.
    let (mut core, peripherals) = unsafe { (cortex_m::Peripherals::steal(), pac::Peripherals::steal()) };
    // Set up the outputs first, so that they show "not ready" if a later step fails.
    let (wires, mut led) = pins::init(peripherals);
    if clock::start().is_err() {
        without_clock(|is_lit| led.indicate(is_lit), || cortex_m::asm::delay(clock::RESET_HZ / 1_000));
    }
    tick::start(&mut core.SYST);
    let serial = flash::settings(FLASH).serial_number();
    #[cfg(feature = "slot")]
    {
        FLASH.updater = flash::slots::updater();
    }
    let board = Board {
        hardware: Registers { led, watchdog, nvic: core.NVIC },
        id: BoardId { name: NAME, serial },
        wires,
        gripper: uart::line(),
        bus: &mut bus::line(),
        service: &mut usb::service_line(),
        flash: FLASH,
    };
    wsg_bridge_fw::run(board, STATION, reset_cause)
}
