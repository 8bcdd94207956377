//! Frames received by an MCP2515, between its interrupt handler and the main loop.

use embedded_hal::spi::{Operation, SpiDevice};

use crate::atomic::{AtomicBool, Ordering};
use crate::byte_queue::ByteQueue;
use crate::can::bus::MAX_RECEIVED_PER_POLL;

/// Instructions (12.0).
const READ_STATUS: u8 = 0xA0;
const READ_RX: [u8; 2] = [0x90, 0x94];
/// READ STATUS: frame in the first buffer; in the second.
const RX0IF: u8 = 1 << 0;
const RX1IF: u8 = 1 << 1;

/// Frame in the layout of a receive buffer's registers: identifier, length, data.
pub(super) type RawFrame = [u8; FRAME_LEN];
const FRAME_LEN: usize = 13;

/// Queue length in bytes for 39 frames, 1.5 ms of traffic. A turn of the main loop takes 1 ms. In a model for one frame.
const QUEUE_LEN: usize = if cfg!(all(loom, test)) { 16 } else { 512 };
const _: () = assert!(QUEUE_LEN / FRAME_LEN >= MAX_RECEIVED_PER_POLL * 3 / 2 || cfg!(all(loom, test)));

/// Frames that the interrupt handler has read from an MCP2515, in a plain `static`. Handler and main loop must run on one
/// core.
///
/// The MCP2515 holds two frames. At 1 Mbit/s, a third may end 94 µs after the first, too soon for a main loop. Handler and
/// main loop each have a [`SpiDevice`] for its SPI. The main loop's device blocks the handler during each transaction.
///
/// ```
/// use embedded_hal::spi::SpiDevice;
/// use wsg_bridge_fw::can::Mcp2515Buffers;
///
/// static BUFFERS: Mcp2515Buffers = Mcp2515Buffers::new();
///
/// fn on_interrupt(spi: &mut impl SpiDevice, mask: impl FnOnce()) {
///     if !BUFFERS.serve(spi) {
///         mask();
///     }
/// }
/// ```
#[derive(Debug)]
pub struct Mcp2515Buffers {
    frames: ByteQueue<QUEUE_LEN>,
    /// The controller is set up. Written only by the main loop.
    is_open: AtomicBool,
    /// The frame in the second receive buffer is older than the one in the first. Written only by the handler while it is
    /// open.
    second_is_older: AtomicBool,
}

impl Mcp2515Buffers {
    /// Creates an empty queue for a controller that is not set up.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            frames: ByteQueue::new(),
            is_open: AtomicBool::new(false),
            second_is_older: AtomicBool::new(false),
        }
    }

    /// Reads all frames from the controller, in the handler. Returns whether its interrupt may stay unmasked. Without room
    /// for a frame, which then stays in the controller, and before the set-up, the handler masks the interrupt. The main loop
    /// unmasks it after its turn.
    #[must_use]
    pub fn serve<S: SpiDevice>(&self, spi: &mut S) -> bool {
        // Acquire: the handler sees the state that the main loop has reset.
        self.is_open.load(Ordering::Acquire) && self.take(spi).unwrap_or(false)
    }

    fn take<S: SpiDevice>(&self, spi: &mut S) -> Result<bool, S::Error> {
        let mut status = read_status(spi)?;
        // Bounded by the queue's room, because the main loop frees none in the meantime.
        loop {
            let buffer = match (status & RX0IF != 0, status & RX1IF != 0) {
                (false, false) => return Ok(true),
                (true, true) => usize::from(self.second_is_older.load(Ordering::Relaxed)),
                (_, second) => usize::from(second),
            };
            let (Some(read), true) = (READ_RX.get(buffer), self.frames.room() >= FRAME_LEN) else {
                return Ok(false);
            };
            let mut raw: RawFrame = [0; FRAME_LEN];
            spi.transaction(&mut [Operation::Write(&[*read]), Operation::Read(&mut raw)])?;
            status = read_status(spi)?;
            // A frame that the second buffer received while the first was full is older than the first buffer's next frame.
            self.second_is_older.store(buffer == 0 && status & RX1IF != 0, Ordering::Relaxed);
            // Cannot fail: the room was checked.
            let _ = self.frames.push_all(&raw);
        }
    }

    /// Returns whether a frame is queued for the main loop.
    #[must_use]
    pub fn has_received(&self) -> bool {
        !self.frames.is_empty()
    }

    /// Removes the oldest frame.
    pub(super) fn pop(&self) -> Option<RawFrame> {
        self.frames.pop_all()
    }

    /// Discards all queued frames.
    pub(super) fn clear(&self) {
        self.frames.clear();
    }

    /// Stops the handler from accessing the controller.
    pub(super) fn close(&self) {
        self.is_open.store(false, Ordering::Relaxed);
    }

    /// Lets the handler access a controller that was just set up.
    pub(super) fn open(&self) {
        self.clear();
        self.second_is_older.store(false, Ordering::Relaxed);
        self.is_open.store(true, Ordering::Release);
    }
}

impl Default for Mcp2515Buffers {
    fn default() -> Self {
        Self::new()
    }
}

/// Reads the states of all buffers with READ STATUS (12.8).
pub(super) fn read_status<S: SpiDevice>(spi: &mut S) -> Result<u8, S::Error> {
    let mut status = [READ_STATUS, 0];
    spi.transfer_in_place(&mut status)?;
    Ok(status[1])
}

#[cfg(all(loom, test))]
mod model;
