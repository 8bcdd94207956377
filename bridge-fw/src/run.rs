//! The main loop of every board: the start by the settings, one turn after the other, LED, watchdog, and sleep.
//!
//! A board's program sets up pins, watchdog and clock, and calls [`run`] with a [`Board`].

use crate::can::{CanConfig, CanController};
use crate::gripper::{GripperLine, Uart, UartLine};
use crate::indicator::Indication;
use crate::io::{InputPort, OutputPort, Outputs};
use crate::log;
use crate::plc::{BoardId, BusConfig, BusPort, Config, PlcBus, Record};
use crate::register::ResetCause;
use crate::station::Station;
use crate::storage::NorFlash;

/// A board whose clock, time and watchdog run, as one value.
pub struct Board<'a, H: Hardware, W, U> {
    /// LED, watchdog, time, and the starts of the lines.
    pub hardware: H,
    /// Its name and serial number.
    pub id: BoardId,
    /// The wires of the PLC.
    pub wires: W,
    /// The UART to the gripper.
    pub gripper: UartLine<U>,
    /// The line of Modbus RTU; [`NoBus`](crate::NoBus) for a board without one.
    pub bus: &'a mut dyn BusPort,
    /// The service port; [`NoBus`](crate::NoBus) for a board without one.
    pub service: &'a mut dyn BusPort,
    /// The flash of the settings.
    pub flash: &'a mut H::Flash,
}

/// What the main loop needs of a board's registers. Nothing here waits, but for [`sleep`](Self::sleep).
///
/// The lines that the settings choose are started once each, before the first turn.
pub trait Hardware {
    /// The CAN controller; [`NoCan`](crate::can::NoCan) for a board without one.
    type Can: CanController;
    /// The flash of the settings; [`NoFlash`](crate::storage::NoFlash) for a board that keeps none.
    type Flash: NorFlash;

    /// Returns the settings that the image was delivered with.
    fn delivered() -> Record;

    /// Starts the UART to the gripper.
    fn start_gripper(&mut self);

    /// Starts the service port.
    fn start_service(&mut self);

    /// Starts the PLC's bus with Modbus RTU.
    fn start_modbus(&mut self, config: &BusConfig);

    /// Starts the PLC's bus with PROFIBUS.
    fn start_profibus(&mut self) {}

    /// Starts the CAN controller.
    fn start_can(&mut self, _controller: &mut Self::Can, _config: &CanConfig) {}

    /// Returns milliseconds since the start. They may wrap.
    fn now_ms(&mut self) -> u32;

    /// Lights the LED, or not.
    fn indicate(&mut self, is_lit: bool);

    /// Restarts the time-out of the watchdog. Called by the main loop alone: fed from an interrupt, the watchdog would watch nothing.
    fn feed_watchdog(&mut self);

    /// Sleeps until the next interrupt, unless `now_ms` is over or a line has received something.
    ///
    /// Both are read with interrupts masked. An interrupt between that and the sleep then stays pending, which ends the sleep at once.
    fn sleep(&mut self, now_ms: u32, uses_can: bool);

    /// Does the work of the flash that stops everything else, after the outputs were written.
    fn after_turn(&mut self, _shown: Outputs, _flash: &mut Self::Flash) {}

    /// Lets the interrupts of the CAN controller run again, where their handlers mask them. Called after each turn with CAN.
    fn rearm_can(&mut self, _controller: &mut Self::Can) {}

    /// Has the handler of the bus run, which with PROFIBUS takes the results of the turn. Called once a millisecond.
    fn serve_bus(&mut self, _is_profibus: bool) {}
}

/// A clock did not become ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoClock;

/// Runs the bridge on a board.
///
/// With other recipes than the image was delivered with no gripper should be moved. So outputs stay low where the settings of the image
/// are out of range, the LED shows [`Indication::NotStarted`], and the watchdog resets the MCU.
pub fn run<H: Hardware, W: InputPort + OutputPort, U: Uart>(
    mut board: Board<'_, H, W, U>,
    station: &mut Station<H::Can>,
    reset_cause: ResetCause,
) -> ! {
    if !board.start(station, reset_cause) {
        loop {
            board.wait_for_watchdog();
        }
    }
    let mut served_ms = 0;
    loop {
        board.turn(station, &mut served_ms);
    }
}

/// Shows [`Indication::NotStarted`] until the watchdog resets the MCU: without a clock there is no baud rate to talk to the gripper with.
/// `wait_ms` waits for a millisecond of the clock of reset.
pub fn without_clock(mut indicate: impl FnMut(bool), wait_ms: impl Fn()) -> ! {
    log::no_clock();
    let mut now_ms = 0u32;
    loop {
        indicate(Indication::NotStarted.is_lit(now_ms));
        wait_ms();
        now_ms = now_ms.wrapping_add(1);
    }
}

impl<H: Hardware, W: InputPort + OutputPort, U: Uart> Board<'_, H, W, U> {
    /// Starts the bridge by its settings, and the lines that these choose; returns whether the main loop may begin.
    // Apart: neither configuration nor record is on the stack any more when it returns.
    #[inline(never)]
    fn start(&mut self, station: &mut Station<H::Can>, reset_cause: ResetCause) -> bool {
        log::boot(reset_cause);
        // By reference: taken out of the result it would be there twice.
        let loaded = station.load_delivered(H::delivered, self.flash);
        let Ok(config) = &loaded else {
            log::wrong_settings();
            return false;
        };
        station.start(config, self.id, reset_cause);
        start_lines(&mut self.hardware, station, config);
        log::running();
        true
    }

    fn turn(&mut self, station: &mut Station<H::Can>, served_ms: &mut u32) {
        let Self { hardware, wires, gripper, bus, service, flash, .. } = self;
        let now_ms = hardware.now_ms();
        let outputs = station.turn(now_ms, wires.read(), gripper, *bus, *service, *flash);
        wires.write(outputs);
        hardware.after_turn(outputs, flash);
        hardware.indicate(station.bridge().indication().is_lit(now_ms));
        let uses_can = station.uses_can();
        if uses_can {
            hardware.rearm_can(station.can().controller());
        }
        if core::mem::replace(served_ms, now_ms) != now_ms {
            hardware.serve_bus(station.uses_profibus());
        }
        if station.bridge().may_feed_watchdog(now_ms) {
            hardware.feed_watchdog();
        }
        log::lost(gripper);
        hardware.sleep(now_ms, uses_can);
    }

    fn wait_for_watchdog(&mut self) {
        let now_ms = self.hardware.now_ms();
        self.hardware.indicate(Indication::NotStarted.is_lit(now_ms));
        self.hardware.sleep(now_ms, false);
    }
}

fn start_lines<H: Hardware>(hardware: &mut H, station: &mut Station<H::Can>, config: &Config) {
    if config.gripper_line == GripperLine::Serial {
        hardware.start_gripper();
    }
    hardware.start_service();
    match config.plc_bus {
        PlcBus::Modbus => hardware.start_modbus(&config.bus),
        PlcBus::Profibus => hardware.start_profibus(),
        // None, or one on CAN.
        _ => {}
    }
    if station.uses_can() {
        hardware.start_can(station.can().controller(), &config.can);
    }
}

#[cfg(test)]
mod tests;
