//! A line for Modbus RTU in virtual time, with a master at its other end that asks one thing after another.

use std::collections::VecDeque;

use bus_modbus::rtu::{Character, crc};
use wsg_bridge_fw::BusPort;

/// The bridge's end of a line for Modbus RTU, and the master's.
#[derive(Default)]
pub struct RtuDouble {
    waiting: VecDeque<(Character, u32)>,
    answers: Vec<Vec<u8>>,
}

impl RtuDouble {
    /// Brings a request, without its checksum.
    pub fn ask(&mut self, request: &[u8]) {
        let mut silence_us = 100_000;
        for byte in request.iter().copied().chain(crc(request).to_le_bytes()) {
            self.waiting.push_back((Character::Byte(byte), std::mem::take(&mut silence_us)));
        }
        self.answers.clear();
    }

    /// The last answer, with its unit and checksum.
    pub fn answer(&mut self) -> Option<Vec<u8>> {
        self.answers.pop()
    }

    /// The register in it, if it is an answer to a question for one.
    pub fn answered(&mut self) -> Option<u16> {
        match self.answers.pop()?[..] {
            [_, _, 2, high, low, ..] => Some(u16::from_be_bytes([high, low])),
            _ => None,
        }
    }
}

impl BusPort for RtuDouble {
    fn receive(&mut self) -> Option<(Character, u32)> {
        self.waiting.pop_front()
    }

    fn silence_us(&mut self) -> u32 {
        100_000
    }

    fn send(&mut self, frame: &[u8]) {
        self.answers.push(frame.to_vec());
    }
}
