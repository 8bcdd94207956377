//! An RS-485 line between its interrupt handler and the main loop: received characters with the silence before each, and the
//! frame that is being sent. What the transceiver echoes of the bridge's own frames is not handed over.
//!
//! A board's handler moves bytes between its registers and [`RtuBuffers`], by [`RtuBuffers::serve`] where a HAL has the UART; it
//! alone touches the registers, so main loop and handler never change the same one. [`RtuPort`] is the main loop's end.

use bus_modbus::rtu::{Character, MAX_FRAME_LEN};
use embedded_hal_nb::serial::{self, Error as _};

use super::{BusConfig, BusPort};
use crate::atomic::{AtomicBool, AtomicU32, Ordering};
use crate::byte_queue::ByteQueue;

/// Steps in which silence is handed on, in microseconds; 15 bits hold 262 ms of it.
const STEP_US: u32 = 8;
const MAX_STEPS: u32 = 0x7FFF;
/// Beside the steps: the character is damaged, or one before it was lost.
const DAMAGED: u16 = 0x8000;

/// A character in the queue: silence, high byte first, and the byte.
const ENTRY_LEN: usize = 3;

/// Bytes for characters that are received before the main loop reads them: what comes in 7 ms at 230 400 bit/s.
const RECEIVED_MAX: usize = 512;

/// Bytes for the frame that is being sent.
const TO_SEND_MAX: usize = 256;
const _: () = assert!(TO_SEND_MAX >= MAX_FRAME_LEN);

/// The characters on their way; `RX` bytes for received ones, three for each, and `TX` for a frame, both powers of two; enough for
/// every rate of Modbus where neither is given. It is a plain `static`.
///
/// ```
/// use wsg_bridge_fw::plc::RtuBuffers;
///
/// static BUFFERS: RtuBuffers = RtuBuffers::new();
///
/// // In the handler, at 1 000 us: a byte without damage while nothing is being sent.
/// BUFFERS.on_receive(0x01, false, true, 1_000);
/// assert_eq!(BUFFERS.on_transmit(true, true), None);
/// ```
#[derive(Debug)]
pub struct RtuBuffers<const RX: usize = RECEIVED_MAX, const TX: usize = TO_SEND_MAX> {
    received: ByteQueue<RX>,
    to_send: ByteQueue<TX>,
    /// The time of a character, rounded up, in microseconds.
    character_us: AtomicU32,
    /// When the last character ended, in microseconds.
    received_at: AtomicU32,
    /// A frame is being sent: from the first byte that was given to the transmitter until the last bit has left. The handler's own.
    sending: AtomicBool,
    /// Bytes of this frame that were sent, and that came back from a transceiver that echoes. The handler's own.
    sent: AtomicU32,
    echoed: AtomicU32,
    /// The next character follows one that was lost. The handler's own.
    lost: AtomicBool,
}

/// The interrupts that a handler needs next, beside the one for a received byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interrupts {
    /// The transmit register has room.
    pub transmit_empty: bool,
    /// The last bit has been sent.
    pub transmission_complete: bool,
}

impl<const RX: usize, const TX: usize> RtuBuffers<RX, TX> {
    /// Empty queues. Silences count from [`start`](Self::start).
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

    /// Sets how long a character takes, before the line is switched on.
    pub fn start(&self, config: &BusConfig) {
        let character_us = config.format.bits().saturating_mul(1_000_000).div_ceil(config.baud.max(1));
        self.character_us.store(character_us, Ordering::Relaxed);
    }

    /// Takes a received byte. For the handler. `is_complete`: the last bit of all bytes given to the transmitter has been
    /// sent.
    pub fn on_receive(&self, byte: u8, damaged: bool, is_complete: bool, now_us: u32) {
        if !self.is_echo(is_complete) {
            self.take(byte, damaged, now_us);
        }
    }

    /// Takes an overrun without a byte: one was lost, and the one before it has been taken already. For the handler.
    pub fn on_overrun(&self) {
        // While a frame is being sent it was an echo.
        if !self.sending.load(Ordering::Relaxed) {
            self.lost.store(true, Ordering::Relaxed);
        }
    }

    /// Whether what was received is the bridge's own. Behind the last bit that can only be the last byte, and only if the
    /// others came back as well: else it is the begin of the next request already, and the handler is late.
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
        // There is room.
        let _ = self.received.push_all(&[high, low, byte]);
    }

    /// Returns the next byte of a frame for a transmit register that `has_room`, or ends the frame: its last bit has been
    /// sent. For the handler, behind [`on_receive`](Self::on_receive).
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

    /// The whole handler for a HAL's UART: at most one character each way. Returns the interrupts that it needs from now on.
    ///
    /// A driver of RS-485 that the UART does not switch by itself has to be on before a byte is written, and is to be off once no
    /// interrupt is needed.
    pub fn serve<U: serial::Read + serial::Write>(&self, uart: &mut U, now_us: u32) -> Interrupts {
        // Before the byte is written that would make it busy.
        let is_complete = uart.flush().is_ok();
        match uart.read() {
            Err(nb::Error::WouldBlock) => {}
            Err(nb::Error::Other(error)) if error.kind() == serial::ErrorKind::Overrun => self.on_overrun(),
            // The byte of a damaged character does not matter.
            read => self.on_receive(*read.as_ref().unwrap_or(&0), read.is_err(), is_complete, now_us),
        }
        let is_written = self.to_send.peek().is_some_and(|byte| uart.write(byte).is_ok());
        // The byte that was written leaves the queue.
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

/// What the main loop needs of a UART's registers, and a clock.
pub trait RtuUart {
    /// Has the handler run soon: there is a frame to send.
    fn pend(&mut self);

    /// The time in microseconds, of the clock that the handler uses; it may wrap.
    fn now_us(&mut self) -> u32;
}

/// The main loop's end of the line. There is one value of it for each [`RtuBuffers`].
#[derive(Debug)]
pub struct RtuPort<U, const RX: usize = RECEIVED_MAX, const TX: usize = TO_SEND_MAX> {
    uart: U,
    buffers: &'static RtuBuffers<RX, TX>,
}

impl<U: RtuUart, const RX: usize, const TX: usize> RtuPort<U, RX, TX> {
    /// The end of this line.
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
        // Acquire: the clock is read after it. A character received between these in the other order would make the silence
        // negative, which ends a frame in its middle.
        let received_at = self.buffers.received_at.load(Ordering::Acquire);
        let silence_us = self.uart.now_us().wrapping_sub(received_at);
        if self.buffers.received.is_empty() { silence_us } else { 0 }
    }

    fn send(&mut self, frame: &[u8]) {
        // In this order: the handler has said that it sends before the queue is empty.
        if !self.buffers.to_send.is_empty() || self.buffers.sending.load(Ordering::Relaxed) {
            return;
        }
        // At once, or a handler that runs meanwhile for something else would take a part for the whole. There is room for the longest.
        let _ = self.buffers.to_send.push_all(frame);
        self.uart.pend();
    }
}

#[cfg(all(loom, test))]
mod model;
