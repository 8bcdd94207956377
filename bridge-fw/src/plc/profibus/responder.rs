//! The slave in the interrupt handler of its UART, and the data that it shares with the main loop.
//!
//! A board's handler passes the state of its registers to [`DpResponder::step`], and executes the returned action. Only the
//! handler accesses the registers. Outputs and inputs are exchanged as a whole in every order of execution: `cargo xtask
//! loom`.

use bus_profibus::{Address, Baud, Character, Counters, Event, Outcome, State};
use wsg_fieldbus::profibus::{ADDRESS, PROFILE, Slave};
use wsg_fieldbus::{Diagnosis, InputImage, OutputImage};
use wsg_protocol::SystemFlags;

use super::ProfibusConfig;
use crate::atomic::{AtomicU8, AtomicU32, Ordering, fence};
use crate::byte_queue::ByteQueue;
use crate::plc::Interrupts;

/// Queue length in bytes for 14 different images between two turns of the main loop; in a model for one.
const QUEUE_LEN: usize = if cfg!(all(loom, test)) { 16 } else { 128 };

/// Tags of queued events. `OUTPUT` is followed by the image.
const OUTPUT: u8 = 0;
const LEFT: u8 = 1;
const LEFT_SILENT: u8 = 2;
const OUTPUT_LEN: usize = 1 + OutputImage::LEN;

/// Bits of a character: start, eight data bits, parity, stop.
const CHARACTER_BITS: u32 = 11;
/// A character is received in the middle of its stop bit. Subsequent waiting times start at the end of the bit.
const STOP_BITS: u32 = 1;

/// Limit up to which silences are distinguished, in microseconds: 33 bits at 9.6 kbit/s are 3.5 ms.
const LONG_SILENCE_US: u32 = 20_000;

/// Length of the longest response, the diagnosis: start delimiters and lengths, addresses and function code, two service
/// access points, the block, checksum and end delimiter.
const MAX_ANSWER_LEN: usize = 27;
const _: () = assert!(MAX_ANSWER_LEN == 4 + 3 + 2 + Diagnosis::LEN + 2);
const _: () = assert!(InputImage::LEN < Diagnosis::LEN);

/// Data shared by the main loop and the handler; a plain `static`.
#[derive(Debug)]
pub struct DpBuffers {
    /// Events of the master.
    events: ByteQueue<QUEUE_LEN>,
    /// Number of output data telegrams of the master. Wraps.
    exchanges: AtomicU32,
    /// Number of intact telegrams. Wraps.
    telegrams: AtomicU32,
    /// Number of damaged telegrams. Wraps.
    damaged: AtomicU32,
    /// State of the slave, encoded as PROFIBUS_STATE.
    state: AtomicU8,
    /// Input image, written only by the main loop. The handler keeps a copy.
    input: [AtomicU32; 3],
    /// Version of the input image, incremented before and after each write. It is odd during a write, and wraps.
    input_version: AtomicU32,
    /// Version of the handler's copy. Written only by the handler.
    taken_version: AtomicU32,
    /// Station address. Valid once the rate is set.
    address: AtomicU8,
    /// Rate in bit/s; 0 before the start.
    rate: AtomicU32,
}

/// Event of the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FromMaster {
    /// The master wrote this image.
    Output([u8; OutputImage::LEN]),
    /// The master no longer commands. `silent`: its watchdog expired. Otherwise it released or cleared the outputs.
    Left { silent: bool },
}

