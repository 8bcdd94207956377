//! CAN frames over UART5, by SLCAN, for an emulator: 115200 baud, 8N1, interrupt driven both ways (RM0351, chapter 40).
//!
//! On the board the UART's pins are not set up: nothing is connected there.

use cortex_m::peripheral::NVIC;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use stm32_metapac::{Interrupt, RCC, UART5, interrupt};
use wsg_bridge_fw::byte_queue::ByteQueue;
use wsg_bridge_fw::can::{CanConfig, SlcanPort};

use crate::clock::HCLK_HZ;
use crate::would_block::{WouldBlock, moved};

const BAUD: u32 = 115_200;
const DIVIDER: u32 = (HCLK_HZ + BAUD / 2) / BAUD;

/// An emulator's line brings bytes as fast as they are taken. While the queue is full none are: there they wait.
const RECEIVED_MAX: usize = 512;
const TO_SEND_MAX: usize = 64;

static RECEIVED: ByteQueue<RECEIVED_MAX> = ByteQueue::new();
static TO_SEND: ByteQueue<TO_SEND_MAX> = ByteQueue::new();

/// The controller that is none.
pub(crate) type Controller = SlcanPort<Line>;

/// The bridge's end of the line. There is one value of it, in the controller.
pub(crate) struct Line(());

pub(crate) const fn new() -> Controller {
    SlcanPort::new(Line(()))
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
    !RECEIVED.is_empty()
}

impl ErrorType for Line {
    type Error = WouldBlock;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(has_received())
    }
}

impl Read for Line {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, WouldBlock> {
        let was_full = RECEIVED.is_full();
        let count = buf.iter_mut().map_while(|place| RECEIVED.pop().map(|byte| *place = byte)).count();
        if was_full && count > 0 {
            NVIC::pend(Interrupt::UART5);
        }
        moved(count, buf)
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(!TO_SEND.is_full())
    }
}

impl Write for Line {
    fn write(&mut self, buf: &[u8]) -> Result<usize, WouldBlock> {
        let taken = buf.iter().map_while(|&byte| TO_SEND.push(byte).ok()).count();
        // The handler alone switches interrupts, so main loop and handler never change the same register.
        NVIC::pend(Interrupt::UART5);
        moved(taken, buf)
    }

    fn flush(&mut self) -> Result<(), WouldBlock> {
        if TO_SEND.is_empty() { Ok(()) } else { Err(WouldBlock) }
    }
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn UART5() {
    let status = UART5.isr().read();
    if status.rxne() && !RECEIVED.is_full() {
        let _ = RECEIVED.push(UART5.rdr().read().0 as u8);
    }
    if status.txe()
        && let Some(byte) = TO_SEND.pop()
    {
        UART5.tdr().write(|w| w.0 = byte.into());
    }
    let more_to_send = !TO_SEND.is_empty();
    let takes_more = !RECEIVED.is_full();
    let control = UART5.cr1().read();
    if control.txeie() != more_to_send || control.rxneie() != takes_more {
        UART5.cr1().modify(|w| {
            w.set_txeie(more_to_send);
            w.set_rxneie(takes_more);
        });
    }
}
