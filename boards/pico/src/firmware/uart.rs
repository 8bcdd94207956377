//! The gripper's line: UART0, 115200 baud, 8N1, interrupt driven both ways (RP2040, 4.2), and what both UARTs have in common.

use cortex_m::peripheral::NVIC;
use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use rp2040_hal::pac::uart0::RegisterBlock as Registers;
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::Format;
use wsg_bridge_fw::gripper::{BAUD, Uart, UartBuffers, UartLine};

use crate::clock::SYS_HZ;
use crate::registers::{peripheral, reset, reset_bit, write};

/// UARTFR: sending; nothing received; no room to send.
const BUSY: u32 = 1 << 3;
const RXFE: u32 = 1 << 4;
const TXFF: u32 = 1 << 5;

/// UARTDR: what is wrong with a character.
const FE: u32 = 1 << 8;
const PE: u32 = 1 << 9;
const BE: u32 = 1 << 10;
const OE: u32 = 1 << 11;

/// UARTLCR_H: parity, and that it is even; two stop bits; eight bits. Without FIFOs, whose interrupts come late: the time of
/// each character counts.
const PEN: u32 = 1 << 1;
const EPS: u32 = 1 << 2;
const STP2: u32 = 1 << 3;
const WLEN_8: u32 = 0b11 << 5;

/// UARTCR: on, both ways.
const UARTEN: u32 = 1 << 0;
const TXE: u32 = 1 << 8;
const RXE: u32 = 1 << 9;

/// UARTIMSC: a character was received; there is room to send.
const RXIM: u32 = 1 << 4;
const TXIM: u32 = 1 << 5;

/// A UART, for its handler.
#[derive(Clone, Copy)]
pub(crate) struct Port(pub(crate) &'static Registers);

impl Port {
    /// Sets rate and format, before its start or anew, and switches it on.
    pub(crate) fn set_up(self, baud: u32, format: Format) {
        let (whole, sixty_fourths) = divider(baud);
        write(self.0.uartcr(), 0);
        write(self.0.uartibrd(), whole);
        write(self.0.uartfbrd(), sixty_fourths);
        // Takes the divider over as well.
        let bits = match format {
            Format::Even1 => PEN | EPS,
            Format::None1 => 0,
            Format::None2 => STP2,
        };
        write(self.0.uartlcr_h(), WLEN_8 | bits);
        write(self.0.uartimsc(), RXIM);
        write(self.0.uartcr(), UARTEN | TXE | RXE);
    }

    /// Whether there is room to send.
    pub(crate) fn has_room(self) -> bool {
        self.0.uartfr().read().bits() & TXFF == 0
    }

    /// Whether the last bit of all that it was given has been sent.
    pub(crate) fn is_complete(self) -> bool {
        self.0.uartfr().read().bits() & BUSY == 0
    }

    /// Whether room to send is worth an interrupt.
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
            // It came whole; one before it did not.
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

/// A 16th of the clock over the rate: whole, and the rest in 64ths, rounded. It fits from 120 bit/s to 7.8 Mbit/s.
fn divider(baud: u32) -> (u32, u32) {
    let sixty_fourths = (SYS_HZ * 4 + baud / 2).checked_div(baud).unwrap_or(u32::MAX);
    (sixty_fourths >> 6, sixty_fourths & 0x3F)
}
const _: () = assert!(SYS_HZ <= u32::MAX / 8);

/// The bytes on their way.
pub(crate) static BUFFERS: UartBuffers = UartBuffers::new();

/// The bridge's end of the line to the gripper; nothing comes and goes before [`start`].
pub(crate) type GripperLine = UartLine<Uart0>;

/// The end of the line. To be asked for once.
pub(crate) const fn line() -> GripperLine {
    UartLine::new(Uart0(()), &BUFFERS)
}

/// What the main loop needs of the registers.
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

/// Starts the line. The clock runs, the pins are set up.
pub(crate) fn start() {
    // Should it not come out of reset, the gripper is silent, which the PLC is shown.
    let _ = reset(reset_bit::UART0);
    port().set_up(BAUD, Format::None1);
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(Interrupt::UART0_IRQ) };
}

/// Whether nothing is being sent.
pub(crate) fn is_silent() -> bool {
    // One that was not started is in reset, and has nothing to tell.
    !NVIC::is_enabled(Interrupt::UART0_IRQ) || (!BUFFERS.has_to_send() && port().is_complete())
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn UART0_IRQ() {
    let mut port = port();
    let needs_room = BUFFERS.serve(&mut port);
    port.wants_room(needs_room);
}
