//! The gripper's line: UART4, 115200 baud, 8N1, interrupt driven both ways (RM0351, chapter 40).

use cortex_m::peripheral::NVIC;
use stm32_metapac::{Interrupt, RCC, UART4, interrupt};
use wsg_bridge_fw::gripper::{BAUD, ReceiveErrors, Uart, UartBuffers, UartLine};

use super::clock::HCLK_HZ;

const DIVIDER: u32 = (HCLK_HZ + BAUD / 2) / BAUD;
/// The divider's own error is below 0.1 %: what tolerance the line has is left to the clock.
const _: () = assert!((HCLK_HZ / DIVIDER).abs_diff(BAUD) < BAUD / 1_000);

/// The bytes on their way.
pub static BUFFERS: UartBuffers = UartBuffers::new();

/// The bridge's end of the line to the gripper; nothing comes and goes before [`start`].
pub type GripperLine = UartLine<Registers>;

/// The end of the line. To be asked for once.
pub const fn line() -> GripperLine {
    UartLine::new(Registers(()), &BUFFERS)
}

/// What the main loop needs of the registers.
pub struct Registers(());

impl Uart for Registers {
    #[inline]
    fn pend(&mut self) {
        NVIC::pend(Interrupt::UART4);
    }

    #[inline]
    fn is_idle(&mut self) -> bool {
        UART4.isr().read().tc()
    }
}

/// Starts the line. The clock runs at [`HCLK_HZ`], the pins are set up.
pub fn start() {
    RCC.apb1enr1().modify(|w| w.set_uart4en(true));
    let _ = RCC.apb1enr1().read();

    // 8N1, no flow control and the bus clock are what reset leaves.
    UART4.brr().write(|w| w.0 = DIVIDER);
    UART4.cr1().write(|w| {
        w.set_ue(true);
        w.set_re(true);
        w.set_te(true);
        w.set_rxneie(true);
    });
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(Interrupt::UART4) };
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn UART4() {
    let status = UART4.isr().read();
    // Reading the byte of a framing error makes room for the next.
    let byte = status.rxne().then(|| UART4.rdr().read().0 as u8);
    BUFFERS.on_receive(byte, ReceiveErrors { framing: status.fe(), overrun: status.ore() });
    UART4.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_ore(status.ore());
    });
    if status.txe()
        && let Some(byte) = BUFFERS.next_to_send()
    {
        UART4.tdr().write(|w| w.0 = byte.into());
    }
    let has_to_send = BUFFERS.has_to_send();
    if UART4.cr1().read().txeie() != has_to_send {
        UART4.cr1().modify(|w| w.set_txeie(has_to_send));
    }
}
