//! From characters and silences to frames.

use core::hash::{Hash, Hasher};

use super::{CRC_LEN, MAX_FRAME_LEN, Timing, crc};
use crate::Function;

/// What the line brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Character {
    /// A byte.
    Byte(u8),
    /// A parity or framing error, or a character that was lost before this one: the frame around it is void.
    Damaged,
}

/// How strictly silence is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// As the specification asks: more than T1.5 inside a frame voids it, T3.5 ends it.
    Strict,
    /// For masters that pause inside a frame, such as a PC behind a USB adapter. T1.5 is not looked at. At T3.5 a frame
    /// with a right checksum is complete; one for this unit that is shorter than its function asks for may go on until
    /// the line was silent for so long, in microseconds.
    Tolerant {
        /// The longest pause inside a frame for this unit.
        character_timeout_us: u32,
    },
}

/// Why what was received is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Damage {
    /// Silence of more than T1.5 inside it.
    Silence,
    /// A damaged or lost character.
    Character,
    /// Below 4 or above 256 bytes.
    Length,
    /// The checksum is wrong.
    Checksum,
}

/// What was received between two silences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received<'a> {
    /// A frame: the unit that it is for, and its PDU.
    Frame {
        /// The address, 0 for a broadcast.
        unit: u8,
        /// At least the function code.
        pdu: &'a [u8],
    },
    /// None.
    Damaged(Damage),
}

/// Finds frames in characters and in the silences between them.
///
/// The caller measures silence, in microseconds from the end of one character to the end of the next, less one
/// character's time; [`Receiver::push`] gets that before each character, [`Receiver::silence`] while none comes.
///
/// ```
/// use bus_modbus::rtu::{Character, Mode, Received, Receiver, Timing};
///
/// let mut receiver = Receiver::new(17, Mode::Strict, Timing::of(19_200, 11));
/// for byte in [0x11, 0x03, 0x00, 0x6B, 0x00, 0x03, 0x76, 0x87] {
///     assert_eq!(receiver.push(Character::Byte(byte), 0), None);
/// }
/// assert_eq!(receiver.silence(1_000), None, "not over yet");
/// let pdu: &[u8] = &[0x03, 0x00, 0x6B, 0x00, 0x03];
/// assert_eq!(receiver.silence(2_010), Some(Received::Frame { unit: 17, pdu }));
/// assert_eq!(receiver.silence(9_999), None, "once");
/// ```
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Receiver {
    // First, and `repr(C)`: an instruction less for every character.
    bytes: [u8; MAX_FRAME_LEN],
    unit: u8,
    mode: Mode,
    timing: Timing,
    /// Bytes received, also those that no longer fit; [`GIVEN`] when what was received was given, and makes room for
    /// the next.
    len: usize,
    damage: Option<Damage>,
    /// The first character of the frame after the one that was given.
    carried: Option<Character>,
}

/// By what is held and not by what was.
impl Hash for Receiver {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { bytes: _, unit, mode, timing, len, damage, carried } = self;
        let held = if *len == GIVEN { &[] } else { self.held() };
        (unit, mode, timing, held, carried).hash(state);
        damage.filter(|_| *len != GIVEN).hash(state);
    }
}

/// Longer than anything that is received, so that one comparison says whether there is room.
const GIVEN: usize = usize::MAX;

impl Receiver {
    /// A receiver for this unit; frames for others are found as well.
    #[must_use]
    pub const fn new(unit: u8, mode: Mode, timing: Timing) -> Self {
        Self { unit, mode, timing, bytes: [0; MAX_FRAME_LEN], len: 0, damage: None, carried: None }
    }

    /// Changes unit and mode. What is being received is judged by the new ones.
    pub const fn configure(&mut self, unit: u8, mode: Mode) {
        self.unit = unit;
        self.mode = mode;
    }