impl DpBuffers {
    /// Creates the buffers of a slave that has not started. All zeros, so that a static occupies no flash.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            events: ByteQueue::new(),
            exchanges: AtomicU32::new(0),
            telegrams: AtomicU32::new(0),
            damaged: AtomicU32::new(0),
            state: AtomicU8::new(0),
            input: [const { AtomicU32::new(0) }; 3],
            input_version: AtomicU32::new(0),
            taken_version: AtomicU32::new(0),
            address: AtomicU8::new(0),
            rate: AtomicU32::new(0),
        }
    }

    /// Sets the address before the first rate, in the main loop.
    pub(super) fn set_address(&self, address: u8) {
        self.address.store(address, Ordering::Relaxed);
    }

    /// Sets the rate of the line, in the main loop.
    pub(super) fn set_rate(&self, rate: Baud) {
        self.rate.store(rate.bit_s(), Ordering::Release);
    }

    /// Sets the input image from the handler's next step on, in the main loop.
    pub(super) fn show(&self, image: [u8; InputImage::LEN]) {
        let version = self.input_version.load(Ordering::Relaxed);
        // A handler that runs between these stores keeps its copy.
        self.input_version.store(version.wrapping_add(1), Ordering::Relaxed);
        fence(Ordering::Release);
        for (place, word) in self.input.iter().zip(image.as_chunks().0) {
            place.store(u32::from_le_bytes(*word), Ordering::Relaxed);
        }
        self.input_version.store(version.wrapping_add(2), Ordering::Release);
    }

    /// Returns the oldest event, in the main loop.
    pub(super) fn take(&self) -> Option<FromMaster> {
        if self.events.peek()? == OUTPUT {
            let [_, image @ ..]: [u8; OUTPUT_LEN] = self.events.pop_all()?;
            return Some(FromMaster::Output(image));
        }
        let tag = self.events.pop()?;
        Some(FromMaster::Left { silent: tag == LEFT_SILENT })
    }

    pub(super) fn exchanges(&self) -> u32 {
        self.exchanges.load(Ordering::Relaxed)
    }

    pub(super) fn telegrams(&self) -> u32 {
        self.telegrams.load(Ordering::Relaxed)
    }

    pub(super) fn damaged(&self) -> u32 {
        self.damaged.load(Ordering::Relaxed)
    }

    pub(super) fn state(&self) -> u8 {
        self.state.load(Ordering::Relaxed)
    }

    /// Queues an event for the main loop, in the handler. Returns whether there was room.
    fn push(&self, event: FromMaster) -> bool {
        if self.events.room() < OUTPUT_LEN {
            return false;
        }
        let pushed = match event {
            FromMaster::Output([a, b, c, d, e, f, g, h]) => {
                self.events.push_all(&[OUTPUT, a, b, c, d, e, f, g, h])
            }
            FromMaster::Left { silent: false } => self.events.push(LEFT),
            FromMaster::Left { silent: true } => self.events.push(LEFT_SILENT),
        };
        pushed.is_ok()
    }

    /// Returns the input image if it has changed, in the handler.
    fn take_input(&self) -> Option<[u8; InputImage::LEN]> {
        let version = self.input_version.load(Ordering::Acquire);
        if version == self.taken_version.load(Ordering::Relaxed) {
            return None;
        }
        let mut image = [0; InputImage::LEN];
        for (place, word) in image.as_chunks_mut().0.iter_mut().zip(&self.input) {
            *place = word.load(Ordering::Relaxed).to_le_bytes();
        }
        fence(Ordering::Acquire);
        let is_whole = version.is_multiple_of(2) && self.input_version.load(Ordering::Relaxed) == version;
        is_whole.then(|| {
            self.taken_version.store(version, Ordering::Relaxed);
            image
        })
    }
}

impl Default for DpBuffers {
    fn default() -> Self {
        Self::new()
    }
}

/// State of a UART's registers when its handler runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct UartStatus {
    /// Character received since the last step.
    pub received: Option<Character>,
    /// The transmit register has room.
    pub has_room: bool,
    /// The last bit of all written bytes has been sent.
    pub is_complete: bool,
}

/// Action for the handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Action {
    /// New rate for the line, to set before anything else. The format is always 8E1.
    pub rate: Option<Baud>,
    /// Byte for the transmit register.
    pub send: Option<u8>,
    /// Interrupts that the handler needs, in addition to those for received bytes and errors.
    pub interrupts: Interrupts,
    /// Time until a response is due, in microseconds. The handler must run again after it.
    pub wait_us: Option<u32>,
}

/// State of the line.
#[derive(Clone, Copy, Debug)]
enum Phase {
    /// Other stations send.
    Listening,
    /// The slave responds after a silence, from the first time on for the second, in microseconds.
    Waiting(u32, u32),
    /// The slave responds. This many bytes have been written to the transmitter.
    Sending(usize),
}

