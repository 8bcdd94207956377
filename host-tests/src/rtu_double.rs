//! A Modbus RTU line in virtual time, from the viewpoints of bridge and master.

use std::collections::VecDeque;

use bus_modbus::rtu::{Character, crc};
use wsg_bridge_fw::BusPort;

/// An observation or action of the bridge on the line.
#[derive(Clone, Debug)]
pub(crate) enum Event {
    Character(Character, u32),
    Silence(u32),
    Answer(Vec<u8>),
}

/// Both ends of a Modbus RTU line: the bridge's and the master's.
#[derive(Clone, Debug)]
pub struct RtuDouble {
    waiting: VecDeque<(Character, u32)>,
    /// Time since the last character, in microseconds.
    pub silence_us: u32,
    events: Vec<Event>,
    /// Whether events other than answers are recorded.
    is_overheard: bool,
}

impl Default for RtuDouble {
    fn default() -> Self {
        Self { waiting: VecDeque::new(), silence_us: SILENCE_US, events: Vec::new(), is_overheard: false }
    }
}

/// Long enough to end a frame.
const SILENCE_US: u32 = 100_000;

/// Returns a frame with its checksum appended.
#[must_use]
pub fn sealed(body: &[u8]) -> Vec<u8> {
    [body, &crc(body).to_le_bytes()].concat()
}

impl RtuDouble {
    /// Creates a new line that records everything the bridge observes.
    pub(crate) fn overheard() -> Self {
        Self { silence_us: 0, is_overheard: true, ..Self::default() }
    }

    /// Delivers a character after this silence.
    pub(crate) fn deliver(&mut self, character: Character, silence_us: u32) {
        self.silence_us = 0;
        self.waiting.push_back((character, silence_us));
    }

    /// Delivers bytes back to back, after the elapsed silence.
    pub fn put(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let silence_us = self.silence_us;
            self.deliver(Character::Byte(*byte), silence_us);
        }
    }

    /// Advances time by a millisecond.
    pub fn pass_ms(&mut self) {
        self.silence_us = self.silence_us.saturating_add(1_000);
    }

    /// Delivers a request given without its checksum, with silence before and after it.
    pub fn ask(&mut self, request: &[u8]) {
        self.silence_us = SILENCE_US;
        self.put(&sealed(request));
        self.silence_us = SILENCE_US;
        self.events.clear();
    }

    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Returns the last answer with unit and checksum.
    pub fn answer(&mut self) -> Option<Vec<u8>> {
        match self.events.pop()? {
            Event::Answer(frame) => Some(frame),
            _ => None,
        }
    }

    /// Returns the register value from the answer to a read of one register.
    pub fn answered(&mut self) -> Option<u16> {
        match self.answer()?[..] {
            [_, _, 2, high, low, ..] => Some(u16::from_be_bytes([high, low])),
            _ => None,
        }
    }
}

impl BusPort for RtuDouble {
    fn receive(&mut self) -> Option<(Character, u32)> {
        let (character, silence_us) = self.waiting.pop_front()?;
        if self.is_overheard {
            self.events.push(Event::Character(character, silence_us));
        }
        Some((character, silence_us))
    }

    fn silence_us(&mut self) -> u32 {
        if self.is_overheard {
            self.events.push(Event::Silence(self.silence_us));
        }
        self.silence_us
    }

    fn send(&mut self, frame: &[u8]) {
        self.events.push(Event::Answer(frame.to_vec()));
    }
}
