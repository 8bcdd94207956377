//! The bus's line as a bridge has it, and the requests that must be behind what the bridge does on it.
//!
//! Nothing is known here of how the bridge finds a frame: every answer must have its request, an intact frame for its unit
//! between two silences of T3.5, or pieces of one with pauses below BUS_CHAR_TIMEOUT between them. Broadcasts have no answers, so
//! they are followed on a strict line alone (BUS_CHAR_TIMEOUT 0), where each silence of T3.5 ends a frame.

use std::collections::VecDeque;

use bus_modbus::rtu::{Character, Timing};
use wsg_bridge_fw::{BusPort, Config, RECIPE_COUNT, RECIPES, Recipe};
use wsg_protocol::fieldbus::OutputImage;

use super::modbus::checksum;

pub(super) const TIMING: Timing = Timing::of(19_200, 11);
pub(super) const BROADCAST: u8 = 0;

/// Settings are registers from here on; these are followed (docs/registers.md).
const SETTINGS: std::ops::Range<usize> = 100..182;
const UNIT: usize = 100;
const BUS_TIMEOUT: usize = 101;
const BUS_CHAR_TIMEOUT: usize = 103;
const BROADCASTS: usize = 104;
const SWAP_BYTES: usize = 105;
const DEBOUNCE: usize = 106;
const MIN_BUSY: usize = 107;
const HALF_FRAME: usize = 108;
const FIRST_RECIPE: usize = 109;

const BUS_RECIPE: usize = 173;
const NO_RECIPE: u16 = 16;
/// SAVE, RESTORE and DEFAULTS.
const COMMANDS: std::ops::Range<usize> = 200..203;

/// Force Listen Only Mode, behind which a unit says nothing and does nothing.
const LISTEN_ONLY: [u8; 5] = [8, 0, 4, 0, 0];

/// What the bridge saw of the line and did on it.
pub(super) enum Event {
    Character(Character, u32),
    Silence(u32),
    Answer(Vec<u8>),
}

/// The bridge's end of the line.
#[derive(Default)]
pub(super) struct RtuLine {
    waiting: VecDeque<(Character, u32)>,
    silence_us: u32,
    events: Vec<Event>,
}

impl RtuLine {
    /// Brings a character, so long after the one before.
    pub(super) fn bring(&mut self, character: Character, silence_us: u32) {
        self.silence_us = 0;
        self.waiting.push_back((character, silence_us));
    }

    pub(super) fn pass_ms(&mut self) {
        self.silence_us = self.silence_us.saturating_add(1_000);
    }

    /// For how long nothing has come.
    pub(super) fn silence_us(&self) -> u32 {
        self.silence_us
    }

    pub(super) fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }
}

impl BusPort for RtuLine {
    fn receive(&mut self) -> Option<(Character, u32)> {
        let (character, silence_us) = self.waiting.pop_front()?;
        self.events.push(Event::Character(character, silence_us));
        Some((character, silence_us))
    }

    fn silence_us(&mut self) -> u32 {
        self.events.push(Event::Silence(self.silence_us));
        self.silence_us
    }

    fn send(&mut self, frame: &[u8]) {
        self.events.push(Event::Answer(frame.to_vec()));
    }
}

/// What a request that was carried out comes to.
pub(super) enum Done {
    /// The PLC was heard.
    Heard,
    /// It wrote this image.
    Image(OutputImage),
    /// Something that is not followed any further.
    Unknown,
}

/// Characters without a silence of T3.5 between them.
#[derive(Default)]
struct Piece {
    silence_us: u32,
    bytes: Vec<u8>,
    void: bool,
}

/// A PLC's view of the bridge: its registers, and the requests behind its answers.
pub(super) struct Overheard {
    image: [u8; OutputImage::LEN],
    settings: [u16; SETTINGS.end - SETTINGS.start],
    /// What RESTORE brings back.
    initial: [u16; SETTINGS.end - SETTINGS.start],
    /// The pieces that have ended, since the last request that was carried out.
    ended: Vec<Piece>,
    current: Option<Piece>,
}

impl Overheard {
    /// A bridge that was built so.
    pub(super) fn new(config: &Config) -> Self {
        let mut settings = [0; SETTINGS.end - SETTINGS.start];
        let built = [
            (UNIT, config.bus.unit.into()),
            (BUS_TIMEOUT, config.bus.timeout_ms),
            (BUS_CHAR_TIMEOUT, config.bus.character_timeout_ms),
            (BROADCASTS, config.bus.broadcast.into()),
            (SWAP_BYTES, config.bus.swap_bytes.into()),
            (DEBOUNCE, config.debounce_ms as u16),
            (MIN_BUSY, config.min_busy_ms as u16),
            (HALF_FRAME, config.half_frame_ms as u16),
        ];
        for (register, value) in built {
            settings[register - SETTINGS.start] = value;
        }
        // What counts from a start on is not followed, but that it reads as it was written.
        settings[BUS_RECIPE - SETTINGS.start..]
            .copy_from_slice(&config.record()[BUS_RECIPE - SETTINGS.start..]);
        for (place, recipe) in settings[FIRST_RECIPE - SETTINGS.start..BUS_RECIPE - SETTINGS.start]
            .chunks_exact_mut(4)
            .zip(RECIPES)
        {
            let Recipe { width, speed, force, release_width } = recipe;
            place.copy_from_slice(&[width as u16, speed, force as u16, release_width as u16]);
        }
        Self { image: [0; OutputImage::LEN], settings, initial: settings, ended: Vec::new(), current: None }
    }

