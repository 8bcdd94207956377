//! The PLC's bus: UART1, interrupt driven both ways (RP2040, 4.2), with Modbus RTU or PROFIBUS.
//!
//! The UART has neither a driver enable nor an interrupt behind the last bit: the handler switches the pin, and an alarm has it
//! look again until the last bit has been sent.

use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use bus_profibus::Character;
use cortex_m::peripheral::NVIC;
use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::plc::{DpBuffers, DpResponder, Interrupts, RtuBuffers, RtuPort, RtuUart, UartStatus};
use wsg_bridge_fw::{BusConfig, Format};
use wsg_pico::BUS_DRIVER_ENABLE;

use crate::registers::{peripheral, reset, reset_bit, write};
use crate::tick;
use crate::uart::Port;

static BUS: RtuBuffers = RtuBuffers::new();

/// The driver's pin, in the registers of SIO.
const DRIVER: u32 = 1 << BUS_DRIVER_ENABLE;

/// What the handler of PROFIBUS and the main loop share.
pub(crate) static PROFIBUS: DpBuffers = DpBuffers::new();

/// Whether the bus is PROFIBUS and not Modbus RTU; set once, before its interrupt is unmasked.
static IS_PROFIBUS: AtomicBool = AtomicBool::new(false);

/// The time of two bits, rounded up, in microseconds: how late the driver may be switched off.
static TWO_BITS_US: AtomicU32 = AtomicU32::new(0);

/// The bridge's end of Modbus RTU on the bus; nothing comes and goes before its start.
pub(crate) type Line = RtuPort<Uart1>;

/// The end of the bus. To be asked for once.
pub(crate) const fn line() -> Line {
    RtuPort::new(Uart1(()), &BUS)
}

/// What the main loop needs of the registers.
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

/// Starts Modbus RTU on the bus. The clock runs, the pins are set up.
pub(crate) fn start(config: &BusConfig) {
    BUS.start(config);
    set_up(config.baud, config.format);
    unmask();
}

/// Starts PROFIBUS on the bus instead: the handler begins with the first [`serve`].
pub(crate) fn start_profibus() {
    IS_PROFIBUS.store(true, Ordering::Relaxed);
    unmask();
}

/// Whether nothing is being sent.
pub(crate) fn is_silent() -> bool {
    peripheral!(SIO).gpio_out().read().bits() & DRIVER == 0
}

/// Has the handler take what the main loop's turn has brought, and look whether the last bit has been sent. Once a millisecond is
/// enough: each run ends the main loop's sleep.
pub(crate) fn serve() {
    NVIC::pend(Interrupt::UART1_IRQ);
}

fn unmask() {
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(Interrupt::UART1_IRQ) };
}

/// Sets the bus up for a rate and a format, before its start or anew.
fn set_up(baud: u32, format: Format) {
    // Should it not come out of reset, the bus is silent.
    let _ = reset(reset_bit::UART1);
    TWO_BITS_US.store(2_000_000 / baud.max(1) + 1, Ordering::Relaxed);
    port().set_up(baud, format);
}

#[interrupt]
fn UART1_IRQ() {
    // Made here: as a static that has its value from the start it would take its size of flash.
    static mut RESPONDER: MaybeUninit<DpResponder> = MaybeUninit::uninit();
    static mut IS_MADE: bool = false;
    if !IS_PROFIBUS.load(Ordering::Relaxed) {
        serve_modbus();
        return;
    }
    if !core::mem::replace(IS_MADE, true) {
        RESPONDER.write(DpResponder::new(&PROFIBUS));
    }
    // SAFETY: it was written in this call or in one before.
    serve_master(unsafe { RESPONDER.assume_init_mut() });
}

/// One byte each way per call; the interrupt stays pending while there is more.
fn serve_modbus() {
    go_on(BUS.serve(&mut HalfDuplex(port()), tick::now_us()));
}

/// One character each way, as above.
fn serve_master(responder: &mut DpResponder) {
    let mut port = HalfDuplex(port());
    let received = match port.read() {
        Ok(byte) => Some(Character::Byte(byte)),
        Err(nb::Error::Other(_)) => Some(Character::Damaged),
        Err(nb::Error::WouldBlock) => None,
    };
    let status = UartStatus { received, has_room: port.0.has_room(), is_complete: port.0.is_complete() };
    let action = responder.step(status, tick::now_ms(), tick::now_us());
    if let Some(rate) = action.rate {
        set_up(rate.bit_s(), Format::Even1);
    }
    if let Some(wait_us) = action.wait_us {
        tick::wake_bus_in(wait_us);
    }
    if let Some(byte) = action.send {
        // There is room.
        let _ = port.write(byte);
    }
    go_on(action.interrupts);
}

/// Has the handler run again when that is due, and switches the driver off behind the last bit.
fn go_on(Interrupts { transmit_empty, transmission_complete }: Interrupts) {
    port().wants_room(transmit_empty);
    if transmission_complete {
        tick::wake_bus_in(TWO_BITS_US.load(Ordering::Relaxed));
    } else if !transmit_empty {
        drive(false);
    }
}

/// The UART behind a transceiver, whose driver is on from the first byte on.
struct HalfDuplex(Port);

impl ErrorType for HalfDuplex {
    type Error = ErrorKind;
}

impl Read for HalfDuplex {
    fn read(&mut self) -> nb::Result<u8, ErrorKind> {
        self.0.read()
    }
}

impl Write for HalfDuplex {
    fn write(&mut self, byte: u8) -> nb::Result<(), ErrorKind> {
        drive(true);
        self.0.write(byte)
    }

    fn flush(&mut self) -> nb::Result<(), ErrorKind> {
        self.0.flush()
    }
}

/// Switches the transceiver's driver.
fn drive(is_on: bool) {
    let sio = peripheral!(SIO);
    if is_on {
        write(sio.gpio_out_set(), DRIVER);
    } else {
        write(sio.gpio_out_clr(), DRIVER);
    }
}
