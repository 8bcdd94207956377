//! RS-485 line between its interrupt handler and the main loop: received characters with the preceding silence, and the frame
//! in transmission. Echoes of the bridge's own frames are suppressed.
//!
//! A board's handler moves bytes between its registers and [`RtuBuffers`], with [`RtuBuffers::serve`] if a HAL has the UART.
//! Only the handler accesses the registers. [`RtuPort`] is the main loop's end.

use bus_modbus::rtu::{Character, MAX_FRAME_LEN};
use embedded_hal_nb::serial::{self, Error as _};

use super::{BusConfig, BusPort};
use crate::atomic::{AtomicBool, AtomicU32, Ordering};
use crate::byte_queue::ByteQueue;

/// Unit of silence in the queue, in microseconds. 15 bits hold 262 ms.
const STEP_US: u32 = 8;
const MAX_STEPS: u32 = 0x7FFF;
/// Flag in addition to the silence: the character is damaged, or the one before was lost.
const DAMAGED: u16 = 0x8000;

/// Length of a queued character: silence, high byte first, and the byte.
const ENTRY_LEN: usize = 3;

/// Queue length in bytes for received characters: 7 ms at 230 400 bit/s.
const RECEIVED_MAX: usize = 512;

/// Queue length in bytes for the frame in transmission.
const TO_SEND_MAX: usize = 256;
const _: () = assert!(TO_SEND_MAX >= MAX_FRAME_LEN);

/// Data shared by handler and main loop, in a plain `static`. `RX` is the queue length in bytes for received characters,
/// three each, and `TX` for a frame. Both are powers of two. The defaults suffice for every rate of Modbus.
///
/// ```
/// use wsg_bridge_fw::plc::RtuBuffers;
///
/// static BUFFERS: RtuBuffers = RtuBuffers::new();
///
/// // In the handler, at 1 000 us: an undamaged byte while nothing is being sent.
/// BUFFERS.on_receive(0x01, false, true, 1_000);
/// assert_eq!(BUFFERS.on_transmit(true, true), None);
/// ```
#[derive(Debug)]
pub struct RtuBuffers<const RX: usize = RECEIVED_MAX, const TX: usize = TO_SEND_MAX> {
    received: ByteQueue<RX>,
    to_send: ByteQueue<TX>,
    /// Duration of a character, rounded up, in microseconds.
    character_us: AtomicU32,
    /// End of the last character, in microseconds.
    received_at: AtomicU32,
    /// A frame is being sent, from its first byte until its last bit. Written only by the handler.
    sending: AtomicBool,
    /// Bytes of this frame that were sent, and echoes of them. Written only by the handler.
    sent: AtomicU32,
    echoed: AtomicU32,
    /// The next character follows a lost one. Written only by the handler.
    lost: AtomicBool,
}

/// Interrupts that a handler needs next, in addition to the one for a received byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interrupts {
    /// The transmit register has room.
    pub transmit_empty: bool,
    /// The last bit has been sent.
    pub transmission_complete: bool,
}