    pub(super) fn unit(&self) -> u8 {
        self.setting(UNIT) as u8
    }

    pub(super) fn timeout_ms(&self) -> u32 {
        self.setting(BUS_TIMEOUT).into()
    }

    pub(super) fn debounce_ms(&self) -> u32 {
        self.setting(DEBOUNCE).into()
    }

    pub(super) fn min_busy_ms(&self) -> u32 {
        self.setting(MIN_BUSY).into()
    }

    pub(super) fn frame_timeout_ms(&self) -> u32 {
        self.setting(HALF_FRAME).into()
    }

    pub(super) fn recipes(&self) -> [Recipe; RECIPE_COUNT] {
        std::array::from_fn(|number| {
            let [width, speed, force, release] =
                std::array::from_fn(|n| self.setting(FIRST_RECIPE + 4 * number + n));
            Recipe { width: width as i16, speed, force: force as i16, release_width: release as i16 }
        })
    }

    fn setting(&self, register: usize) -> u16 {
        self.settings[register - SETTINGS.start]
    }

    fn character_timeout_us(&self) -> u32 {
        u32::from(self.setting(BUS_CHAR_TIMEOUT)) * 1_000
    }

    fn is_strict(&self) -> bool {
        self.character_timeout_us() == 0
    }

    /// Takes what happened next on the line.
    pub(super) fn take(&mut self, event: Event) -> Option<Done> {
        match event {
            Event::Character(character, silence_us) => {
                let done = if silence_us >= TIMING.t3_5_us { self.end_piece() } else { None };
                let (strict, begins) = (self.is_strict(), self.current.is_none());
                let piece = self.current.get_or_insert_with(|| Piece { silence_us, ..Piece::default() });
                piece.void |= strict && !begins && silence_us > TIMING.t1_5_us;
                match character {
                    Character::Byte(byte) => piece.bytes.push(byte),
                    Character::Damaged => piece.void = true,
                }
                done
            }
            Event::Silence(silence_us) if silence_us >= TIMING.t3_5_us => self.end_piece(),
            Event::Silence(_) => None,
            Event::Answer(answer) => Some(self.take_answer(&answer)),
        }
    }

    /// A piece has ended, and may be what is never answered.
    fn end_piece(&mut self) -> Option<Done> {
        let piece = self.current.take()?;
        if piece.silence_us >= self.character_timeout_us() {
            self.ended.clear();
        }
        self.ended.push(piece);
        if self.request(self.unit()).is_some_and(|pdu| pdu == LISTEN_ONLY) {
            return Some(Done::Unknown);
        }
        if self.setting(BROADCASTS) == 0 {
            return None;
        }
        let pdu = self.request(BROADCAST)?;
        if !matches!(pdu[0], 5 | 6 | 15 | 16 | 22) {
            return None;
        }
        // Whether a setting was taken shows in no answer.
        let write = self.write(&pdu);
        if write.as_ref().is_some_and(|write| !write.is_of_image()) {
            return Some(Done::Unknown);
        }
        Some(self.carry_out(write).unwrap_or(Done::Heard))
    }

    /// The PDU of the frame for this unit that the last pieces are, if they are one.
    fn request(&self, unit: u8) -> Option<Vec<u8>> {
        let character_timeout_us = self.character_timeout_us();
        (0..self.ended.len()).find_map(|from| {
            let (first, others) = self.ended[from..].split_first()?;
            let joined = others.iter().all(|piece| piece.silence_us < character_timeout_us);
            let frame = [first].into_iter().chain(others).flat_map(|piece| &piece.bytes);
            let frame: Vec<u8> = frame.copied().collect();
            let (body, sum) = frame.split_last_chunk::<2>()?;
            let void = self.ended[from..].iter().any(|piece| piece.void) || frame.len() > 256;
            (joined && !void && body.len() > 1 && body[0] == unit && checksum(body) == *sum)
                .then(|| body[1..].to_vec())
        })
    }

    fn take_answer(&mut self, answer: &[u8]) -> Done {
        let unit = self.unit();
        let (body, sum) = answer.split_last_chunk().expect("an answer has a checksum");
        assert_eq!(checksum(body), *sum, "{answer:02X?}");
        let request = self.request(unit).expect("an answer to no request for this unit");
        self.ended.clear();
        assert!(body.len() > 1 && body[0] == unit, "{answer:02X?}");
        assert_eq!(body[1] & 0x7F, request[0] & 0x7F, "the function of the request");
        let write = self.write(&request);
        if body[1] & 0x80 == 0 {
            let done = self.carry_out(write);
            assert!(done.is_some() || !WRITES.contains(&request[0]), "{request:02X?} was carried out");
            return done.unwrap_or(Done::Heard);
        }
        // Settings are refused while the fingers move as well.
        assert!(!write.is_some_and(|write| write.is_of_image()), "{request:02X?} was refused");
        Done::Heard
    }

