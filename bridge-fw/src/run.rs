//! The main loop of every board: start with the settings, turns, LED, watchdog and sleep.
//!
//! A board's program sets up pins, watchdog and clock, and calls [`run`] with a [`Board`].

use crate::can::{CanConfig, CanController};
use crate::gripper::{GripperLine, Uart, UartLine};
use crate::indicator::Indication;
use crate::io::{InputPort, OutputPort, Outputs};
use crate::log;
use crate::plc::{BoardId, BusPort, Config, Medium, Record};
use crate::register::ResetCause;
use crate::station::Station;
use crate::storage::NorFlash;

/// A board whose clock, timer and watchdog run.
pub struct Board<'a, H: Hardware, W, U> {
    /// LED, watchdog, time, and the start of the lines.
    pub hardware: H,
    /// Name and serial number of the board.
    pub id: BoardId,
    /// The PLC's wires.
    pub wires: W,
    /// UART to the gripper.
    pub gripper: UartLine<U>,
    /// Line of Modbus RTU; [`NoBus`](crate::NoBus) for a board without one.
    pub bus: &'a mut dyn BusPort,
    /// Service port; [`NoBus`](crate::NoBus) for a board without one.
    pub service: &'a mut dyn BusPort,
    /// Flash of the settings.
    pub flash: &'a mut H::Flash,
}

/// A board's hardware, as required by the main loop. No method waits except [`sleep`](Self::sleep).
///
/// The lines that the settings select are started once, before the first turn.
pub trait Hardware {
    /// CAN controller; [`NoCan`](crate::can::NoCan) for a board without one.
    type Can: CanController;
    /// Flash of the settings; [`NoFlash`](crate::storage::NoFlash) for a board without one.
    type Flash: NorFlash;

    /// Returns the settings of the image.
    fn delivered() -> Record;

    /// Starts the UART to the gripper, before the first turn.
    fn start_gripper(&mut self);

    /// Starts the service port, before the first turn.
    fn start_service(&mut self);

    /// Starts the UART of the PLC's bus, with the protocol that `config` selects ([`BusLine`](crate::plc::BusLine)).
    fn start_bus(&mut self, config: &Config);

    /// Starts the CAN controller at the rate of `config`.
    fn start_can(&mut self, _controller: &mut Self::Can, _config: &CanConfig) {}

    /// Returns the time since the start in milliseconds. It may wrap.
    fn now_ms(&mut self) -> u32;

    /// Switches the LED on or off.
    fn indicate(&mut self, is_lit: bool);

    /// Restarts the time-out of the watchdog. Only the main loop calls it: a watchdog fed from an interrupt would not detect
    /// a stalled loop.
    fn feed_watchdog(&mut self);

    /// Sleeps until the next interrupt, unless the time is past `now_ms` or a line has received data.
    ///
    /// The implementation checks both with interrupts masked. A later interrupt stays pending and ends the sleep immediately.
    fn sleep(&mut self, now_ms: u32, uses_can: bool);

    /// Performs flash operations that stall the MCU, after the outputs were written.
    fn after_turn(&mut self, _shown: Outputs, _flash: &mut Self::Flash) {}

    /// Enables the interrupts of the CAN controller again, if their handlers mask them. Called after each turn with CAN.
    fn rearm_can(&mut self, _controller: &mut Self::Can) {}

    /// Runs the handler of the bus's UART, if its protocol collects the results of a turn. Called once a millisecond.
    fn serve_bus(&mut self) {}
}

/// Error: a clock did not become ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoClock;

/// Runs the bridge on a board.
///
/// A gripper must not move with other recipes than those set up. If the image's settings are out of range, the outputs stay
/// low, the LED shows [`Indication::NotStarted`], and the watchdog resets the MCU.
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

/// Shows [`Indication::NotStarted`] until the watchdog resets the MCU, because without a clock there is no baud rate for the
/// gripper. `wait_ms` waits for 1 ms on the reset clock.
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
    /// Starts the bridge with its settings, and the lines that they select. Returns whether the main loop may begin.
    // Not inlined: its return removes configuration and record from the stack.
    #[inline(never)]
    fn start(&mut self, station: &mut Station<H::Can>, reset_cause: ResetCause) -> bool {
        log::boot(reset_cause);
        // By reference: moved out of the result, the configuration would be on the stack twice.
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
            hardware.serve_bus();
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
    if config.plc_bus.medium() == Some(Medium::Uart) {
        hardware.start_bus(config);
    }
    if station.uses_can() {
        hardware.start_can(station.can().controller(), &config.can);
    }
}

// loom's cells are not `Sync`, so a static cannot hold them.
#[cfg(all(test, not(loom)))]
mod tests;
