//! What an MCP2515 has received, between the handler of its interrupt and the main loop.

use embedded_hal::spi::{Operation, SpiDevice};

use crate::atomic::{AtomicBool, Ordering};
use crate::byte_queue::ByteQueue;
use crate::can::bus::MAX_RECEIVED_PER_POLL;

/// Instructions (12.0).
const READ_STATUS: u8 = 0xA0;
const READ_RX: [u8; 2] = [0x90, 0x94];
/// READ STATUS: a frame is in the first buffer, in the second.
const RX0IF: u8 = 1 << 0;
const RX1IF: u8 = 1 << 1;

/// A frame as the registers of a receive buffer have it: identifier, length, data.
pub(super) type RawFrame = [u8; FRAME_LEN];
const FRAME_LEN: usize = 13;

/// 39 frames: what comes in the millisecond between two turns of the main loop, and in another half.
/// In a model for one.
const QUEUE_LEN: usize = if cfg!(all(loom, test)) { 16 } else { 512 };
const _: () = assert!(QUEUE_LEN / FRAME_LEN >= MAX_RECEIVED_PER_POLL * 3 / 2 || cfg!(all(loom, test)));

/// The frames that the handler of an MCP2515's interrupt has taken from it. It is a plain `static`, for a handler and a main loop on
/// one core.
///
/// The MCP2515 holds two frames, and at 1 Mbit/s the third may end 94 µs behind the first: too soon for a main loop. Both use its
/// SPI, each by a [`SpiDevice`] of its own; that of the main loop keeps the handler out for each transaction.
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
    /// Whether the controller is set up; written by the main loop alone.
    is_open: AtomicBool,
    /// What is in the second receive buffer is older than what is in the first; the handler's, once it is open.
    second_is_older: AtomicBool,
}

impl Mcp2515Buffers {
    /// An empty queue of a controller that is not set up.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            frames: ByteQueue::new(),
            is_open: AtomicBool::new(false),
            second_is_older: AtomicBool::new(false),
        }
    }

    /// Takes every frame that the controller holds: the whole handler. Returns whether its interrupt may stay unmasked: not if there
    /// is no room for a frame, which stays where it is, and not before the controller is set up. Then the handler masks
    /// its interrupt, and the main loop unmasks it after its turn.
    #[must_use]
    pub fn serve<S: SpiDevice>(&self, spi: &mut S) -> bool {
        // Acquire: what the main loop has cleared for the handler is clear.
        self.is_open.load(Ordering::Acquire) && self.take(spi).unwrap_or(false)
    }

    fn take<S: SpiDevice>(&self, spi: &mut S) -> Result<bool, S::Error> {
        let mut status = read_status(spi)?;
        // It ends with the queue's room: the main loop makes none meanwhile.
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
            // What has come to the second while the first was full is older than what comes to the first from now on.
            self.second_is_older.store(buffer == 0 && status & RX1IF != 0, Ordering::Relaxed);
            // There is room.
            let _ = self.frames.push_all(&raw);
        }
    }

    /// Whether a frame waits for the main loop.
    #[must_use]
    pub fn has_received(&self) -> bool {
        !self.frames.is_empty()
    }

    /// The frame that waits longest.
    pub(super) fn pop(&self) -> Option<RawFrame> {
        self.frames.pop_all()
    }

    /// Drops the frames that wait.
    pub(super) fn clear(&self) {
        self.frames.clear();
    }

    /// Has the handler leave the controller alone.
    pub(super) fn close(&self) {
        self.is_open.store(false, Ordering::Relaxed);
    }

    /// Has the handler begin, with a controller that was just set up.
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

/// Which buffers are full and which are to be sent, as READ STATUS has it (12.8).
pub(super) fn read_status<S: SpiDevice>(spi: &mut S) -> Result<u8, S::Error> {
    let mut status = [READ_STATUS, 0];
    spi.transfer_in_place(&mut status)?;
    Ok(status[1])
}

#[cfg(all(loom, test))]
mod model;
