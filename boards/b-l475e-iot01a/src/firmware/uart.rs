//! The gripper's line: UART4, 115200 baud, 8N1, interrupt driven both ways (RM0351, chapter 40).

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use stm32_metapac::{Interrupt, RCC, UART4, interrupt};
use wsg_bridge_fw::byte_queue::ByteQueue;
use wsg_protocol::Command;
use wsg_protocol::frame::OVERHEAD;

use crate::clock::HCLK_HZ;
use crate::would_block::{WouldBlock, moved};

const BAUD: u32 = 115_200;
const DIVIDER: u32 = (HCLK_HZ + BAUD / 2) / BAUD;
/// The divider's own error is below 0.1 %: what tolerance the line has is left to the clock.
const _: () = assert!((HCLK_HZ / DIVIDER).abs_diff(BAUD) < BAUD / 1_000);

/// What arrives in 10 ms, at 10 bits a byte: ten times what arrives between two turns of the main loop.
const BYTES_PER_10_MS: usize = (BAUD / 10 / 100) as usize;
const RECEIVED_MAX: usize = 128;
const _: () = assert!(RECEIVED_MAX >= BYTES_PER_10_MS);

/// The longest frame the bridge sends. It gives one frame at a time, so that a FAST STOP never waits for more than the
/// rest of one.
const LONGEST_FRAME: usize = Command::MAX_FIXED_LEN + OVERHEAD;
const TO_SEND_MAX: usize = 32;
const _: () = assert!(TO_SEND_MAX >= LONGEST_FRAME);

static RECEIVED: ByteQueue<RECEIVED_MAX> = ByteQueue::new();
static TO_SEND: ByteQueue<TO_SEND_MAX> = ByteQueue::new();

/// Bytes that did not reach the reader, by cause; each count stays at its maximum.
pub(crate) static LOST: Lost =
    Lost { overrun: AtomicU32::new(0), framing: AtomicU32::new(0), queue_full: AtomicU32::new(0) };

pub(crate) struct Lost {
    /// The interrupt came too late for a byte.
    pub(crate) overrun: AtomicU32,
    /// No stop bit: a break, a wrong baud rate, or noise.
    pub(crate) framing: AtomicU32,
    /// The main loop came too late for a byte.
    pub(crate) queue_full: AtomicU32,
}

/// The bridge's end of the line to the gripper. There is one value of it; nothing comes and goes before [`start`].
///
/// Nothing here waits. [`Read::read`], [`Write::write`] and [`Write::flush`] do what can be done at
/// once, and are [`WouldBlock`] where they would have to wait; after [`ReadReady::read_ready`] or
/// [`WriteReady::write_ready`] said yes, reading or writing succeeds. What the line loses is counted
/// in [`LOST`] and left to the frames' checksums; reception goes on.
pub(crate) struct GripperLine(());

impl GripperLine {
    pub(crate) const fn new() -> Self {
        Self(())
    }
}

/// Starts the line. The clock runs at [`HCLK_HZ`], the pins are set up.
pub(crate) fn start() {
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

/// Whether a byte waits to be read.
pub(crate) fn has_received() -> bool {
    !RECEIVED.is_empty()
}

impl ErrorType for GripperLine {
    type Error = WouldBlock;
}

impl ReadReady for GripperLine {
    fn read_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(has_received())
    }
}

impl Read for GripperLine {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, WouldBlock> {
        moved(buf.iter_mut().map_while(|place| RECEIVED.pop().map(|byte| *place = byte)).count(), buf)
    }
}

impl WriteReady for GripperLine {
    fn write_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(!TO_SEND.is_full())
    }
}

impl Write for GripperLine {
    fn write(&mut self, buf: &[u8]) -> Result<usize, WouldBlock> {
        let taken = buf.iter().map_while(|&byte| TO_SEND.push(byte).ok()).count();
        // The handler alone switches the transmit interrupt, so main loop and handler never change
        // the same register.
        NVIC::pend(Interrupt::UART4);
        moved(taken, buf)
    }

    fn flush(&mut self) -> Result<(), WouldBlock> {
        if TO_SEND.is_empty() && UART4.isr().read().tc() { Ok(()) } else { Err(WouldBlock) }
    }
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn UART4() {
    let status = UART4.isr().read();
    if status.rxne() {
        // The byte of a framing error is none; reading it makes room for the next.
        let byte = UART4.rdr().read().0 as u8;
        if !status.fe() && RECEIVED.push(byte).is_err() {
            count(&LOST.queue_full);
        }
    }
    if status.fe() {
        count(&LOST.framing);
    }
    if status.ore() {
        count(&LOST.overrun);
    }
    UART4.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_ore(status.ore());
    });

    if status.txe()
        && let Some(byte) = TO_SEND.pop()
    {
        UART4.tdr().write(|w| w.0 = byte.into());
    }
    let more_to_send = !TO_SEND.is_empty();
    let control = UART4.cr1().read();
    if control.txeie() != more_to_send {
        UART4.cr1().modify(|w| w.set_txeie(more_to_send));
    }
}

/// Counts one more, in the handler alone, so a load and a store do.
fn count(counter: &AtomicU32) {
    counter.store(counter.load(Ordering::Relaxed).saturating_add(1), Ordering::Relaxed);
}
