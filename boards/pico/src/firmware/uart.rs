//! The gripper's line, the interrupt-driven UART0 at 115 200 bit/s, 8N1 (RP2040, 4.2), and functions shared by both UARTs.

use cortex_m::peripheral::NVIC;
use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use rp2040_hal::pac::uart0::RegisterBlock as Registers;
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::Format;
use wsg_bridge_fw::gripper::{BAUD, Uart, UartBuffers, UartLine};

use crate::clock::SYS_HZ;
use crate::registers::{peripheral, reset, reset_bit, write};

/// UARTFR: transmitting, receiver empty, transmitter full.
const BUSY: u32 = 1 << 3;
const RXFE: u32 = 1 << 4;
const TXFF: u32 = 1 << 5;

/// UARTDR: errors of a character.
const FE: u32 = 1 << 8;
const PE: u32 = 1 << 9;
const BE: u32 = 1 << 10;
const OE: u32 = 1 << 11;

/// UARTLCR_H: parity, even parity, two stop bits, eight bits. FIFOs stay disabled, because their interrupts are late and the
/// time of each character matters.
const PEN: u32 = 1 << 1;
const EPS: u32 = 1 << 2;
const STP2: u32 = 1 << 3;
const WLEN_8: u32 = 0b11 << 5;

/// UARTCR: enable, transmitter, receiver.
const UARTEN: u32 = 1 << 0;
const TXE: u32 = 1 << 8;
const RXE: u32 = 1 << 9;

/// UARTIMSC: character received, room to transmit.
const RXIM: u32 = 1 << 4;
const TXIM: u32 = 1 << 5;

/// A UART, for its handler.
#[derive(Clone, Copy)]
pub(crate) struct Port(pub(crate) &'static Registers);

impl Port {
    /// Sets rate and format, before the start or later, and enables the UART.
    pub(crate) fn set_up(self, baud: u32, format: Format) {
        let (whole, sixty_fourths) = divider(baud);
        write(self.0.uartcr(), 0);
        write(self.0.uartibrd(), whole);
        write(self.0.uartfbrd(), sixty_fourths);
        // This write also applies the divider.
        let bits = match format {
            Format::Even1 => PEN | EPS,
            Format::None1 => 0,
            Format::None2 => STP2,
        };
        write(self.0.uartlcr_h(), WLEN_8 | bits);
        write(self.0.uartimsc(), RXIM);
        write(self.0.uartcr(), UARTEN | TXE | RXE);
    }

    /// Returns whether the transmitter has room.
    pub(crate) fn has_room(self) -> bool {
        self.0.uartfr().read().bits() & TXFF == 0
    }

    /// Returns whether the last bit of all data has been sent.
    pub(crate) fn is_complete(self) -> bool {
        self.0.uartfr().read().bits() & BUSY == 0
    }

    /// Enables or disables the interrupt for room to transmit.
    pub(crate) fn wants_room(self, wanted: bool) {
        write(self.0.uartimsc(), if wanted { RXIM | TXIM } else { RXIM });
    }
}

impl ErrorType for Port {
    type Error = ErrorKind;
}

impl Read for Port {
    fn read(&mut self) -> nb::Result<u8, ErrorKind> {
        if self.0.uartfr().read().bits() & RXFE != 0 {
            return Err(nb::Error::WouldBlock);
        }
        let data = self.0.uartdr().read().bits();
        match data & (OE | FE | BE | PE) {
            0 => Ok((data & 0xFF) as u8),
            // This character is intact; an earlier one was lost.
            OE => Err(nb::Error::Other(ErrorKind::Overrun)),
            PE => Err(nb::Error::Other(ErrorKind::Parity)),
            _ => Err(nb::Error::Other(ErrorKind::FrameFormat)),
        }
    }
}

impl Write for Port {
    fn write(&mut self, byte: u8) -> nb::Result<(), ErrorKind> {
        if !self.has_room() {
            return Err(nb::Error::WouldBlock);
        }
        write(self.0.uartdr(), byte.into());
        Ok(())
    }

    fn flush(&mut self) -> nb::Result<(), ErrorKind> {
        if self.is_complete() { Ok(()) } else { Err(nb::Error::WouldBlock) }
    }
}

/// Returns the divider: the clock by 16 times the rate, as an integer and 64ths, rounded. Valid from 120 bit/s to 7.8 Mbit/s.
fn divider(baud: u32) -> (u32, u32) {
    let sixty_fourths = (SYS_HZ * 4 + baud / 2).checked_div(baud).unwrap_or(u32::MAX);
    (sixty_fourths >> 6, sixty_fourths & 0x3F)
}
const _: () = assert!(SYS_HZ <= u32::MAX / 8);

/// The receive and transmit queues.
pub(crate) static BUFFERS: UartBuffers = UartBuffers::new();

/// The bridge's end of the line to the gripper. No byte is sent or received before [`start`].
pub(crate) type GripperLine = UartLine<Uart0>;

/// Returns the gripper's line. Call it once.
pub(crate) const fn line() -> GripperLine {
    UartLine::new(Uart0(()), &BUFFERS)
}

/// The main loop's access to the registers.
pub(crate) struct Uart0(());

impl Uart for Uart0 {
    fn pend(&mut self) {
        NVIC::pend(Interrupt::UART0_IRQ);
    }

    fn is_idle(&mut self) -> bool {
        port().is_complete()
    }
}

fn port() -> Port {
    Port(peripheral!(UART0))
}

/// Starts the line. The clock must run and the pins must be set up.
pub(crate) fn start() {
    // If it stays in reset, the gripper is silent, which the PLC is shown.
    let _ = reset(reset_bit::UART0);
    port().set_up(BAUD, Format::None1);
    // SAFETY: no critical section depends on this interrupt being masked. The handler shares only atomics with the rest of the
    // program.
    unsafe { NVIC::unmask(Interrupt::UART0_IRQ) };
}

/// Returns whether the line does not transmit.
pub(crate) fn is_silent() -> bool {
    // A line that is not started is still in reset, so its registers are not read.
    !NVIC::is_enabled(Interrupt::UART0_IRQ) || (!BUFFERS.has_to_send() && port().is_complete())
}

/// Transfers one byte in each direction; the interrupt stays pending if there is more.
#[interrupt]
fn UART0_IRQ() {
    let mut port = port();
    let needs_room = BUFFERS.serve(&mut port);
    port.wants_room(needs_room);
}
