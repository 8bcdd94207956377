//! The bridge on the board NUCLEO-G474RE (STM32G474RE): start, main loop, faults.
//!
//! Here are pins, clocks, interrupts and nothing else; what the bridge does is in its library. Register names are those of ST's
//! RM0440. Compiled, linked and measured; never run.

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
mod can;
mod clock;

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanConfig};
use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{InputPort, OutputPort};
use wsg_bridge_fw::{Board, BusConfig, Lines, Station};
use wsg_nucleo_g474re::NAME;
use wsg_stm32::gpio::Pins;
use wsg_stm32::{bus, chip, delivered, flash, gripper_line, reset, unique_id, watchdog};

use crate::board::{Nucleo, TICK};
use crate::can::Can;

#[entry]
fn main() -> ! {
    // Too large for the stack. (`entry` lends it safely: it runs once.)
    static mut STATION: Station<Can> =
        Station::new(CanBus::new(Can::new(), BusOffPolicy::DEFAULT), &bus::PROFIBUS);

    // Outputs first: they show "not ready" through everything that may go wrong below.
    let mut pins = Pins::<Nucleo>::init();
    let Some(core) = cortex_m::Peripherals::take() else { SCB::sys_reset() };
    let reset_cause = reset::take_cause();
    let watchdog = watchdog::start();
    if clock::start().is_err() {
        // No crystal, no baud rate to talk to the gripper with.
        stay_not_ready(&mut pins, chip::RESET_HZ);
    }
    let mut flash = flash::settings_pages();
    TICK.start(core.SYST);
    let board = Board { name: NAME, serial: unique_id::serial_number() };
    if STATION.boot(delivered::settings, &flash, board, reset_cause, &mut BoardLines).is_err() {
        // With other recipes than were asked for, no gripper should be moved.
        stay_not_ready(&mut pins, clock::HCLK_HZ);
    }
    let mut gripper_line = gripper_line::line::<Nucleo>();
    let mut service_line = bus::service_line::<Nucleo>();
    let mut modbus_line = bus::line::<Nucleo>();

    let mut served_ms = 0;
    loop {
        let now_ms = TICK.now_ms();
        let (bus, service) = (&mut modbus_line, &mut service_line);
        let outputs = STATION.turn(now_ms, pins.read(), &mut gripper_line, bus, service, &mut flash);
        pins.write(outputs);
        pins.indicate(STATION.bridge().indication().is_lit(now_ms));
        if STATION.uses_profibus() && core::mem::replace(&mut served_ms, now_ms) != now_ms {
            bus::serve_profibus::<Nucleo>();
        }
        if STATION.bridge().may_feed_watchdog(now_ms) {
            watchdog.feed();
        }
        let uses_can = STATION.uses_can();
        sleep_unless(|| {
            TICK.now_ms() != now_ms
                || gripper_line::BUFFERS.has_received()
                || (uses_can && can::has_received())
        });
    }
}

/// The lines of this board.
struct BoardLines;

impl Lines<Can> for BoardLines {
    fn start_gripper(&mut self) {
        gripper_line::start::<Nucleo>();
    }

    fn start_service(&mut self) {
        bus::start_service::<Nucleo>();
    }

    fn start_modbus(&mut self, config: &BusConfig) {
        bus::start::<Nucleo>(config);
    }

    fn start_profibus(&mut self) {
        bus::start_profibus::<Nucleo>();
    }

    fn start_can(&mut self, controller: &mut Can, config: &CanConfig) {
        controller.start(config);
    }
}

/// Outputs stay low, and the watchdog, not fed from here, starts over; until then the LED says so.
fn stay_not_ready(pins: &mut Pins<Nucleo>, core_hz: u32) -> ! {
    let mut now_ms = 0u32;
    loop {
        pins.indicate(Indication::NotStarted.is_lit(now_ms));
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
