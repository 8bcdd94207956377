//! The bridge on the board B-L475E-IOT01A (STM32L475VG): start, main loop, faults.
//!
//! Here and in the board's drivers are pins, clocks, interrupts and nothing else; what the bridge does is in its
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

mod log;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{entry, exception};
use wsg_b_l475e_iot01a::NAME;
use wsg_b_l475e_iot01a::drivers::can1::{self, Can1};
use wsg_b_l475e_iot01a::drivers::{Iot01a, TICK, clock};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanConfig};
use wsg_bridge_fw::indicator::Indication;
use wsg_bridge_fw::io::{InputPort, OutputPort};
use wsg_bridge_fw::{Board, BusConfig, Lines, Station};
use wsg_stm32::bus::Responder;
use wsg_stm32::gpio::Pins;
use wsg_stm32::pac::interrupt;
use wsg_stm32::{bus, chip, delivered, flash, gripper_line, reset, unique_id, watchdog};

#[entry]
fn main() -> ! {
    // Too large for the stack. (`entry` lends it safely: it runs once.)
    static mut STATION: Station<Can1> =
        Station::new(CanBus::new(Can1::new(), BusOffPolicy::DEFAULT), &bus::PROFIBUS);

    // Outputs first: they show "not ready" through everything that may go wrong below.
    let mut pins = Pins::<Iot01a>::init();
    let Some(core) = cortex_m::Peripherals::take() else { SCB::sys_reset() };
    let reset_cause = reset::take_cause();
    log::boot(reset_cause);
    let watchdog = watchdog::start();
    if clock::start().is_err() {
        log::no_clock();
        // No PLL, no baud rate to talk to the gripper with.
        stay_not_ready(&mut pins, chip::RESET_HZ);
    }
    let mut flash = flash::settings_pages();
    TICK.start(core.SYST);
    let board = Board { name: NAME, serial: unique_id::serial_number() };
    if STATION.boot(delivered::settings, &flash, board, reset_cause, &mut BoardLines).is_err() {
        log::wrong_settings();
        // With other recipes than were asked for, no gripper should be moved.
        stay_not_ready(&mut pins, clock::HCLK_HZ);
    }
    let mut gripper_line = gripper_line::line::<Iot01a>();
    let mut service_line = bus::service_line::<Iot01a>();
    let mut modbus_line = bus::line::<Iot01a>();
    log::running();

    let mut served_ms = 0;
    loop {
        let now_ms = TICK.now_ms();
        let (bus, service) = (&mut modbus_line, &mut service_line);
        let outputs = STATION.turn(now_ms, pins.read(), &mut gripper_line, bus, service, &mut flash);
        pins.write(outputs);
        pins.indicate(STATION.bridge().indication().is_lit(now_ms));
        if STATION.uses_can() {
            STATION.can().controller().rearm();
        }
        if STATION.uses_profibus() && core::mem::replace(&mut served_ms, now_ms) != now_ms {
            bus::serve_profibus::<Iot01a>();
        }
        if STATION.bridge().may_feed_watchdog(now_ms) {
            watchdog.feed();
        }
        log::line_errors();
        let uses_can = STATION.uses_can();
        sleep_unless(|| {
            TICK.now_ms() != now_ms
                || gripper_line::BUFFERS.has_received()
                || (uses_can && can1::has_received())
        });
    }
}

/// The lines of this board.
struct BoardLines;

impl Lines<Can1> for BoardLines {
    fn start_gripper(&mut self) {
        gripper_line::start::<Iot01a>();
    }

    fn start_service(&mut self) {
        bus::start_service::<Iot01a>();
    }

    fn start_modbus(&mut self, config: &BusConfig) {
        bus::start::<Iot01a>(config);
    }

    fn start_profibus(&mut self) {
        bus::start_profibus::<Iot01a>();
    }

    fn start_can(&mut self, controller: &mut Can1, config: &CanConfig) {
        controller.start(config);
    }
}

/// Outputs stay low, and the watchdog, not fed from here, starts over; until then the LED says so.
fn stay_not_ready(pins: &mut Pins<Iot01a>, core_hz: u32) -> ! {
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

#[exception]
fn SysTick() {
    TICK.count();
}

#[interrupt]
fn LPUART1() {
    static mut RESPONDER: Responder = Responder::new();
    bus::on_bus_interrupt::<Iot01a>(RESPONDER);
}

#[interrupt]
fn USART1() {
    bus::on_service_interrupt::<Iot01a>();
}

#[interrupt]
fn TIM6_DAC() {
    bus::on_timer_interrupt::<Iot01a>();
}
