//! The program of an STM32 board: its start, and its registers for the library's main loop.

use cortex_m::peripheral::SCB;
use wsg_bridge_fw::can::CanConfig;
use wsg_bridge_fw::registers::Record;
use wsg_bridge_fw::run::without_clock;
use wsg_bridge_fw::{Board, BoardId, Config, Hardware, Station};

use crate::board::Stm32Board;
use crate::chip::RESET_HZ;
use crate::flash::FirmwareFlash;
use crate::gpio::Led;
use crate::watchdog::Watchdog;
use crate::{bus, delivered, flash, gpio, gripper_line, reset, unique_id, watchdog};

/// Runs the bridge on a board.
pub fn run<B: Stm32Board>(station: &mut Station<B::Can>) -> ! {
    // Set up the outputs first, so that they show "not ready" if a later step fails.
    let (wires, mut led) = gpio::init::<B>();
    let Some(mut core) = cortex_m::Peripherals::take() else { SCB::sys_reset() };
    let reset_cause = reset::take_cause();
    let watchdog = watchdog::start();
    if B::start_clock().is_err() {
        without_clock(|is_lit| led.indicate(is_lit), || cortex_m::asm::delay(RESET_HZ / 1_000));
    }
    B::start_time(&mut core.SYST);
    let board = Board {
        hardware: Registers { led, watchdog },
        id: BoardId { name: B::NAME, serial: unique_id::serial_number() },
        wires,
        gripper: gripper_line::line::<B>(),
        bus: &mut bus::line::<B>(),
        service: &mut bus::service_line::<B>(),
        flash: &mut flash::open(B::ID),
    };
    wsg_bridge_fw::run(board, station, reset_cause)
}

struct Registers<B> {
    led: Led<B>,
    watchdog: Watchdog,
}

impl<B: Stm32Board> Hardware for Registers<B> {
    type Can = B::Can;
    type Flash = FirmwareFlash;

    fn delivered() -> Record {
        delivered::settings()
    }

    fn start_gripper(&mut self) {
        gripper_line::start::<B>();
    }

    fn start_service(&mut self) {
        bus::start_service::<B>();
    }

    fn start_bus(&mut self, config: &Config) {
        bus::start::<B>(config);
    }

    fn start_can(&mut self, controller: &mut B::Can, config: &CanConfig) {
        B::start_can(controller, config);
    }

    fn now_ms(&mut self) -> u32 {
        B::now_ms()
    }

    fn indicate(&mut self, is_lit: bool) {
        self.led.indicate(is_lit);
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.feed();
    }

    fn sleep(&mut self, now_ms: u32, uses_can: bool) {
        cortex_m::interrupt::free(|_| {
            let has_received = || gripper_line::BUFFERS.has_received() || (uses_can && B::can_has_received());
            if B::now_ms() == now_ms && !has_received() {
                cortex_m::asm::wfi();
            }
        });
    }

    fn rearm_can(&mut self, controller: &mut B::Can) {
        B::rearm_can(controller);
    }

    fn serve_bus(&mut self) {
        bus::serve::<B>();
    }
}
