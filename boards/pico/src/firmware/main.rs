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

use cortex_m::peripheral::NVIC;
use cortex_m_rt::{entry, exception};
use rp2040_hal::pac;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanConfig};
use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{InputPort, OutputPort, Outputs};
use wsg_bridge_fw::{Board, BusConfig, Lines, Station};
use wsg_pico::NAME;

use crate::can::Can;
use crate::flash::SettingsSectors;
use crate::pins::Wires;

/// Makes flash readable as memory: the boot ROM runs it.
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

#[entry]
fn main() -> ! {
    // Too large for the stack. (`entry` lends it safely: it runs once.)
    static mut STATION: Station<Can> =
        Station::new(CanBus::new(can::controller(), BusOffPolicy::DEFAULT), &bus::PROFIBUS);
    static mut FLASH: SettingsSectors = SettingsSectors::new();

    let reset_cause = watchdog::reset_cause();
    // Before everything that waits: whatever does not come up, the MCU starts over.
    let watchdog = watchdog::start();
    // SAFETY: `main` runs once, and nothing else takes them.
    let (mut core, peripherals) = unsafe { (cortex_m::Peripherals::steal(), pac::Peripherals::steal()) };
    // Outputs first: they show "not ready" through everything that may go wrong below.
    let mut wires = pins::init(peripherals);
    if clock::start().is_err() {
        // No crystal, no baud rate to talk to the gripper with.
        stay_not_ready(&mut wires, clock::RESET_HZ);
    }
    tick::start(core.SYST);
    let board = Board { name: NAME, serial: FLASH.serial_number() };
    let lines = &mut BoardLines { nvic: &mut core.NVIC };
    if STATION.boot(settings::delivered, FLASH, board, reset_cause, lines).is_err() {
        // With other recipes than were asked for, no gripper should be moved.
        stay_not_ready(&mut wires, clock::SYS_HZ);
    }
    let mut gripper_line = uart::line();
    let mut service_line = usb::service_line();
    let mut modbus_line = bus::line();

    let mut served_ms = 0;
    loop {
        let now_ms = tick::now_ms();
        let (bus, service) = (&mut modbus_line, &mut service_line);
        let outputs = STATION.turn(now_ms, wires.inputs.read(), &mut gripper_line, bus, service, FLASH);
        wires.outputs.write(outputs);
        let bus_is_silent = bus::is_silent();
        if bus_is_silent && uart::is_silent() && !outputs.contains(Outputs::BUSY) {
            FLASH.work();
        }
        wires.indicate(STATION.bridge().indication().is_lit(now_ms));
        if STATION.uses_can() {
            can::rearm();
        }
        if (STATION.uses_profibus() || !bus_is_silent) && core::mem::replace(&mut served_ms, now_ms) != now_ms
        {
            bus::serve();
        }
        if STATION.bridge().may_feed_watchdog(now_ms) {
            watchdog.feed();
        }
        sleep_unless(|| {
            tick::now_ms() != now_ms || uart::BUFFERS.has_received() || can::BUFFERS.has_received()
        });
    }
}

/// The lines of this board.
struct BoardLines<'a> {
    nvic: &'a mut NVIC,
}

impl Lines<Can> for BoardLines<'_> {
    fn start_gripper(&mut self) {
        uart::start();
    }

    fn start_service(&mut self) {
        usb::start_service();
    }

    fn start_modbus(&mut self, config: &BusConfig) {
        bus::start(config);
    }

    fn start_profibus(&mut self) {
        bus::start_profibus();
    }

    fn start_can(&mut self, controller: &mut Can, config: &CanConfig) {
        can::start(controller, config, self.nvic);
    }
}

/// Outputs stay low, and the watchdog, not fed from here, starts over; until then the LED says so.
fn stay_not_ready(wires: &mut Wires, core_hz: u32) -> ! {
    let mut now_ms = 0u32;
    loop {
        wires.indicate(Indication::NotStarted.is_lit(now_ms));
        cortex_m::asm::delay(core_hz / 1_000);
        now_ms = now_ms.wrapping_add(1);
    }
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
