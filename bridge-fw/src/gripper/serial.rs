//! UART between its interrupt handler and the main loop: two queues, and the main loop's line.
//!
//! A board's handler moves bytes between its registers and [`UartBuffers`], with [`UartBuffers::serve`] if a HAL has the
//! UART. Only the handler accesses the registers. [`UartLine`] is the main loop's end.

use embedded_hal_nb::serial::{self, Error as _};
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};

use wsg_protocol::Command;
use wsg_protocol::frame::OVERHEAD;

use super::would_block::WouldBlock;
use crate::atomic::{AtomicU32, Ordering};
use crate::byte_queue::ByteQueue;

/// Rate of a gripper's RS-232 line in bit/s, with 8 data bits, no parity and 1 stop bit.
pub const BAUD: u32 = 115_200;

/// Queue length for received bytes: 10 ms at 10 bits per byte, ten times the bytes between two turns of the main loop.
const RECEIVED_MAX: usize = 128;
const _: () = assert!(RECEIVED_MAX >= (BAUD / 10 / 100) as usize);

/// Queue length for bytes to send: the longest frame of the bridge. It writes one frame at a time, so a FAST STOP waits for
/// at most the rest of one.
pub const TO_SEND_MAX: usize = 32;
const _: () = assert!(TO_SEND_MAX >= Command::MAX_FIXED_LEN + OVERHEAD);

/// Data shared by handler and main loop, in a plain `static`. `RX` and `TX` are the queue lengths in bytes, both powers of
/// two. The defaults suffice for a gripper.
///
/// ```
/// use wsg_bridge_fw::gripper::{ReceiveErrors, UartBuffers};
///
/// static BUFFERS: UartBuffers = UartBuffers::new();
///
/// // In the handler: the errors of the status register, and the received byte, if any.
/// BUFFERS.on_receive(Some(0xAA), ReceiveErrors { framing: false, overrun: false });
/// assert!(BUFFERS.has_received());
/// assert_eq!(BUFFERS.next_to_send(), None);
/// ```
#[derive(Debug)]
pub struct UartBuffers<const RX: usize = RECEIVED_MAX, const TX: usize = TO_SEND_MAX> {
    received: ByteQueue<RX>,
    to_send: ByteQueue<TX>,
    overrun: AtomicU32,
    framing: AtomicU32,
    queue_full: AtomicU32,
}

/// Receive errors of a UART for its last byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceiveErrors {
    /// No stop bit: a break, a wrong baud rate, or noise.
    pub framing: bool,
    /// An earlier byte was lost, because the handler was late.
    pub overrun: bool,
}

/// Lost bytes by cause. Each count saturates. The frames' checksums detect the loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LostBytes {
    /// Bytes lost because the handler was late.
    pub overrun: u32,
    /// Bytes without a stop bit.
    pub framing: u32,
    /// Bytes lost because the main loop was late.
    pub queue_full: u32,
}

impl<const RX: usize, const TX: usize> UartBuffers<RX, TX> {
    /// Creates the line with empty queues in both directions.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            received: ByteQueue::new(),
            to_send: ByteQueue::new(),
            overrun: AtomicU32::new(0),
            framing: AtomicU32::new(0),
            queue_full: AtomicU32::new(0),
        }
    }

    /// Processes a received byte, in the handler. The byte of a framing error is discarded.
    pub fn on_receive(&self, byte: Option<u8>, errors: ReceiveErrors) {
        if let Some(byte) = byte.filter(|_| !errors.framing)
            && self.received.push(byte).is_err()
        {
            count(&self.queue_full);
        }
        if errors.framing {
            count(&self.framing);
        }
        if errors.overrun {
            count(&self.overrun);
        }
    }

    /// Returns the next byte for an empty transmit register, in the handler.
    pub fn next_to_send(&self) -> Option<u8> {
        self.to_send.pop()
    }

    /// Handles one interrupt for a HAL's UART, with at most one byte each way. Returns whether the transmit interrupt is
    /// needed.
    ///
    /// ```
    /// use embedded_hal_nb::serial::{Read, Write};
    /// use wsg_bridge_fw::gripper::UartBuffers;
    ///
    /// static BUFFERS: UartBuffers = UartBuffers::new();
    ///
    /// fn on_interrupt(uart: &mut (impl Read + Write)) {
    ///     let _needs_transmit_interrupt = BUFFERS.serve(uart);
    /// }
    /// ```
    pub fn serve<U: serial::Read + serial::Write>(&self, uart: &mut U) -> bool {
        let errors = ReceiveErrors { framing: false, overrun: false };
        match uart.read() {
            Ok(byte) => self.on_receive(Some(byte), errors),
            Err(nb::Error::Other(error)) => {
                let overrun = error.kind() == serial::ErrorKind::Overrun;
                self.on_receive(None, ReceiveErrors { framing: !overrun, overrun });
            }
            Err(nb::Error::WouldBlock) => {}
        }
        if let Some(byte) = self.to_send.peek()
            && uart.write(byte).is_ok()
        {
            self.to_send.pop();
        }
        self.has_to_send()
    }

    /// Returns whether the transmit interrupt is needed, in the handler.
    #[must_use]
    pub fn has_to_send(&self) -> bool {
        !self.to_send.is_empty()
    }

    /// Returns whether the queue has room for a received byte. A line with flow control keeps the byte until then.
    #[must_use]
    pub fn takes_more(&self) -> bool {
        !self.received.is_full()
    }

    /// Returns whether a received byte is queued.
    #[must_use]
    pub fn has_received(&self) -> bool {
        !self.received.is_empty()
    }

    /// Returns the lost bytes since power-up.
    #[must_use]
    pub fn lost(&self) -> LostBytes {
        LostBytes {
            overrun: self.overrun.load(Ordering::Relaxed),
            framing: self.framing.load(Ordering::Relaxed),
            queue_full: self.queue_full.load(Ordering::Relaxed),
        }
    }
}

