//! The slave in the interrupt handler of its UART, and what it shares with the main loop.
//!
//! A board's handler tells [`DpResponder::step`] what its registers say, and does what that returns; it alone touches them.
//! Both exchange outputs and inputs whole, in whatever order they run: `cargo xtask loom`.

use bus_profibus::{Address, Baud, Character, Counters, Event, Outcome, State};
use wsg_fieldbus::profibus::{ADDRESS, PROFILE, Slave};
use wsg_fieldbus::{Diagnosis, InputImage, OutputImage};
use wsg_protocol::SystemFlags;

use super::ProfibusConfig;
use crate::atomic::{AtomicU8, AtomicU32, Ordering, fence};
use crate::byte_queue::ByteQueue;
use crate::plc::Interrupts;

/// Room for 14 images that differ, between two turns of the main loop; in a model for one.
const QUEUE_LEN: usize = if cfg!(all(loom, test)) { 16 } else { 128 };

/// An event in the queue: its tag, and behind that of outputs the image.
const OUTPUT: u8 = 0;
const LEFT: u8 = 1;
const LEFT_SILENT: u8 = 2;
const OUTPUT_LEN: usize = 1 + OutputImage::LEN;

/// Bits of a character: start, eight of data, parity, stop.
const CHARACTER_BITS: u32 = 11;
/// A character counts as received in the middle of its stop bit; what is waited for begins behind that.
const STOP_BITS: u32 = 1;

/// Silences are not told apart from here on, in microseconds: 33 bits at 9.6 kbit/s are 3.5 ms.
const LONG_SILENCE_US: u32 = 20_000;

/// The longest answer is the diagnosis: start delimiters and lengths, addresses and function code, two service access points,
/// the block, check sum and end delimiter.
const MAX_ANSWER_LEN: usize = 27;
const _: () = assert!(MAX_ANSWER_LEN == 4 + 3 + 2 + Diagnosis::LEN + 2);
const _: () = assert!(InputImage::LEN < Diagnosis::LEN);

/// What the main loop and the handler share; a plain `static`.
#[derive(Debug)]
pub struct DpBuffers {
    /// What the master did.
    events: ByteQueue<QUEUE_LEN>,
    /// How often the master has written outputs. Wraps.
    exchanges: AtomicU32,
    /// How many intact telegrams there were. Wraps.
    telegrams: AtomicU32,
    /// How often something was none. Wraps.
    damaged: AtomicU32,
    /// The slave's state, as PROFIBUS_STATE has it.
    state: AtomicU8,
    /// The input image, written by the main loop alone; the handler keeps a copy.
    input: [AtomicU32; 3],
    /// Counts the beginnings and ends of writing it, and wraps: odd while it is being written.
    input_version: AtomicU32,
    /// The version of the handler's copy. The handler's own.
    taken_version: AtomicU32,
    /// Counts from the first rate on.
    address: AtomicU8,
    /// In bit/s; 0 before the start.
    rate: AtomicU32,
}

/// What the master did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FromMaster {
    /// It wrote this image.
    Output([u8; OutputImage::LEN]),
    /// It does not command any more: its watchdog has expired (`silent`), or it said so.
    Left { silent: bool },
}

impl DpBuffers {
    /// A slave that has not started. All zeros: else a static would take its size of flash as well.
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

    /// Sets the address. For the main loop, before the first rate.
    pub(super) fn set_address(&self, address: u8) {
        self.address.store(address, Ordering::Relaxed);
    }

    /// Sets the rate that the line is to have. For the main loop.
    pub(super) fn set_rate(&self, rate: Baud) {
        self.rate.store(rate.bit_s(), Ordering::Release);
    }

    /// Shows the master this input image from the handler's next step on. For the main loop.
    pub(super) fn show(&self, image: [u8; InputImage::LEN]) {
        let version = self.input_version.load(Ordering::Relaxed);
        // A handler that runs between these keeps its copy.
        self.input_version.store(version.wrapping_add(1), Ordering::Relaxed);
        fence(Ordering::Release);
        for (place, word) in self.input.iter().zip(image.as_chunks().0) {
            place.store(u32::from_le_bytes(*word), Ordering::Relaxed);
        }
        self.input_version.store(version.wrapping_add(2), Ordering::Release);
    }

    /// The event that waits longest. For the main loop.
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

    /// Gives the main loop an event; whether there was room. For the handler.
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

    /// The input image, if it is another than before. For the handler.
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

/// What the registers of a UART say when its handler runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct UartStatus {
    /// What was received since the last step.
    pub received: Option<Character>,
    /// The transmit register has room.
    pub has_room: bool,
    /// The last bit of all that was given to the transmitter has been sent.
    pub is_complete: bool,
}