    /// The write that a request asks for, as the specification draws it; none if it is none, or no good one.
    fn write(&self, pdu: &[u8]) -> Option<Write> {
        let word = |high, low| u16::from_be_bytes([high, low]);
        let words = |bytes: &[u8]| bytes.chunks_exact(2).map(|pair| word(pair[0], pair[1])).collect();
        let write = match *pdu {
            [5, a1, a0, value @ (0 | 0xFF), 0] => Write::Coils(word(a1, a0).into(), vec![value != 0]),
            [6, a1, a0, v1, v0] => Write::Words(word(a1, a0).into(), vec![word(v1, v0)]),
            [15, a1, a0, q1, q0, count, ref bytes @ ..] => {
                let quantity = usize::from(word(q1, q0));
                let bits =
                    (0..quantity).map(|n| bytes.get(n / 8).is_some_and(|byte| byte >> (n % 8) & 1 != 0));
                let agrees = usize::from(count) == bytes.len() && bytes.len() == quantity.div_ceil(8);
                agrees.then(|| Write::Coils(word(a1, a0).into(), bits.collect()))?
            }
            [16, a1, a0, q1, q0, count, ref bytes @ ..]
            | [23, _, _, _, _, a1, a0, q1, q0, count, ref bytes @ ..] => {
                let agrees =
                    usize::from(count) == bytes.len() && bytes.len() == 2 * usize::from(word(q1, q0));
                agrees.then(|| Write::Words(word(a1, a0).into(), words(bytes)))?
            }
            [22, a1, a0, and1, and0, or1, or0] => {
                let (at, and, or) = (usize::from(word(a1, a0)), word(and1, and0), word(or1, or0));
                let before = match self.image.get(2 * at..2 * at + 2) {
                    Some(pair) => word(pair[0], pair[1]),
                    None if COMMANDS.contains(&at) => 0,
                    None => *self.settings.get(at.checked_sub(SETTINGS.start)?)?,
                };
                Write::Words(at, vec![before & and | or & !and])
            }
            _ => return None,
        };
        let reads =
            matches!(*pdu, [23, r1, r0, q1, q0, ..] if !exist(word(r1, r0).into(), word(q1, q0).into()));
        let (first, count, bits) = match &write {
            Write::Coils(first, values) => (*first, values.len(), true),
            Write::Words(first, values) => (*first, values.len(), false),
        };
        let is_there =
            if bits { (1..=64).contains(&count) && first + count <= 64 } else { exist(first, count) };
        (is_there && !reads).then_some(write)
    }

    fn carry_out(&mut self, write: Option<Write>) -> Option<Done> {
        match write? {
            Write::Coils(first, values) => {
                for (at, value) in (first..).zip(values) {
                    let mask = 1 << (at % 8);
                    self.image[at / 8] =
                        if value { self.image[at / 8] | mask } else { self.image[at / 8] & !mask };
                }
            }
            Write::Words(first, values) if first >= SETTINGS.start => {
                let before = self.setting(SWAP_BYTES);
                if first == COMMANDS.start + 1 {
                    self.settings = self.initial;
                } else if !COMMANDS.contains(&first) {
                    self.settings[first - SETTINGS.start..][..values.len()].copy_from_slice(&values);
                }
                if self.setting(BUS_RECIPE) != NO_RECIPE {
                    return Some(Done::Unknown);
                }
                if self.setting(SWAP_BYTES) != before {
                    swap(&mut self.image);
                }
                let is_followed = self.setting(BROADCASTS) == 0 || self.is_strict();
                return Some(if is_followed { Done::Heard } else { Done::Unknown });
            }
            Write::Words(first, values) => {
                for (pair, value) in self.image.chunks_exact_mut(2).skip(first).zip(values) {
                    pair.copy_from_slice(&value.to_be_bytes());
                }
            }
        }
        let mut image = self.image;
        if self.setting(SWAP_BYTES) != 0 {
            swap(&mut image);
        }
        Some(Done::Image(OutputImage::from_bytes(image)))
    }
}

/// Functions that write.
const WRITES: [u8; 6] = [5, 6, 15, 16, 22, 23];

/// Coils or registers from an address on, and what they shall be.
enum Write {
    Coils(usize, Vec<bool>),
    Words(usize, Vec<u16>),
}

impl Write {
    fn is_of_image(&self) -> bool {
        matches!(self, Self::Coils(..) | Self::Words(..4, _))
    }
}

/// Whether there are such holding registers, all of one kind.
fn exist(first: usize, count: usize) -> bool {
    let last = first + count;
    let is_in = |range: &std::ops::Range<usize>| range.contains(&first) && last <= range.end;
    count > 0 && (last <= 4 || is_in(&SETTINGS) || is_in(&COMMANDS))
}

/// Turns the bytes of WIDTH, SPEED and FORCELIMIT round.
fn swap(image: &mut [u8; OutputImage::LEN]) {
    image.chunks_exact_mut(2).skip(1).for_each(<[u8]>::reverse);
}