/// The slave on the line. It belongs to the handler, which runs after a received or sent character, after
/// [`Action::wait_us`], and after each turn of the main loop.
#[derive(Debug, Clone)]
pub struct DpResponder {
    buffers: &'static DpBuffers,
    slave: Slave,
    /// Rate in bit/s, and duration of a bit in nanoseconds, rounded up; 0 before the start.
    rate: u32,
    bit_ns: u32,
    phase: Phase,
    /// End of the last character, in microseconds.
    received_us: u32,
    answer: [u8; MAX_ANSWER_LEN],
    answer_len: usize,
    /// The outputs are valid, because the master commands.
    has_outputs: bool,
    /// Outputs last queued for the main loop.
    reported: Option<[u8; OutputImage::LEN]>,
    /// Event still to be queued: the master left, by a time-out or not.
    left: Option<bool>,
    /// Flags shown in the diagnosis.
    flags: SystemFlags,
}

impl DpResponder {
    /// Creates a slave before its start ([`Profibus::start`](super::Profibus::start)). Create only one for each
    /// [`DpBuffers`].
    #[must_use]
    pub const fn new(buffers: &'static DpBuffers) -> Self {
        Self {
            buffers,
            slave: Slave::new(&PROFILE, ADDRESS),
            rate: 0,
            bit_ns: 0,
            phase: Phase::Listening,
            received_us: 0,
            answer: [0; MAX_ANSWER_LEN],
            answer_len: 0,
            has_outputs: false,
            reported: None,
            left: None,
            flags: SystemFlags::empty(),
        }
    }

    /// Runs one step of the handler. The clocks, in milliseconds and microseconds, may wrap.
    pub fn step(&mut self, status: UartStatus, now_ms: u32, now_us: u32) -> Action {
        let rate = self.take_rate();
        let mut wait_us = None;
        match (status.received, self.phase) {
            // Echo of the transceiver.
            (Some(_), Phase::Sending(_)) => {}
            (Some(character), _) => wait_us = self.receive(character, now_ms, now_us),
            (None, _) => {}
        }
        let send = self.transmit(status, now_us);
        if status.received.is_none() && matches!(self.phase, Phase::Listening) {
            self.synchronise(now_ms);
        }
        let interrupts = match self.phase {
            Phase::Sending(sent) => {
                let transmit_empty = sent < self.answer_len;
                Interrupts { transmit_empty, transmission_complete: !transmit_empty }
            }
            _ => Interrupts { transmit_empty: false, transmission_complete: false },
        };
        Action { rate, send, interrupts, wait_us }
    }

    /// Applies a new rate, and with the first one the address.
    fn take_rate(&mut self) -> Option<Baud> {
        let wanted = self.buffers.rate.load(Ordering::Acquire);
        if wanted == self.rate {
            return None;
        }
        let rate = ProfibusConfig::RATES.into_iter().find(|rate| rate.bit_s() == wanted)?;
        if self.rate == 0 {
            self.slave.set_address(Address::new(self.buffers.address.load(Ordering::Relaxed)));
        }
        self.rate = wanted;
        self.bit_ns = 1_000_000_000u32.checked_div(wanted).unwrap_or_default().saturating_add(1);
        self.phase = Phase::Listening;
        Some(rate)
    }