/// What a handler has to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Action {
    /// The line gets this rate, before anything else; 8E1 it has always.
    pub rate: Option<Baud>,
    /// A byte for the transmit register.
    pub send: Option<u8>,
    /// The interrupts that it needs, beside those for a received byte and for errors.
    pub interrupts: Interrupts,
    /// An answer is due after so many microseconds: then the handler has to run again.
    pub wait_us: Option<u32>,
}

/// Whose turn it is on the line.
#[derive(Clone, Copy, Debug)]
enum Phase {
    /// The others'.
    Listening,
    /// The slave's, once it has been silent from the first for the second, in microseconds.
    Waiting(u32, u32),
    /// The slave's: so many bytes of the answer have been given to the transmitter.
    Sending(usize),
}

/// The slave at the line. It belongs to the handler, which runs when a character was received or sent, when [`Action::wait_us`]
/// is over, and after each turn of the main loop.
#[derive(Debug)]
pub struct DpResponder {
    buffers: &'static DpBuffers,
    slave: Slave,
    /// In bit/s, and the time of a bit in nanoseconds, rounded up; 0 before the start.
    rate: u32,
    bit_ns: u32,
    phase: Phase,
    /// When the last character ended, in microseconds.
    heard_us: u32,
    answer: [u8; MAX_ANSWER_LEN],
    answer_len: usize,
    /// The master commands: the slave's outputs are its own.
    has_outputs: bool,
    /// The outputs that the main loop was given last.
    told: Option<[u8; OutputImage::LEN]>,
    /// What it is still to be told: the master left, silently or not.
    left: Option<bool>,
    /// The flags that the diagnosis tells.
    flags: SystemFlags,
}

impl DpResponder {
    /// A slave that waits for its start ([`Profibus::start`](super::Profibus::start)). One for each [`DpBuffers`].
    #[must_use]
    pub const fn new(buffers: &'static DpBuffers) -> Self {
        Self {
            buffers,
            slave: Slave::new(&PROFILE, ADDRESS),
            rate: 0,
            bit_ns: 0,
            phase: Phase::Listening,
            heard_us: 0,
            answer: [0; MAX_ANSWER_LEN],
            answer_len: 0,
            has_outputs: false,
            told: None,
            left: None,
            flags: SystemFlags::empty(),
        }
    }

    /// One run of the handler, by clocks in milliseconds and in microseconds, which may wrap.
    pub fn step(&mut self, status: UartStatus, now_ms: u32, now_us: u32) -> Action {
        let rate = self.take_rate();
        let mut wait_us = None;
        match (status.received, self.phase) {
            // What the transceiver echoes.
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

    /// Takes another rate, and the first time the address.
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

    /// Takes a character. If an answer is due, in how many microseconds.
    fn receive(&mut self, character: Character, now_ms: u32, now_us: u32) -> Option<u32> {
        let distance_us = now_us.wrapping_sub(core::mem::replace(&mut self.heard_us, now_us));
        let distance_ns = distance_us.min(LONG_SILENCE_US).saturating_mul(1_000);
        let silence_bits =
            distance_ns.checked_div(self.bit_ns).unwrap_or_default().saturating_sub(CHARACTER_BITS);
        // An answer is not sent into what another says.
        self.phase = Phase::Listening;
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
            self.tell();
        }
        wait_us
    }

    /// What goes on beside the line: the inputs, the watchdog, and what the main loop has had no room for.
    fn synchronise(&mut self, now_ms: u32) {
        if let Some(image) = self.buffers.take_input() {
            self.show(image);
        }
        if let Some(event) = self.slave.poll(now_ms) {
            self.note(event);
        }
        self.tell();
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

    /// Inputs, and the diagnosis with the flags among them.
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
                // Written by the handler alone.
                let exchanges = self.buffers.exchanges().wrapping_add(1);
                self.buffers.exchanges.store(exchanges, Ordering::Relaxed);
            }
            Event::Cleared | Event::Left(_) => {
                if core::mem::take(&mut self.has_outputs) {
                    let silent = event == Event::Left(bus_profibus::Cause::Watchdog);
                    self.left = Some(silent || self.left == Some(true));
                }
            }
            // The profile lets no master change it.
            Event::Address(_) => {}
        }
    }

    /// Tells the main loop what it does not know, in order; once there is room, if there is none.
    fn tell(&mut self) {
        if let Some(silent) = self.left {
            if !self.buffers.push(FromMaster::Left { silent }) {
                return;
            }
            self.left = None;
            self.told = None;
        }
        let outputs = *self.slave.outputs();
        if self.has_outputs && self.told != Some(outputs) && self.buffers.push(FromMaster::Output(outputs)) {
            self.told = Some(outputs);
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
                self.heard_us = now_us;
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
