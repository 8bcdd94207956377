//! A Modbus RTU master with its line to the bridge: the PLC's bus, and the service port.

use std::collections::VecDeque;

use bus_modbus::rtu::{Character, crc};
use wsg_bridge_fw::BusPort;

/// Unit address of the bridge.
const UNIT: u8 = 1;

/// Time after which the master gives up an unanswered request.
const TIMEOUT_US: u64 = 200_000;

/// A master. It sends one request at a time.
pub(super) struct Master {
    character_us: u64,
    now_us: u64,
    /// The line is silent since this time.
    quiet_us: u64,
    /// The request on the line, as the bridge receives it once the last character has ended.
    request: VecDeque<u8>,
    request_ends_us: u64,
    /// PDU of the unanswered request.
    pending: Option<Vec<u8>>,
    /// Answer of the bridge, with its end.
    answer: Option<(u64, Vec<u8>)>,
    /// Whether the bridge has answered in this turn.
    pub(super) has_answered: bool,
}

impl Master {
    /// Creates a master on a line where a character takes this time.
    pub(super) fn new(character_us: u64) -> Self {
        Self {
            character_us,
            now_us: 0,
            quiet_us: 0,
            request: VecDeque::new(),
            request_ends_us: 0,
            pending: None,
            answer: None,
            has_answered: false,
        }
    }

    /// Returns whether a request is pending.
    pub(super) fn is_busy(&self) -> bool {
        self.pending.is_some()
    }

    /// Sends a request.
    pub(super) fn send(&mut self, pdu: Vec<u8>) {
        self.request = [&[UNIT], &pdu[..]].concat().into();
        let checksum = crc(self.request.make_contiguous());
        self.request.extend(checksum.to_le_bytes());
        self.request_ends_us = self.now_us + self.request.len() as u64 * self.character_us;
        self.pending = Some(pdu);
    }

    /// Begins a turn. Returns the last request and the PDU of its answer, empty after a time-out.
    pub(super) fn turn(&mut self, now_us: u64) -> Option<(Vec<u8>, Vec<u8>)> {
        self.now_us = now_us;
        self.has_answered = false;
        if let Some((_, frame)) = self.answer.take_if(|(end_us, _)| now_us >= *end_us) {
            self.quiet_us = now_us;
            let pdu = frame.get(1..frame.len().saturating_sub(2)).unwrap_or_default();
            return Some((self.pending.take()?, pdu.to_vec()));
        }
        if self.pending.is_some() && now_us >= self.request_ends_us + TIMEOUT_US {
            self.request.clear();
            return Some((self.pending.take()?, Vec::new()));
        }
        None
    }

    /// Returns the request that the bridge has answered without an exception in this turn.
    pub(super) fn executed(&self) -> Option<&[u8]> {
        let (_, frame) = self.answer.as_ref().filter(|_| self.has_answered)?;
        let request = self.pending.as_deref()?;
        (frame.get(1) == request.first()).then_some(request)
    }
}

impl BusPort for Master {
    fn receive(&mut self) -> Option<(Character, u32)> {
        if self.now_us < self.request_ends_us {
            return None;
        }
        let byte = self.request.pop_front()?;
        let silence_us = self.silence_us();
        self.quiet_us = self.now_us;
        Some((Character::Byte(byte), silence_us))
    }

    fn silence_us(&mut self) -> u32 {
        u32::try_from(self.now_us - self.quiet_us).unwrap_or(u32::MAX)
    }

    fn send(&mut self, frame: &[u8]) {
        self.answer = Some((self.now_us + frame.len() as u64 * self.character_us, frame.to_vec()));
        self.has_answered = true;
    }
}

/// Returns a write of registers (FC 16).
pub(super) fn write(first: u16, values: &[u16]) -> Vec<u8> {
    let ([a1, a0], count) = (first.to_be_bytes(), values.len() as u8);
    let head = [16, a1, a0, 0, count, 2 * count];
    head.into_iter().chain(values.iter().flat_map(|value| value.to_be_bytes())).collect()
}

/// Returns a read of input registers (FC 4).
pub(super) fn read(first: u16, count: u8) -> Vec<u8> {
    let [a1, a0] = first.to_be_bytes();
    vec![4, a1, a0, 0, count]
}

/// Returns the registers in the PDU of an answer to a read or a request to write, from this byte on.
pub(super) fn words(pdu: &[u8], from: usize) -> impl Iterator<Item = u16> {
    pdu.get(from..).unwrap_or_default().chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]))
}
