//! Line of the PLC's bus, which runs Modbus RTU or PROFIBUS: the interrupt handler of its UART, and the data that it shares
//! with the main loop.
//!
//! A board implements [`HalfDuplexUart`] over its registers, keeps a [`BusLine`] and a [`BusHandler`] as statics, and calls
//! [`BusHandler::serve`] from the UART's handler. A line for Modbus RTU alone, such as the service port, needs only [`RtuBuffers`].

use bus_profibus::Character;
use embedded_hal_nb::serial;
use heapless::Vec;

use super::{Config, DpBuffers, DpResponder, Format, Interrupts, PlcBus, RtuBuffers, RtuPort, UartStatus};
use crate::atomic::{AtomicBool, Ordering};

/// A UART connected to an RS-485 transceiver, for its interrupt handler.
///
/// It reads and writes like a HAL's UART. No method waits, and `flush` succeeds once the last bit of all written bytes has
/// been sent.
pub trait HalfDuplexUart: serial::Read + serial::Write {
    /// Returns whether a byte can be written now.
    fn has_room(&mut self) -> bool;

    /// Enables the interrupts that the handler needs next, in addition to the one for a received character. A UART without an
    /// interrupt for the last bit runs the handler from a timer.
    fn enable(&mut self, interrupts: Interrupts);

    /// Switches the driver of the transceiver. Does nothing for a UART that does this itself.
    fn drive(&mut self, _is_on: bool) {}

    /// Sets the rate, in bit/s, and the format.
    fn set_up(&mut self, baud: u32, format: Format);

    /// Runs the handler in this many microseconds, and cancels a run that was scheduled before.
    fn wake_in(&mut self, us: u32);

    /// Returns the time in milliseconds. It may wrap.
    fn now_ms(&mut self) -> u32;

    /// Returns the time in microseconds. It may wrap.
    fn now_us(&mut self) -> u32;
}

/// Data shared by the handler of the bus and the main loop; a plain `static`.
#[derive(Debug, Default)]
pub struct BusLine {
    modbus: RtuBuffers,
    profibus: DpBuffers,
    /// The line runs PROFIBUS instead of Modbus RTU.
    is_profibus: AtomicBool,
}

impl BusLine {
    /// Creates a line that has not started.
    #[must_use]
    pub const fn new() -> Self {
        Self { modbus: RtuBuffers::new(), profibus: DpBuffers::new(), is_profibus: AtomicBool::new(false) }
    }

    /// Returns the main loop's end of Modbus RTU. Call this once.
    pub const fn port<U: super::RtuUart>(&'static self, uart: U) -> RtuPort<U> {
        RtuPort::new(uart, &self.modbus)
    }

    /// Returns the buffers of PROFIBUS, for [`Station::new`](crate::Station::new).
    #[must_use]
    pub const fn profibus(&self) -> &DpBuffers {
        &self.profibus
    }

    /// Starts the protocol that `config` selects, before the interrupt is unmasked. Returns the rate in bit/s and the format that
    /// the board sets up now; `None` if the handler sets them up in its first run.
    pub fn start(&self, config: &Config) -> Option<(u32, Format)> {
        if config.plc_bus == PlcBus::Profibus {
            self.is_profibus.store(true, Ordering::Relaxed);
            return None;
        }
        self.modbus.start(&config.bus);
        Some((config.bus.baud, config.bus.format))
    }

    /// Returns whether the handler must run after each turn of the main loop, whose results it collects.
    #[must_use]
    pub fn follows_turns(&self) -> bool {
        self.is_profibus.load(Ordering::Relaxed)
    }
}

/// State of the bus's interrupt handler: the PROFIBUS slave, created in the first run with PROFIBUS. As the initial value of
/// a static, it would also occupy its size of flash.
#[derive(Debug, Default)]
pub struct BusHandler(Vec<DpResponder, 1>);

impl BusHandler {
    /// Creates a handler without a slave. One for each [`BusLine`].
    #[must_use]
    pub const fn new() -> Self {
        Self(Vec::new())
    }

    /// Handles one interrupt, with at most one character each way. The interrupt stays pending while more is due.
    pub fn serve<U: HalfDuplexUart>(&mut self, line: &'static BusLine, uart: &mut U) {
        if !line.follows_turns() {
            return line.modbus.serve_half_duplex(uart);
        }
        if self.0.is_empty() {
            // Cannot fail: the capacity is one.
            let _ = self.0.push(DpResponder::new(&line.profibus));
        }
        if let Some(responder) = self.0.first_mut() {
            answer_master(responder, uart);
        }
    }
}

fn answer_master<U: HalfDuplexUart>(responder: &mut DpResponder, uart: &mut U) {
    let received = match uart.read() {
        Ok(byte) => Some(Character::Byte(byte)),
        Err(nb::Error::Other(_)) => Some(Character::Damaged),
        Err(nb::Error::WouldBlock) => None,
    };
    let status = UartStatus { received, has_room: uart.has_room(), is_complete: uart.flush().is_ok() };
    let action = responder.step(status, uart.now_ms(), uart.now_us());
    if let Some(rate) = action.rate {
        uart.set_up(rate.bit_s(), Format::Even1);
    }
    if let Some(wait_us) = action.wait_us {
        uart.wake_in(wait_us);
    }
    if let Some(byte) = action.send {
        uart.drive(true);
        // Cannot fail: `send` requires `has_room`.
        let _ = uart.write(byte);
    }
    go_on(uart, action.interrupts);
}

impl<const RX: usize, const TX: usize> RtuBuffers<RX, TX> {
    /// Handles one interrupt of a line for Modbus RTU, transceiver included, with at most one character each way.
    // Not inlined: all lines of a board share one copy.
    #[inline(never)]
    pub fn serve_half_duplex<U: HalfDuplexUart>(&self, uart: &mut U) {
        if self.interrupts().transmit_empty {
            uart.drive(true);
        }
        let now_us = uart.now_us();
        let interrupts = self.serve(uart, now_us);
        go_on(uart, interrupts);
    }
}

/// Enables interrupts, and switches the driver off when no transmit interrupt is due.
fn go_on<U: HalfDuplexUart>(uart: &mut U, interrupts: Interrupts) {
    uart.enable(interrupts);
    if !interrupts.transmit_empty && !interrupts.transmission_complete {
        uart.drive(false);
    }
}