impl<const RX: usize, const TX: usize> Default for UartBuffers<RX, TX> {
    fn default() -> Self {
        Self::new()
    }
}

/// Increments a counter. Only the handler writes it, so a load and a store suffice.
fn count(counter: &AtomicU32) {
    counter.store(counter.load(Ordering::Relaxed).saturating_add(1), Ordering::Relaxed);
}

/// The main loop's access to a UART's registers.
pub trait Uart {
    /// Schedules a run of the handler, because there is more to send, or room for more received bytes.
    fn pend(&mut self);

    /// Returns whether the last bit of all written bytes has been sent.
    fn is_idle(&mut self) -> bool;
}

/// The main loop's end of the line. Create only one for each [`UartBuffers`].
///
/// No method waits. [`Read::read`], [`Write::write`] and [`Write::flush`] return immediately, and fail with [`WouldBlock`] if
/// they would have to wait. After `true` from [`ReadReady::read_ready`] or [`WriteReady::write_ready`], a read or write
/// succeeds.
#[derive(Debug)]
pub struct UartLine<U, const RX: usize = RECEIVED_MAX, const TX: usize = TO_SEND_MAX> {
    uart: U,
    buffers: &'static UartBuffers<RX, TX>,
}

impl<U: Uart, const RX: usize, const TX: usize> UartLine<U, RX, TX> {
    /// Creates the main loop's end of this line.
    pub const fn new(uart: U, buffers: &'static UartBuffers<RX, TX>) -> Self {
        Self { uart, buffers }
    }
}

impl<U, const RX: usize, const TX: usize> UartLine<U, RX, TX> {
    /// Returns the lost bytes since power-up.
    #[must_use]
    pub fn lost(&self) -> LostBytes {
        self.buffers.lost()
    }
}

impl<U: Uart, const RX: usize, const TX: usize> ErrorType for UartLine<U, RX, TX> {
    type Error = WouldBlock;
}

impl<U: Uart, const RX: usize, const TX: usize> ReadReady for UartLine<U, RX, TX> {
    fn read_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(self.buffers.has_received())
    }
}

impl<U: Uart, const RX: usize, const TX: usize> Read for UartLine<U, RX, TX> {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, WouldBlock> {
        let received = &self.buffers.received;
        let was_full = received.is_full();
        let count = buf.iter_mut().map_while(|place| received.pop().map(|byte| *place = byte)).count();
        if was_full && count > 0 {
            self.uart.pend();
        }
        moved(count, buf)
    }
}

impl<U: Uart, const RX: usize, const TX: usize> WriteReady for UartLine<U, RX, TX> {
    fn write_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(!self.buffers.to_send.is_full())
    }
}

impl<U: Uart, const RX: usize, const TX: usize> Write for UartLine<U, RX, TX> {
    fn write(&mut self, buf: &[u8]) -> Result<usize, WouldBlock> {
        let taken = buf.iter().map_while(|&byte| self.buffers.to_send.push(byte).ok()).count();
        self.uart.pend();
        moved(taken, buf)
    }

    fn flush(&mut self) -> Result<(), WouldBlock> {
        if !self.buffers.has_to_send() && self.uart.is_idle() { Ok(()) } else { Err(WouldBlock) }
    }
}

/// Returns the result of moving `count` bytes between a queue and a caller's buffer.
const fn moved(count: usize, buf: &[u8]) -> Result<usize, WouldBlock> {
    if count == 0 && !buf.is_empty() { Err(WouldBlock) } else { Ok(count) }
}

#[cfg(all(loom, test))]
mod model;
