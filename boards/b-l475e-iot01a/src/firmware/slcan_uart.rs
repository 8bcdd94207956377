//! CAN frames over UART5, by SLCAN, for an emulator: 115200 baud, 8N1, interrupt driven both ways (RM0351, chapter 40).
//!
//! On the board the UART's pins are not set up: nothing is connected there.

use cortex_m::peripheral::NVIC;
use stm32_metapac::{Interrupt, RCC, UART5, interrupt};
use wsg_bridge_fw::can::{CanConfig, SlcanPort};
use wsg_bridge_fw::gripper::{ReceiveErrors, Uart, UartBuffers, UartLine};

use crate::clock::HCLK_HZ;

const BAUD: u32 = 115_200;
const DIVIDER: u32 = (HCLK_HZ + BAUD / 2) / BAUD;

/// An emulator's line brings bytes as fast as they are taken. While the queue is full none are: there they wait.
const RECEIVED_MAX: usize = 512;
const TO_SEND_MAX: usize = 64;

static BUFFERS: UartBuffers<RECEIVED_MAX, TO_SEND_MAX> = UartBuffers::new();

/// The controller that is none.
pub(crate) type Controller = SlcanPort<UartLine<Registers, RECEIVED_MAX, TO_SEND_MAX>>;

/// What the main loop needs of the registers.
pub(crate) struct Registers(());

impl Uart for Registers {
    fn pend(&mut self) {
        NVIC::pend(Interrupt::UART5);
    }

    fn is_idle(&mut self) -> bool {
        UART5.isr().read().tc()
    }
}

pub(crate) const fn new() -> Controller {
    SlcanPort::new(UartLine::new(Registers(()), &BUFFERS))
}

/// Starts the line. The rate of a bus means nothing to it.
pub(crate) fn start(_: &mut Controller, _: &CanConfig) {
    RCC.apb1enr1().modify(|w| w.set_uart5en(true));
    let _ = RCC.apb1enr1().read();
    UART5.brr().write(|w| w.0 = DIVIDER);
    UART5.cr1().write(|w| {
        w.set_ue(true);
        w.set_re(true);
        w.set_te(true);
        w.set_rxneie(true);
    });
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(Interrupt::UART5) };
}

/// Nothing: the handler looks after itself.
pub(crate) fn rearm(_: &mut Controller) {}

pub(crate) fn has_received() -> bool {
    BUFFERS.has_received()
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn UART5() {
    let status = UART5.isr().read();
    let byte = (status.rxne() && BUFFERS.takes_more()).then(|| UART5.rdr().read().0 as u8);
    BUFFERS.on_receive(byte, ReceiveErrors { framing: false, overrun: false });
    if status.txe()
        && let Some(byte) = BUFFERS.next_to_send()
    {
        UART5.tdr().write(|w| w.0 = byte.into());
    }
    let (has_to_send, takes_more) = (BUFFERS.has_to_send(), BUFFERS.takes_more());
    let control = UART5.cr1().read();
    if control.txeie() != has_to_send || control.rxneie() != takes_more {
        UART5.cr1().modify(|w| {
            w.set_txeie(has_to_send);
            w.set_rxneie(takes_more);
        });
    }
}
