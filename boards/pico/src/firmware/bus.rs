//! The PLC's bus: the interrupt-driven UART1 (RP2040, 4.2), with Modbus RTU or PROFIBUS.
//!
//! The UART has neither a driver enable output nor an interrupt after the last bit. The handler switches the pin, and an alarm
//! triggers it again until the last bit has been sent.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::plc::{BusHandler, BusLine, HalfDuplexUart, Interrupts, RtuPort, RtuUart};
use wsg_bridge_fw::{Config, Format};
use wsg_pico::BUS_DRIVER_ENABLE;

use crate::registers::{peripheral, reset, reset_bit, write};
use crate::tick;
use crate::uart::Port;

pub(crate) static BUS: BusLine = BusLine::new();

/// The driver enable pin in the registers of SIO.
const DRIVER: u32 = 1 << BUS_DRIVER_ENABLE;

/// The time of two bits in microseconds, rounded up: the maximum delay until the driver is switched off.
static TWO_BITS_US: AtomicU32 = AtomicU32::new(0);

/// The bridge's end of Modbus RTU on the bus. No character is sent or received before its start.
pub(crate) type Line = RtuPort<Uart1>;

/// Returns the bus's line. Call it once.
pub(crate) const fn line() -> Line {
    BUS.port(Uart1(()))
}

/// The main loop's access to the registers.
pub(crate) struct Uart1(());

impl RtuUart for Uart1 {
    fn pend(&mut self) {
        NVIC::pend(Interrupt::UART1_IRQ);
    }

    fn now_us(&mut self) -> u32 {
        tick::now_us()
    }
}

fn port() -> Port {
    Port(peripheral!(UART1))
}

/// Starts the bus. The clock must run and the pins must be set up. A handler that sets up the rate itself starts with the first
/// [`serve`].
pub(crate) fn start(config: &Config) {
    if let Some((baud, format)) = BUS.start(config) {
        set_up(baud, format);
    }
    // SAFETY: no critical section depends on this interrupt being masked. The handler shares only atomics with the rest of the
    // program.
    unsafe { NVIC::unmask(Interrupt::UART1_IRQ) };
}

/// Returns whether the bus does not transmit.
pub(crate) fn is_silent() -> bool {
    peripheral!(SIO).gpio_out().read().bits() & DRIVER == 0
}

/// Triggers the handler if it collects the results of a turn, or while the bus transmits: it then checks whether the last bit has
/// been sent. Call it at most once per millisecond, because each run ends the main loop's sleep.
pub(crate) fn serve() {
    if BUS.follows_turns() || !is_silent() {
        NVIC::pend(Interrupt::UART1_IRQ);
    }
}

/// Configures the bus for a rate and a format, before its start or later.
fn set_up(baud: u32, format: Format) {
    // If it stays in reset, the bus is silent.
    let _ = reset(reset_bit::UART1);
    TWO_BITS_US.store(2_000_000 / baud.max(1) + 1, Ordering::Relaxed);
    port().set_up(baud, format);
}

#[interrupt]
fn UART1_IRQ() {
    static mut HANDLER: BusHandler = BusHandler::new();
    HANDLER.serve(&BUS, &mut port());
}

/// UART1, connected to a transceiver.
impl HalfDuplexUart for Port {
    fn has_room(&mut self) -> bool {
        Port::has_room(*self)
    }

    fn enable(&mut self, Interrupts { transmit_empty, transmission_complete }: Interrupts) {
        self.wants_room(transmit_empty);
        if transmission_complete {
            tick::wake_bus_in(TWO_BITS_US.load(Ordering::Relaxed));
        }
    }

    fn drive(&mut self, is_on: bool) {
        let sio = peripheral!(SIO);
        if is_on {
            write(sio.gpio_out_set(), DRIVER);
        } else {
            write(sio.gpio_out_clr(), DRIVER);
        }
    }

    fn set_up(&mut self, baud: u32, format: Format) {
        set_up(baud, format);
    }

    fn wake_in(&mut self, us: u32) {
        tick::wake_bus_in(us);
    }

    fn now_ms(&mut self) -> u32 {
        tick::now_ms()
    }

    fn now_us(&mut self) -> u32 {
        tick::now_us()
    }
}
