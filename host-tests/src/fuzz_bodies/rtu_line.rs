//! Matches the bridge's answers on a Modbus RTU line with their requests.
//!
//! Independent of the bridge's framing: every answer needs a request, an intact frame for its unit between two
//! silences of T3.5, or fragments of one with pauses below BUS_CHAR_TIMEOUT. Strays of a transceiver may surround it.

use bus_modbus::rtu::{Character, Timing};

use crate::rtu_double::Event;

/// The responding unit of a line, and the handling of silences there.
#[derive(Clone, Copy)]
pub(super) struct Way {
    pub(super) unit: u8,
    /// Pauses below this do not end a frame. With 0, T3.5 ends it and T1.5 invalidates it.
    pub(super) character_timeout_us: u32,
}

impl Way {
    pub(super) const fn is_strict(self) -> bool {
        self.character_timeout_us == 0
    }
}

/// A received character.
#[derive(Clone, Copy)]
pub(super) struct Heard {
    /// `None` if it was damaged.
    pub(super) byte: Option<u8>,
    /// Whether the pause before it invalidates a frame that it is inside of.
    pub(super) after_pause: bool,
}

impl Heard {
    /// Returns whether a transceiver that switches over may have caused it.
    fn is_stray(&self) -> bool {
        self.byte.is_none_or(|byte| matches!(byte, 0x00 | 0xFF))
    }
}

/// Returns the intact frame in these characters: one with strays before or after it that has the length of its request,
/// or else all of them.
pub(super) fn frame_in(received: &[Heard]) -> Option<Vec<u8>> {
    let leading = received.iter().take(8).take_while(|it| it.is_stray()).count();
    let requested = [0, leading].into_iter().find_map(|from| {
        let bytes: Vec<u8> = received[from..].iter().map(|it| it.byte.unwrap_or(0xFF)).collect();
        let to = from + request_len(&bytes);
        received.get(to..)?.iter().all(Heard::is_stray).then(|| intact(&received[from..to])).flatten()
    });
    requested.or_else(|| intact(received)).filter(|_| received.len() <= 256)
}

fn intact(received: &[Heard]) -> Option<Vec<u8>> {
    let is_paused = received.iter().skip(1).any(|it| it.after_pause);
    let frame: Vec<u8> = received.iter().map(|it| it.byte).collect::<Option<_>>()?;
    let (body, sum) = frame.split_last_chunk::<2>()?;
    (!is_paused && body.len() > 1 && checksum(body) == *sum).then_some(frame)
}

/// Computes the specification's polynomial bit by bit.
pub(super) fn checksum(bytes: &[u8]) -> [u8; 2] {
    let mut value = 0xFFFF_u16;
    for byte in bytes {
        value ^= u16::from(*byte);
        for _ in 0..8 {
            value = if value & 1 == 1 { value >> 1 ^ 0xA001 } else { value >> 1 };
        }
    }
    value.to_le_bytes()
}

/// Returns the length of a request with unit and checksum, as the diagrams of the specification show it.
fn request_len(frame: &[u8]) -> usize {
    let count = |at: usize| frame.get(at).copied().map_or(0, usize::from);
    match frame.get(1).copied().unwrap_or(0) {
        1..=6 | 8 => 8,
        15 | 16 => 9 + count(6),
        21 => 5 + count(2),
        22 => 10,
        23 => 13 + count(10),
        43 => 7,
        _ => 4,
    }
}

/// Characters without a silence of T3.5 in between.
#[derive(Default)]
struct Piece {
    /// Whether the pause before it was too short to end a frame.
    joins: bool,
    received: Vec<Heard>,
}

/// Candidates for requests on a line.
pub(super) struct Requests {
    timing: Timing,
    /// Complete fragments since the last answered request.
    ended: Vec<Piece>,
    current: Option<Piece>,
}

impl Requests {
    pub(super) const fn new(timing: Timing) -> Self {
        Self { timing, ended: Vec::new(), current: None }
    }

    /// Processes the next event of the line. Returns whether a fragment has ended.
    pub(super) fn listen(&mut self, event: &Event, way: Way) -> bool {
        match *event {
            Event::Character(character, silence_us) => {
                let has_ended = silence_us >= self.timing.t3_5_us && self.end_piece();
                let begins = self.current.is_none();
                let joins = silence_us < way.character_timeout_us;
                let piece = self.current.get_or_insert_with(|| Piece { joins, ..Piece::default() });
                let after_pause = way.is_strict() && !begins && silence_us > self.timing.t1_5_us;
                let byte = match character {
                    Character::Byte(byte) => Some(byte),
                    Character::Damaged => None,
                };
                piece.received.push(Heard { byte, after_pause });
                has_ended
            }
            Event::Silence(silence_us) => silence_us >= self.timing.t3_5_us && self.end_piece(),
            Event::Answer(_) => false,
        }
    }

    fn end_piece(&mut self) -> bool {
        let Some(piece) = self.current.take() else { return false };
        if !piece.joins {
            self.ended.clear();
        }
        self.ended.push(piece);
        true
    }

    /// Returns the PDU of the frame for this unit formed by the last fragments, if any.
    pub(super) fn request(&self, unit: u8) -> Option<Vec<u8>> {
        (0..self.ended.len()).find_map(|from| {
            let (first, others) = self.ended[from..].split_first()?;
            let joined = others.iter().all(|piece| piece.joins);
            let received = [first].into_iter().chain(others).flat_map(|piece| &piece.received);
            let frame = frame_in(&received.copied().collect::<Vec<_>>()).filter(|_| joined)?;
            (frame[0] == unit).then(|| frame[1..frame.len() - 2].to_vec())
        })
    }

    /// Returns whether the last fragment may continue an earlier one.
    pub(super) fn may_go_on(&self) -> bool {
        self.ended.last().is_some_and(|piece| piece.joins)
    }

    /// Returns the request that this answers, and the PDU of the answer.
    pub(super) fn answered<'a>(&mut self, answer: &'a [u8], unit: u8) -> (Vec<u8>, &'a [u8]) {
        let (body, sum) = answer.split_last_chunk().expect("an answer has a checksum");
        assert_eq!(checksum(body), *sum, "{answer:02X?}");
        let request = self.request(unit).expect("an answer to no request for this unit");
        self.ended.clear();
        assert!(body.len() > 1 && body[0] == unit, "{answer:02X?}");
        assert_eq!(body[1] & 0x7F, request[0] & 0x7F, "the function of the request");
        (request, &body[1..])
    }
}
