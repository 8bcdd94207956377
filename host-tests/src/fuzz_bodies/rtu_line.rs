//! Matches the bridge's answers on a Modbus RTU line with their requests.
//!
//! Independent of the bridge's framing: every answer needs a request, an intact frame for its unit between two
//! silences of T3.5, or fragments of one with pauses below BUS_CHAR_TIMEOUT.

use bus_modbus::rtu::{Character, Timing};

use super::modbus::checksum;
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

/// Characters without a silence of T3.5 in between.
#[derive(Default)]
struct Piece {
    /// Whether the pause before it was too short to end a frame.
    joins: bool,
    bytes: Vec<u8>,
    void: bool,
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
                piece.void |= way.is_strict() && !begins && silence_us > self.timing.t1_5_us;
                match character {
                    Character::Byte(byte) => piece.bytes.push(byte),
                    Character::Damaged => piece.void = true,
                }
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
            let frame = [first].into_iter().chain(others).flat_map(|piece| &piece.bytes);
            let frame: Vec<u8> = frame.copied().collect();
            let (body, sum) = frame.split_last_chunk::<2>()?;
            let void = self.ended[from..].iter().any(|piece| piece.void) || frame.len() > 256;
            (joined && !void && body.len() > 1 && body[0] == unit && checksum(body) == *sum)
                .then(|| body[1..].to_vec())
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
