//! Two interrupt-driven UARTs: the PLC's bus (Modbus RTU or PROFIBUS) and the service port (Modbus RTU).
//!
//! The bus's UART controls the transceiver's driver (DE mode). The handler answers PROFIBUS requests and must return within 87
//! µs, the time of a byte on the gripper's line, because all interrupts have the same priority.

mod dp_timer;

use core::marker::PhantomData;

use cortex_m::peripheral::NVIC;
use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use stm32_metapac::Interrupt;
use stm32_metapac::usart::Lpuart;
use stm32_metapac::usart::regs::Isr;
use wsg_bridge_fw::plc::{BusHandler, BusLine, HalfDuplexUart, Interrupts, RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::{BusConfig, Config, Format};

use crate::Divider;
use crate::board::Stm32Board;
use crate::uart::{self, Uart};

pub use dp_timer::on_interrupt as on_timer_interrupt;

/// The line of the PLC's bus, shared with its interrupt handler.
pub static BUS: BusLine = BusLine::new();

static SERVICE: RtuBuffers = RtuBuffers::new();

/// The bridge's end of a Modbus RTU line. No character is sent or received before its start.
pub(crate) type Line<B> = RtuPort<Registers<B>>;

/// Returns the bus's line. Call it once.
pub(crate) const fn line<B: Stm32Board>() -> Line<B> {
    BUS.port(Registers(B::BusUart::INTERRUPT, PhantomData))
}

/// Returns the service port's line. Call it once.
pub(crate) const fn service_line<B: Stm32Board>() -> Line<B> {
    RtuPort::new(Registers(B::ServiceUart::INTERRUPT, PhantomData), &SERVICE)
}

/// The main loop's access to the registers.
pub(crate) struct Registers<B>(Interrupt, PhantomData<B>);

impl<B: Stm32Board> RtuUart for Registers<B> {
    fn pend(&mut self) {
        NVIC::pend(self.0);
    }

    fn now_us(&mut self) -> u32 {
        B::now_us()
    }
}

/// Starts the bus. The clock must run and the pins must be set up. At an unsupported rate, which settings never contain, the
/// bus stays silent. A handler that sets up the rate itself starts with the first [`serve`].
pub(crate) fn start<B: Stm32Board>(config: &Config) {
    match BUS.start(config) {
        Some((baud, format)) if !set_up_bus::<B>(baud, format) => return,
        Some(_) => {}
        None => dp_timer::start::<B>(),
    }
    uart::unmask(B::BusUart::INTERRUPT);
}

/// Triggers the bus's interrupt handler, if it collects the results of a turn.
pub(crate) fn serve<B: Stm32Board>() {
    if BUS.follows_turns() {
        NVIC::pend(B::BusUart::INTERRUPT);
    }
}

/// Starts the service port. The clock must run and the pins must be set up.
pub(crate) fn start_service<B: Stm32Board>() {
    B::ServiceUart::enable();
    SERVICE.start(&BusConfig::SERVICE);
    let divider = const { Divider::fixed(B::HCLK_HZ, BusConfig::SERVICE.baud) };
    uart::set_up(B::ServiceUart::REGISTERS, BusConfig::SERVICE.format, divider, 0);
    uart::unmask(B::ServiceUart::INTERRUPT);
}

/// Configures the bus for a rate and a format, before its start or later. Returns whether the board supports the rate.
// Not inlined: it has several callers.
#[inline(never)]
fn set_up_bus<B: Stm32Board>(baud: u32, format: Format) -> bool {
    let uart = B::BusUart::REGISTERS;
    B::BusUart::enable();
    // Rate and format must change while the UART is disabled.
    uart.cr1().write(|_| {});
    let Some(divider) = B::select_bus_clock(baud) else { return false };
    uart.cr3().write(|w| w.set_dem(true));
    uart::set_up(uart, format, divider, B::DRIVER_TIME);
    true
}

/// A UART in its handler, with the status at the start of the handler.
struct Port<B> {
    uart: Lpuart,
    status: Isr,
    board: PhantomData<B>,
}

impl<B> Port<B> {
    fn new(uart: Lpuart) -> Self {
        Self { uart, status: uart.isr().read(), board: PhantomData }
    }
}

impl<B> ErrorType for Port<B> {
    type Error = ErrorKind;
}

impl<B> Read for Port<B> {
    fn read(&mut self) -> nb::Result<u8, ErrorKind> {
        let Self { uart, status, .. } = *self;
        let received = if status.rxne() {
            let byte = (uart.rdr().read().0 & 0xFF) as u8;
            if uart::is_damaged(status) { Err(nb::Error::Other(ErrorKind::Other)) } else { Ok(byte) }
        } else if status.ore() {
            // A byte was received between reading the status and reading the previous byte.
            Err(nb::Error::Other(ErrorKind::Overrun))
        } else {
            Err(nb::Error::WouldBlock)
        };
        uart::clear_errors(uart, status);
        received
    }
}

impl<B> Write for Port<B> {
    fn write(&mut self, byte: u8) -> nb::Result<(), ErrorKind> {
        if !self.status.txe() {
            return Err(nb::Error::WouldBlock);
        }
        self.uart.tdr().write(|w| w.0 = byte.into());
        Ok(())
    }

    fn flush(&mut self) -> nb::Result<(), ErrorKind> {
        if self.status.tc() { Ok(()) } else { Err(nb::Error::WouldBlock) }
    }
}

impl<B: Stm32Board> HalfDuplexUart for Port<B> {
    fn has_room(&mut self) -> bool {
        self.status.txe()
    }

    fn enable(&mut self, interrupts: Interrupts) {
        uart::enable(self.uart, interrupts);
    }

    /// Only PROFIBUS calls this, so the UART is the bus's.
    fn set_up(&mut self, baud: u32, format: Format) {
        set_up_bus::<B>(baud, format);
    }

    fn wake_in(&mut self, us: u32) {
        dp_timer::wake_in(us);
    }

    fn now_ms(&mut self) -> u32 {
        B::now_ms()
    }

    fn now_us(&mut self) -> u32 {
        B::now_us()
    }
}

/// Serves the bus. Call it from the UART's interrupt handler.
#[inline]
pub fn on_bus_interrupt<B: Stm32Board>(handler: &mut BusHandler) {
    handler.serve(&BUS, &mut Port::<B>::new(B::BusUart::REGISTERS));
}

/// Serves the service port. Call it from the UART's interrupt handler.
#[inline]
pub fn on_service_interrupt<B: Stm32Board>() {
    SERVICE.serve_half_duplex(&mut Port::<B>::new(B::ServiceUart::REGISTERS));
}