    /// Takes a character and the silence before it. Gives what the silence has ended, if it has.
    #[inline]
    pub fn push(&mut self, character: Character, silence_us: u32) -> Option<Received<'_>> {
        // Nearly every character is one more byte of a frame, right behind the one before.
        if silence_us <= self.timing.t1_5_us
            && let Character::Byte(byte) = character
            && let Some(place) = self.bytes.get_mut(self.len)
        {
            *place = byte;
            self.len = self.len.wrapping_add(1);
            return None;
        }
        self.push_any(character, silence_us)
    }

    #[inline(never)]
    fn push_any(&mut self, character: Character, silence_us: u32) -> Option<Received<'_>> {
        self.make_room();
        if self.len > 0 {
            if self.is_over(silence_us) {
                self.carried = Some(character);
                return Some(self.give());
            }
            if self.mode == Mode::Strict && silence_us > self.timing.t1_5_us {
                self.damage = self.damage.or(Some(Damage::Silence));
            }
        }
        self.take(character);
        None
    }

    /// Takes notice that no character has come for so long. Gives what the silence has ended, if it has.
    pub fn silence(&mut self, silence_us: u32) -> Option<Received<'_>> {
        self.make_room();
        if self.len > 0 && self.is_over(silence_us) { Some(self.give()) } else { None }
    }

    /// Whether nothing is held, so that no silence can end it.
    #[must_use]
    pub const fn is_idle(&self) -> bool {
        matches!(self.len, 0 | GIVEN) && self.carried.is_none()
    }

    /// Forgets what was received, for a caller who has changed the line.
    pub const fn reset(&mut self) {
        self.len = 0;
        self.damage = None;
        self.carried = None;
    }

    fn make_room(&mut self) {
        if self.len == GIVEN {
            self.len = 0;
            self.damage = None;
            if let Some(character) = self.carried.take() {
                self.take(character);
            }
        }
    }

    fn take(&mut self, character: Character) {
        let byte = match character {
            Character::Byte(byte) => byte,
            Character::Damaged => {
                self.damage = self.damage.or(Some(Damage::Character));
                0
            }
        };
        match self.bytes.get_mut(self.len) {
            Some(place) => *place = byte,
            None => self.damage = self.damage.or(Some(Damage::Length)),
        }
        // Noise that never pauses.
        self.len = self.len.saturating_add(1).min(GIVEN - 1);
    }

    /// Whether silence has ended what is held.
    #[inline(always)]
    fn is_over(&self, silence_us: u32) -> bool {
        if silence_us < self.timing.t3_5_us {
            return false;
        }
        match self.mode {
            Mode::Strict => true,
            Mode::Tolerant { character_timeout_us } => {
                silence_us >= character_timeout_us || !self.may_go_on()
            }
        }
    }

    /// Whether what is held is the undamaged begin of a request for this unit.
    #[inline(never)]
    fn may_go_on(&self) -> bool {
        let held = self.held();
        self.damage.is_none()
            && held.first() == Some(&self.unit)
            && held.len() < least_len(held)
            && !is_intact(held)
    }

    fn held(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or(&self.bytes)
    }

    fn give(&mut self) -> Received<'_> {
        let len = core::mem::replace(&mut self.len, GIVEN);
        if let Some(damage) = self.damage {
            return Received::Damaged(damage);
        }
        let held = self.bytes.get(..len).unwrap_or(&self.bytes);
        match held {
            [unit, pdu @ .., _, _] if !pdu.is_empty() => {
                if is_intact(held) {
                    Received::Frame { unit: *unit, pdu }
                } else {
                    Received::Damaged(Damage::Checksum)
                }
            }
            _ => Received::Damaged(Damage::Length),
        }
    }
}

/// Whether the checksum at the end, low byte first, is right: with the right one behind it, and with no other, the
/// checksum of the whole is 0.
fn is_intact(frame: &[u8]) -> bool {
    frame.len() > CRC_LEN && crc(frame) == 0
}

/// How long a request that begins like this is at the least, as far as it shows.
fn least_len(held: &[u8]) -> usize {
    let counted = |head: usize, at: usize| {
        let count = held.get(at).copied().unwrap_or(0);
        head.saturating_add(count.into()).saturating_add(CRC_LEN)
    };
    match held.get(1).copied().and_then(Function::from_code) {
        None | Some(Function::ReportServerId) => 2 + CRC_LEN,
        Some(Function::WriteMultipleCoils | Function::WriteMultipleRegisters) => counted(7, 6),
        Some(Function::ReadWriteMultipleRegisters) => counted(11, 10),
        Some(Function::MaskWriteRegister) => 8 + CRC_LEN,
        Some(Function::EncapsulatedInterfaceTransport) => 5 + CRC_LEN,
        Some(_) => 6 + CRC_LEN,
    }
}