    /// Processes a character. Returns the time until a response is due, in microseconds.
    fn receive(&mut self, character: Character, now_ms: u32, now_us: u32) -> Option<u32> {
        let distance_us = now_us.wrapping_sub(core::mem::replace(&mut self.received_us, now_us));
        let distance_ns = distance_us.min(LONG_SILENCE_US).saturating_mul(1_000);
        let silence_bits =
            distance_ns.checked_div(self.bit_ns).unwrap_or_default().saturating_sub(CHARACTER_BITS);
        // Cancels a pending response while another station sends. A stray of a transceiver is no station, and the timer is
        // still running.
        if !character.is_stray() {
            self.phase = Phase::Listening;
        }
        let Outcome { event, answer } = self.slave.push(character, silence_bits, now_ms)?;
        let mut wait_us = None;
        if let Some(answer) = answer {
            for (place, byte) in self.answer.iter_mut().zip(answer.bytes) {
                *place = *byte;
            }
            self.answer_len = answer.bytes.len().min(MAX_ANSWER_LEN);
            let bits = answer.not_before_bits.saturating_add(STOP_BITS);
            let us = bits.saturating_mul(self.bit_ns).div_ceil(1_000).saturating_add(1);
            self.phase = Phase::Waiting(now_us, us);
            wait_us = Some(us);
        }
        if let Some(event) = event {
            self.note(event);
            self.report();
        }
        wait_us
    }

    /// Performs the work between characters: inputs, watchdog, counters, and events that had no room in the queue.
    fn synchronise(&mut self, now_ms: u32) {
        if let Some(image) = self.buffers.take_input() {
            self.show(image);
        }
        if let Some(event) = self.slave.poll(now_ms) {
            self.note(event);
        }
        self.report();
        let Counters { telegrams, damaged } = self.slave.counters();
        self.buffers.telegrams.store(telegrams, Ordering::Relaxed);
        self.buffers.damaged.store(damaged, Ordering::Relaxed);
        let state = match self.slave.state() {
            State::WaitPrm => 2,
            State::WaitCfg => 3,
            State::DataExch => 4,
        };
        self.buffers.state.store(state, Ordering::Relaxed);
    }

    /// Applies the input image, and updates the diagnosis from its flags.
    fn show(&mut self, image: [u8; InputImage::LEN]) {
        self.slave.show_inputs(&image);
        let [_, _, y0, y1, y2, y3, ..] = image;
        let flags = SystemFlags::from_bits_retain(u32::from_le_bytes([y0, y1, y2, y3]));
        let before = core::mem::replace(&mut self.flags, flags);
        self.slave.show_diagnosis(&Diagnosis::device_part(flags), flags.intersects(Diagnosis::TRIGGERS));
        if Diagnosis::is_due(before, flags) {
            self.slave.announce_diagnosis();
        }
    }

    fn note(&mut self, event: Event) {
        match event {
            Event::Outputs => {
                self.has_outputs = true;
                // Written only by the handler.
                let exchanges = self.buffers.exchanges().wrapping_add(1);
                self.buffers.exchanges.store(exchanges, Ordering::Relaxed);
            }
            Event::Cleared | Event::Left(_) => {
                if core::mem::take(&mut self.has_outputs) {
                    let silent = event == Event::Left(bus_profibus::Cause::Watchdog);
                    self.left = Some(silent || self.left == Some(true));
                }
            }
            // The profile allows no master to change it.
            Event::Address(_) => {}
        }
    }

    /// Queues outstanding events for the main loop in order, as far as there is room.
    fn report(&mut self) {
        if let Some(silent) = self.left {
            if !self.buffers.push(FromMaster::Left { silent }) {
                return;
            }
            self.left = None;
            self.reported = None;
        }
        let outputs = *self.slave.outputs();
        if self.has_outputs
            && self.reported != Some(outputs)
            && self.buffers.push(FromMaster::Output(outputs))
        {
            self.reported = Some(outputs);
        }
    }

    fn transmit(&mut self, status: UartStatus, now_us: u32) -> Option<u8> {
        if let Phase::Waiting(since_us, wait_us) = self.phase
            && now_us.wrapping_sub(since_us) >= wait_us
        {
            self.phase = Phase::Sending(0);
        }
        let Phase::Sending(sent) = self.phase else { return None };
        match self.answer.get(..self.answer_len)?.get(sent) {
            Some(byte) if status.has_room => {
                self.phase = Phase::Sending(sent.saturating_add(1));
                Some(*byte)
            }
            None if status.is_complete => {
                self.phase = Phase::Listening;
                self.received_us = now_us;
                None
            }
            _ => None,
        }
    }
}

#[cfg(all(loom, test))]
mod model;

#[cfg(test)]
mod tests;
