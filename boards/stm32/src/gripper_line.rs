//! The gripper's line: an interrupt-driven UART at 115 200 bit/s, 8N1.

use core::marker::PhantomData;

use cortex_m::peripheral::NVIC;
use wsg_bridge_fw::Format;
use wsg_bridge_fw::gripper::{BAUD, ReceiveErrors, UartBuffers, UartLine};

use crate::Divider;
use crate::board::Stm32Board;
use crate::uart::{self, Uart};

/// The receive and transmit queues.
pub static BUFFERS: UartBuffers = UartBuffers::new();

/// The bridge's end of the line to the gripper. No byte is sent or received before [`start`].
pub type GripperLine<B> = UartLine<Registers<B>>;

/// Returns the gripper's line. Call it once.
#[must_use]
pub const fn line<B: Stm32Board>() -> GripperLine<B> {
    UartLine::new(Registers(PhantomData), &BUFFERS)
}

/// The main loop's access to the registers.
pub struct Registers<B>(PhantomData<B>);

impl<B: Stm32Board> wsg_bridge_fw::gripper::Uart for Registers<B> {
    #[inline]
    fn pend(&mut self) {
        NVIC::pend(B::GripperUart::INTERRUPT);
    }

    #[inline]
    fn is_idle(&mut self) -> bool {
        B::GripperUart::REGISTERS.isr().read().tc()
    }
}

/// Starts the line. The clock must run and the pins must be set up.
pub fn start<B: Stm32Board>() {
    B::GripperUart::enable();
    let divider = const { Divider::fixed(B::HCLK_HZ, BAUD) };
    uart::set_up(B::GripperUart::REGISTERS, Format::None1, divider, 0);
    uart::unmask(B::GripperUart::INTERRUPT);
}

/// Transfers one byte in each direction; the interrupt stays pending if there is more. Call it from the UART's handler.
#[inline]
pub fn on_interrupt<B: Stm32Board>() {
    let uart = B::GripperUart::REGISTERS;
    let status = uart.isr().read();
    // A byte with a framing error must be read to make room for the next.
    let byte = status.rxne().then(|| uart.rdr().read().0 as u8);
    BUFFERS.on_receive(byte, ReceiveErrors { framing: status.fe(), overrun: status.ore() });
    uart.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_ore(status.ore());
    });
    if status.txe()
        && let Some(byte) = BUFFERS.next_to_send()
    {
        uart.tdr().write(|w| w.0 = byte.into());
    }
    let has_to_send = BUFFERS.has_to_send();
    if uart.cr1().read().txeie() != has_to_send {
        uart.cr1().modify(|w| w.set_txeie(has_to_send));
    }
}
