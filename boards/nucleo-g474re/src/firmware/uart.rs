//! The gripper's line: USART1, 115200 baud, 8N1, interrupt driven both ways (RM0440, USART).

use cortex_m::peripheral::NVIC;
use stm32_metapac::{Interrupt, RCC, USART1, interrupt};
use wsg_bridge_fw::gripper::{BAUD, ReceiveErrors, Uart, UartBuffers, UartLine};

use crate::clock::HCLK_HZ;

const DIVIDER: u32 = HCLK_HZ / BAUD;
const _: () = assert!(DIVIDER * BAUD == HCLK_HZ);

/// The bytes on their way.
pub(crate) static BUFFERS: UartBuffers = UartBuffers::new();

/// The bridge's end of the line to the gripper; nothing comes and goes before [`start`].
pub(crate) type GripperLine = UartLine<Registers>;

/// The end of the line. To be asked for once.
pub(crate) const fn line() -> GripperLine {
    UartLine::new(Registers(()), &BUFFERS)
}

/// What the main loop needs of the registers.
pub(crate) struct Registers(());

impl Uart for Registers {
    #[inline]
    fn pend(&mut self) {
        NVIC::pend(Interrupt::USART1);
    }

    #[inline]
    fn is_idle(&mut self) -> bool {
        USART1.isr().read().tc()
    }
}

/// Starts the line. The clock runs at [`HCLK_HZ`], the pins are set up.
pub(crate) fn start() {
    RCC.apb2enr().modify(|w| w.set_usart1en(true));
    let _ = RCC.apb2enr().read();

    // 8N1, no flow control and the bus clock are what reset leaves.
    USART1.brr().write(|w| w.0 = DIVIDER);
    USART1.cr1().write(|w| {
        w.set_ue(true);
        w.set_re(true);
        w.set_te(true);
        w.set_rxneie(true);
    });
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(Interrupt::USART1) };
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn USART1() {
    let status = USART1.isr().read();
    // Reading the byte of a framing error makes room for the next.
    let byte = status.rxne().then(|| USART1.rdr().read().0 as u8);
    BUFFERS.on_receive(byte, ReceiveErrors { framing: status.fe(), overrun: status.ore() });
    USART1.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_ore(status.ore());
    });
    if status.txe()
        && let Some(byte) = BUFFERS.next_to_send()
    {
        USART1.tdr().write(|w| w.0 = byte.into());
    }
    let has_to_send = BUFFERS.has_to_send();
    if USART1.cr1().read().txeie() != has_to_send {
        USART1.cr1().modify(|w| w.set_txeie(has_to_send));
    }
}