impl<const RX: usize, const TX: usize> RtuBuffers<RX, TX> {
    /// Creates empty queues. Silences are valid from [`start`](Self::start) on.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(TX >= MAX_FRAME_LEN || cfg!(all(loom, test))) };
        Self {
            received: ByteQueue::new(),
            to_send: ByteQueue::new(),
            character_us: AtomicU32::new(0),
            received_at: AtomicU32::new(0),
            sending: AtomicBool::new(false),
            sent: AtomicU32::new(0),
            echoed: AtomicU32::new(0),
            lost: AtomicBool::new(false),
        }
    }

    /// Sets the duration of a character, before the line is switched on.
    pub fn start(&self, config: &BusConfig) {
        let character_us = config.format.bits().saturating_mul(1_000_000).div_ceil(config.baud.max(1));
        self.character_us.store(character_us, Ordering::Relaxed);
    }

    /// Processes a received byte, in the handler. `is_complete`: the last bit of all written bytes has been sent.
    pub fn on_receive(&self, byte: u8, damaged: bool, is_complete: bool, now_us: u32) {
        if !self.is_echo(is_complete) {
            self.take(byte, damaged, now_us);
        }
    }

    /// Processes an overrun without a byte, in the handler: a byte was lost after the previous one was read.
    pub fn on_overrun(&self) {
        // During transmission, the lost byte was an echo.
        if !self.sending.load(Ordering::Relaxed) {
            self.lost.store(true, Ordering::Relaxed);
        }
    }

    /// Returns whether a received byte is an echo. After the last bit has been sent, it can only be the echo of the last
    /// byte, after all other echoes. Otherwise it is the start of the next request, and the handler is late.
    fn is_echo(&self, is_complete: bool) -> bool {
        if !self.sending.load(Ordering::Relaxed) {
            return false;
        }
        let echoed = self.echoed.load(Ordering::Relaxed).saturating_add(1);
        self.echoed.store(echoed, Ordering::Relaxed);
        !(is_complete && self.to_send.is_empty() && echoed < self.sent.load(Ordering::Relaxed))
    }

    fn take(&self, byte: u8, damaged: bool, now_us: u32) {
        let distance_us = now_us.wrapping_sub(self.received_at.load(Ordering::Relaxed));
        self.received_at.store(now_us, Ordering::Release);
        if self.received.room() < ENTRY_LEN {
            self.lost.store(true, Ordering::Relaxed);
            return;
        }
        let silence_us = distance_us.saturating_sub(self.character_us.load(Ordering::Relaxed));
        let steps = (silence_us / STEP_US).min(MAX_STEPS) as u16;
        let void = damaged || self.lost.load(Ordering::Relaxed);
        self.lost.store(false, Ordering::Relaxed);
        let [high, low] = if void { steps | DAMAGED } else { steps }.to_be_bytes();
        // Cannot fail: the room was checked.
        let _ = self.received.push_all(&[high, low, byte]);
    }

    /// Returns the next byte for a transmit register that `has_room`, or ends the frame if its last bit has been sent. For
    /// the handler, after [`on_receive`](Self::on_receive).
    pub fn on_transmit(&self, has_room: bool, is_complete: bool) -> Option<u8> {
        let byte = if has_room { self.to_send.pop() } else { None };
        if byte.is_some() {
            self.sending.store(true, Ordering::Relaxed);
            self.sent.store(self.sent.load(Ordering::Relaxed).saturating_add(1), Ordering::Relaxed);
        } else if self.sending.load(Ordering::Relaxed) && is_complete && self.to_send.is_empty() {
            self.sent.store(0, Ordering::Relaxed);
            self.echoed.store(0, Ordering::Relaxed);
            self.sending.store(false, Ordering::Relaxed);
        }
        byte
    }

    /// Handles one interrupt for a HAL's UART, with at most one character each way. Returns the interrupts that it needs from
    /// now on.
    ///
    /// If the UART does not switch the RS-485 driver itself, switch it on before a byte is written, and off when no interrupt
    /// is needed.
    pub fn serve<U: serial::Read + serial::Write>(&self, uart: &mut U, now_us: u32) -> Interrupts {
        // Before a written byte makes the UART busy.
        let is_complete = uart.flush().is_ok();
        match uart.read() {
            Err(nb::Error::WouldBlock) => {}
            Err(nb::Error::Other(error)) if error.kind() == serial::ErrorKind::Overrun => self.on_overrun(),
            // The byte of a damaged character is not used.
            read => self.on_receive(*read.as_ref().unwrap_or(&0), read.is_err(), is_complete, now_us),
        }
        let is_written = self.to_send.peek().is_some_and(|byte| uart.write(byte).is_ok());
        // Removes the written byte from the queue.
        let _ = self.on_transmit(is_written, is_complete);
        self.interrupts()
    }

    /// Returns the interrupts that the handler needs from now on.
    #[must_use]
    pub fn interrupts(&self) -> Interrupts {
        let transmit_empty = !self.to_send.is_empty();
        let transmission_complete = !transmit_empty && self.sending.load(Ordering::Relaxed);
        Interrupts { transmit_empty, transmission_complete }
    }
}

impl<const RX: usize, const TX: usize> Default for RtuBuffers<RX, TX> {
    fn default() -> Self {
        Self::new()
    }
}

/// The main loop's access to a UART and a clock.
pub trait RtuUart {
    /// Schedules a run of the handler, because a frame is to be sent.
    fn pend(&mut self);

    /// Returns the time in microseconds, from the handler's clock. It may wrap.
    fn now_us(&mut self) -> u32;
}

/// The main loop's end of the line. Create only one for each [`RtuBuffers`].
#[derive(Debug)]
pub struct RtuPort<U, const RX: usize = RECEIVED_MAX, const TX: usize = TO_SEND_MAX> {
    uart: U,
    buffers: &'static RtuBuffers<RX, TX>,
}

impl<U: RtuUart, const RX: usize, const TX: usize> RtuPort<U, RX, TX> {
    /// Creates the main loop's end of this line.
    pub const fn new(uart: U, buffers: &'static RtuBuffers<RX, TX>) -> Self {
        Self { uart, buffers }
    }
}

impl<U: RtuUart, const RX: usize, const TX: usize> BusPort for RtuPort<U, RX, TX> {
    fn receive(&mut self) -> Option<(Character, u32)> {
        let [high, low, byte]: [u8; ENTRY_LEN] = self.buffers.received.pop_all()?;
        let silence = u16::from_be_bytes([high, low]);
        let character = if silence & DAMAGED != 0 { Character::Damaged } else { Character::Byte(byte) };
        Some((character, u32::from(silence & !DAMAGED).saturating_mul(STEP_US)))
    }

    fn silence_us(&mut self) -> u32 {
        // Acquire: the clock must be read afterwards. If a character were received between the reads in the other order, the
        // silence would be negative and end a frame prematurely.
        let received_at = self.buffers.received_at.load(Ordering::Acquire);
        let silence_us = self.uart.now_us().wrapping_sub(received_at);
        if self.buffers.received.is_empty() { silence_us } else { 0 }
    }

    fn send(&mut self, frame: &[u8]) {
        // In this order: the handler sets `sending` before the queue becomes empty.
        if !self.buffers.to_send.is_empty() || self.buffers.sending.load(Ordering::Relaxed) {
            return;
        }
        // In one operation: a handler that runs in between would take a part for the whole frame. There is room for the
        // longest frame.
        let _ = self.buffers.to_send.push_all(frame);
        self.uart.pend();
    }
}

#[cfg(all(loom, test))]
mod model;
