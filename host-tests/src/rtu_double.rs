//! A line for Modbus RTU in virtual time, as bridge and master have it.

use std::collections::VecDeque;

use bus_modbus::rtu::{Character, crc};
use wsg_bridge_fw::BusPort;

/// What the bridge saw of the line and did on it.
#[derive(Clone, Debug)]
pub(crate) enum Event {
    Character(Character, u32),
    Silence(u32),
    Answer(Vec<u8>),
}

/// The bridge's end of a line for Modbus RTU, and the master's.
#[derive(Clone, Debug)]
pub struct RtuDouble {
    waiting: VecDeque<(Character, u32)>,
    /// For how long nothing has come, in microseconds.
    pub silence_us: u32,
    events: Vec<Event>,
    /// Events are more than answers.
    is_overheard: bool,
}

impl Default for RtuDouble {
    fn default() -> Self {
        Self { waiting: VecDeque::new(), silence_us: SILENCE_US, events: Vec::new(), is_overheard: false }
    }
}

/// Long enough to end a frame.
const SILENCE_US: u32 = 100_000;

/// A frame with its checksum.
#[must_use]
pub fn sealed(body: &[u8]) -> Vec<u8> {
    [body, &crc(body).to_le_bytes()].concat()
}

impl RtuDouble {
    /// A line that begins now, and remembers all that the bridge sees of it.
    pub(crate) fn overheard() -> Self {
        Self { silence_us: 0, is_overheard: true, ..Self::default() }
    }

    /// Brings a character, so long after the one before.
    pub(crate) fn bring(&mut self, character: Character, silence_us: u32) {
        self.silence_us = 0;
        self.waiting.push_back((character, silence_us));
    }

    /// Brings bytes, one right behind the other, after the silence that has been.
    pub fn put(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let silence_us = self.silence_us;
            self.bring(Character::Byte(*byte), silence_us);
        }
    }

    /// Lets a millisecond pass.
    pub fn pass_ms(&mut self) {
        self.silence_us = self.silence_us.saturating_add(1_000);
    }

    /// Brings a request without its checksum. The line is silent before it, and behind it.
    pub fn ask(&mut self, request: &[u8]) {
        self.silence_us = SILENCE_US;
        self.put(&sealed(request));
        self.silence_us = SILENCE_US;
        self.events.clear();
    }

    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// The last answer, with its unit and checksum.
    pub fn answer(&mut self) -> Option<Vec<u8>> {
        match self.events.pop()? {
            Event::Answer(frame) => Some(frame),
            _ => None,
        }
    }

    /// The register in it, if it is an answer to a question for one.
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
