//! The board's registers for the library's main loop.

use cortex_m::peripheral::NVIC;
use wsg_bridge_fw::can::CanConfig;
use wsg_bridge_fw::io::Outputs;
use wsg_bridge_fw::registers::Record;
use wsg_bridge_fw::{Config, Hardware};

use crate::can::{self, Can};
use crate::flash::{self, FirmwareFlash};
use crate::pins::Led;
use crate::watchdog::Watchdog;
use crate::{bus, settings, tick, uart, usb};

pub(crate) struct Registers {
    pub(crate) led: Led,
    pub(crate) watchdog: Watchdog,
    pub(crate) nvic: NVIC,
}

impl Hardware for Registers {
    type Can = Can;
    type Flash = FirmwareFlash;

    fn delivered() -> Record {
        settings::delivered()
    }

    fn start_gripper(&mut self) {
        uart::start();
    }

    fn start_service(&mut self) {
        usb::start_service();
    }

    fn start_bus(&mut self, config: &Config) {
        bus::start(config);
    }

    fn start_can(&mut self, controller: &mut Can, config: &CanConfig) {
        can::start(controller, config, &mut self.nvic);
    }

    fn now_ms(&mut self) -> u32 {
        tick::now_ms()
    }

    fn indicate(&mut self, is_lit: bool) {
        self.led.indicate(is_lit);
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.feed();
    }

    fn sleep(&mut self, now_ms: u32, _: bool) {
        cortex_m::interrupt::free(|_| {
            let has_received = || uart::BUFFERS.has_received() || can::BUFFERS.has_received();
            if tick::now_ms() == now_ms && !has_received() {
                cortex_m::asm::wfi();
            }
        });
    }

    /// Programs the flash, which blocks the program, only while the fingers are at rest and no line transmits.
    fn after_turn(&mut self, shown: Outputs, flash: &mut FirmwareFlash) {
        if bus::is_silent() && uart::is_silent() && !shown.contains(Outputs::BUSY) {
            flash::work(flash);
        }
    }

    fn rearm_can(&mut self, _: &mut Can) {
        can::rearm();
    }

    fn serve_bus(&mut self) {
        bus::serve();
    }
}
