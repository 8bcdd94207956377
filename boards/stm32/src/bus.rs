//! Two UARTs, interrupt driven both ways: the PLC's bus, with Modbus RTU or PROFIBUS, and the service port, with Modbus RTU.
//!
//! The bus's UART switches the transceiver's driver by itself (DE mode). PROFIBUS is answered in the handler, which has less than
//! 87 µs for it: then the next byte of the gripper's line is complete, and all interrupts have the same priority.

mod dp_timer;

use core::marker::PhantomData;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use bus_profibus::Character;
use cortex_m::peripheral::NVIC;
use stm32_metapac::Interrupt;
use stm32_metapac::usart::Lpuart;
use wsg_bridge_fw::plc::{DpBuffers, DpResponder, RtuBuffers, RtuPort, RtuUart, UartStatus};
use wsg_bridge_fw::{BusConfig, Format};

use crate::Divider;
use crate::board::Stm32Board;
use crate::uart::{self, Uart};

pub use dp_timer::on_interrupt as on_timer_interrupt;

/// One type for both lines, so that there is one copy of their code.
type Buffers = RtuBuffers;

static BUS: Buffers = RtuBuffers::new();
static SERVICE: Buffers = RtuBuffers::new();

/// What the handler of PROFIBUS and the main loop share.
pub static PROFIBUS: DpBuffers = DpBuffers::new();

/// Whether the bus is PROFIBUS and not Modbus RTU; set once, before its interrupt is unmasked.
static IS_PROFIBUS: AtomicBool = AtomicBool::new(false);

/// The bridge's end of Modbus RTU on a line; no character is sent or received before its start.
pub(crate) type Line<B> = RtuPort<Registers<B>>;

/// Returns the end of the bus. To be called once.
pub(crate) const fn line<B: Stm32Board>() -> Line<B> {
    RtuPort::new(Registers(B::BusUart::INTERRUPT, PhantomData), &BUS)
}

/// Returns the end of the service port. To be called once.
pub(crate) const fn service_line<B: Stm32Board>() -> Line<B> {
    RtuPort::new(Registers(B::ServiceUart::INTERRUPT, PhantomData), &SERVICE)
}

/// What the main loop needs of the registers.
pub(crate) struct Registers<B>(Interrupt, PhantomData<B>);

impl<B: Stm32Board> RtuUart for Registers<B> {
    fn pend(&mut self) {
        NVIC::pend(self.0);
    }

    fn now_us(&mut self) -> u32 {
        B::now_us()
    }
}

/// Starts Modbus RTU on the bus. The board's clock runs, and the pins are set up. At a rate that the board does not support (settings
/// hold none) it stays silent.
pub(crate) fn start<B: Stm32Board>(config: &BusConfig) {
    BUS.start(config);
    if set_up_bus::<B>(config.baud, config.format) {
        uart::unmask(B::BusUart::INTERRUPT);
    }
}

/// Starts PROFIBUS on the bus instead: the handler begins with the first [`pend`].
pub(crate) fn start_profibus<B: Stm32Board>() {
    IS_PROFIBUS.store(true, Ordering::Relaxed);
    dp_timer::start::<B>();
    uart::unmask(B::BusUart::INTERRUPT);
}

/// Has the handler of the bus run.
pub(crate) fn pend<B: Stm32Board>() {
    NVIC::pend(B::BusUart::INTERRUPT);
}

/// Starts the service port. The board's clock runs, and the pins are set up.
pub(crate) fn start_service<B: Stm32Board>() {
    B::ServiceUart::enable();
    SERVICE.start(&BusConfig::SERVICE);
    let divider = const { Divider::fixed(B::HCLK_HZ, BusConfig::SERVICE.baud) };
    uart::set_up(B::ServiceUart::REGISTERS, BusConfig::SERVICE.format, divider, 0);
    uart::unmask(B::ServiceUart::INTERRUPT);
}

/// Sets the bus up for a rate and a format, before its start or anew; returns whether the board supports that.
// Once in the image.
#[inline(never)]
fn set_up_bus<B: Stm32Board>(baud: u32, format: Format) -> bool {
    let uart = B::BusUart::REGISTERS;
    B::BusUart::enable();
    // Rate and format change while it is off.
    uart.cr1().write(|_| {});
    let Some(divider) = B::select_bus_clock(baud) else { return false };
    uart.cr3().write(|w| w.set_dem(true));
    uart::set_up(uart, format, divider, B::DRIVER_TIME);
    true
}

/// The PROFIBUS slave of the bus's handler. A plain `static` of zeros, which takes no flash: the handler makes the slave.
pub struct Responder {
    slave: MaybeUninit<DpResponder>,
    is_made: bool,
}

impl Responder {
    /// Returns an empty place.
    #[expect(clippy::new_without_default, reason = "there is one")]
    #[must_use]
    pub const fn new() -> Self {
        Self { slave: MaybeUninit::uninit(), is_made: false }
    }

    fn get(&mut self) -> &mut DpResponder {
        if !core::mem::replace(&mut self.is_made, true) {
            self.slave.write(DpResponder::new(&PROFIBUS));
        }
        // SAFETY: it was written in this call or in an earlier one.
        unsafe { self.slave.assume_init_mut() }
    }
}

/// Serves the bus. For the handler of its UART.
#[inline]
pub fn on_bus_interrupt<B: Stm32Board>(responder: &mut Responder) {
    if IS_PROFIBUS.load(Ordering::Relaxed) {
        serve_master::<B>(responder.get());
    } else {
        serve_modbus::<B>(B::BusUart::REGISTERS, &BUS);
    }
}

/// Serves the service port. For the handler of its UART.
#[inline]
pub fn on_service_interrupt<B: Stm32Board>() {
    serve_modbus::<B>(B::ServiceUart::REGISTERS, &SERVICE);
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[inline(never)]
fn serve_modbus<B: Stm32Board>(uart: Lpuart, buffers: &Buffers) {
    let status = uart.isr().read();
    if status.rxne() {
        let byte = (uart.rdr().read().0 & 0xFF) as u8;
        buffers.on_receive(byte, uart::is_damaged(status), status.tc(), B::now_us());
    } else if status.ore() {
        // A byte was received between the reading of the status and that of the byte before.
        buffers.on_overrun();
    }
    uart::clear_errors(uart, status);
    if let Some(byte) = buffers.on_transmit(status.txe(), status.tc()) {
        uart.tdr().write(|w| w.0 = byte.into());
    }
    uart::enable(uart, buffers.interrupts());
}

/// One character each way, as above.
fn serve_master<B: Stm32Board>(responder: &mut DpResponder) {
    let uart = B::BusUart::REGISTERS;
    let status = uart.isr().read();
    let received = if status.rxne() {
        let byte = (uart.rdr().read().0 & 0xFF) as u8;
        Some(if uart::is_damaged(status) { Character::Damaged } else { Character::Byte(byte) })
    } else {
        // As above.
        status.ore().then_some(Character::Damaged)
    };
    uart::clear_errors(uart, status);
    let status = UartStatus { received, has_room: status.txe(), is_complete: status.tc() };
    let action = responder.step(status, B::now_ms(), B::now_us());
    if let Some(rate) = action.rate {
        set_up_bus::<B>(rate.bit_s(), Format::Even1);
    }
    if let Some(byte) = action.send {
        uart.tdr().write(|w| w.0 = byte.into());
    }
    if let Some(wait_us) = action.wait_us {
        dp_timer::wake_in(wait_us);
    }
    uart::enable(uart, action.interrupts);
}
