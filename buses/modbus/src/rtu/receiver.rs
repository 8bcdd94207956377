//! Frame detection from characters and silences.

use core::hash::{Hash, Hasher};
use core::ops::Range;

use super::{CRC_LEN, MAX_FRAME_LEN, Timing, crc};
use crate::Function;

/// A character received from the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Character {
    /// A byte without line errors.
    Byte(u8),
    /// A parity or framing error, or an overrun before this character. The frame that contains it is invalid.
    Damaged,
}

/// Rules for silence within a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// By the specification: more than T1.5 inside a frame invalidates it, T3.5 ends it.
    Strict,
    /// For masters that pause inside a frame, such as a PC with a USB adapter. Ignores T1.5. After T3.5, a frame with a
    /// valid checksum is complete. A request for this unit that is shorter than its function requires may continue
    /// until the character time-out.
    Tolerant {
        /// Longest pause inside a frame for this unit, in microseconds.
        character_timeout_us: u32,
    },
}

/// Reason for discarding received characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Damage {
    /// Silence of more than T1.5 inside the frame.
    Silence,
    /// A damaged or lost character.
    Character,
    /// Fewer than 4 or more than 256 bytes.
    Length,
    /// A checksum that does not match.
    Checksum,
}

/// Characters received between two silences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received<'a> {
    /// An intact frame, for any unit.
    Frame {
        /// Address of the unit; 0 for a broadcast.
        unit: u8,
        /// Request PDU: a function code at least.
        pdu: &'a [u8],
    },
    /// An intact frame as above, with stray characters around it; see [`Receiver`].
    FrameAmongStrays {
        /// Address of the unit; 0 for a broadcast.
        unit: u8,
        /// Request PDU: a function code at least.
        pdu: &'a [u8],
        /// Number of stray characters before and after the frame.
        strays: u16,
    },
    /// Discarded characters, with the reason.
    Damaged(Damage),
}

/// Detects frames from characters and the silences between them.
///
/// The caller measures silence in microseconds, from the end of one character to the end of the next, less one
/// character time. Pass it to [`Receiver::push`] with each character, and to [`Receiver::silence`] while none arrives.
///
/// A transceiver that switches over may add characters to a frame: 00h, FFh or a break. Up to 8 such strays before a
/// request, and any number after it, are ignored and counted, if the length of the request follows from its function and
/// byte count, and its checksum over that length is correct.
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
    // Placed first with `repr(C)`: saves an instruction per character.
    bytes: [u8; MAX_FRAME_LEN],
    unit: u8,
    mode: Mode,
    timing: Timing,
    /// Number of bytes received, including bytes beyond the buffer. [`GIVEN`] if the frame was
    /// returned and makes room for the next.
    len: usize,
    /// First damage.
    damage: Option<Damage>,
    /// Where a frame may start and must end, because of damage among the strays before it and after that.
    sound: Range<usize>,
    /// First character of the frame after the one returned.
    carried: Option<Character>,
}

/// Hashes pending characters only, not those already returned.
impl Hash for Receiver {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { bytes: _, unit, mode, timing, len, damage, sound, carried } = self;
        let held = if *len == GIVEN { &[] } else { self.held() };
        (unit, mode, timing, held, carried).hash(state);
        damage.map(|damage| (damage, sound)).filter(|_| *len != GIVEN).hash(state);
    }
}

/// Larger than any number of received bytes, so that one comparison shows whether the buffer has room.
const GIVEN: usize = usize::MAX;

/// Value of `sound` without damage.
const INTACT: Range<usize> = 0..usize::MAX;

/// Maximum number of strays before a frame.
const MAX_LEADING_STRAYS: usize = 8;

impl Receiver {
    /// Creates a receiver for this unit. It also returns frames for other units.
    #[must_use]
    pub const fn new(unit: u8, mode: Mode, timing: Timing) -> Self {
        Self {
            unit,
            mode,
            timing,
            bytes: [0; MAX_FRAME_LEN],
            len: 0,
            damage: None,
            sound: INTACT,
            carried: None,
        }
    }

    /// Changes unit and mode. The new values also apply to a frame in progress.
    pub const fn configure(&mut self, unit: u8, mode: Mode) {
        self.unit = unit;
        self.mode = mode;
    }

    /// Processes a character and the silence before it. Returns the frame that the silence ended, if any.
    #[inline]
    pub fn push(&mut self, character: Character, silence_us: u32) -> Option<Received<'_>> {
        // Fast path: nearly every character continues a frame without a pause.
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
                self.note(Damage::Silence);
            }
        }
        self.take(character);
        None
    }

    /// Processes a silence that is still going on. Returns the frame that it ended, if any.
    pub fn silence(&mut self, silence_us: u32) -> Option<Received<'_>> {
        self.make_room();
        if self.len > 0 && self.is_over(silence_us) { Some(self.give()) } else { None }
    }

    /// Returns whether no character is pending, so that silence cannot end a frame.
    #[must_use]
    pub const fn is_idle(&self) -> bool {
        matches!(self.len, 0 | GIVEN) && self.carried.is_none()
    }

    /// Discards all pending characters. Call it after changing the line settings.
    pub const fn reset(&mut self) {
        self.begin();
        self.carried = None;
    }

    const fn begin(&mut self) {
        self.len = 0;
        self.damage = None;
        self.sound = INTACT;
    }

    fn make_room(&mut self) {
        if self.len == GIVEN {
            self.begin();
            if let Some(character) = self.carried.take() {
                self.take(character);
            }
        }
    }

    fn take(&mut self, character: Character) {
        let byte = match character {
            Character::Byte(byte) => byte,
            Character::Damaged => {
                self.note(Damage::Character);
                DAMAGED
            }
        };
        match self.bytes.get_mut(self.len) {
            Some(place) => *place = byte,
            None => self.note(Damage::Length),
        }
        // Noise without pauses must not reach `GIVEN`.
        self.len = self.len.saturating_add(1).min(GIVEN - 1);
    }

    /// Notes damage of the next character, or of the pause before it. Among the strays before a frame, damage does not affect
    /// the frame.
    fn note(&mut self, damage: Damage) {
        self.damage = self.damage.or(Some(damage));
        if self.len <= MAX_LEADING_STRAYS && self.held().iter().all(is_stray) {
            self.sound.start = self.len.saturating_add(usize::from(damage == Damage::Character));
        } else {
            self.sound.end = self.sound.end.min(self.len);
        }
    }

    /// Returns whether this silence ends the frame in progress.
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

    /// Returns whether the pending characters are the undamaged start of a request for this unit.
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
        let held = self.bytes.get(..len).unwrap_or(&self.bytes);
        // Fast path: nearly every frame is undamaged, and its last byte cannot be a stray 00h.
        if self.damage.is_none()
            && let [unit, pdu @ .., _, last] = held
            && !pdu.is_empty()
            && *last != 0
            && crc(held) == 0
        {
            return Received::Frame { unit: *unit, pdu };
        }
        self.give_in_doubt(len)
    }

    #[inline(never)]
    fn give_in_doubt(&self, len: usize) -> Received<'_> {
        let held = self.bytes.get(..len).unwrap_or(&self.bytes);
        // The checksum over an intact frame and any number of 00h is 0, too, so the length decides first.
        if len <= MAX_FRAME_LEN
            && let Some(frame) = without_strays(held, &self.sound)
            && let [unit, pdu @ .., _, _] = frame
        {
            let unit = *unit;
            return match len.saturating_sub(frame.len()) as u16 {
                0 => Received::Frame { unit, pdu },
                strays => Received::FrameAmongStrays { unit, pdu, strays },
            };
        }
        if let Some(damage) = self.damage {
            return Received::Damaged(damage);
        }
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

/// The byte stored for a damaged character. Never 00h, which would be the address of a broadcast.
const DAMAGED: u8 = 0xFF;

/// Returns whether a transceiver that switches over may have caused this byte.
fn is_stray(byte: &u8) -> bool {
    matches!(*byte, 0x00 | 0xFF)
}

/// Returns the request between strays: of the length that its function and byte count determine, with its checksum. It
/// starts with the first byte, because 00h is the address of a broadcast, or with the first that is no stray.
#[inline(never)]
fn without_strays<'a>(held: &'a [u8], sound: &Range<usize>) -> Option<&'a [u8]> {
    let leading = held.iter().take(MAX_LEADING_STRAYS).take_while(|byte| is_stray(byte)).count();
    [0, leading].into_iter().find_map(|start| {
        let rest = held.get(start..)?;
        let (frame, trailing) = rest.split_at_checked(least_len(rest))?;
        let is_sound = start >= sound.start && start.saturating_add(frame.len()) <= sound.end;
        (is_sound && trailing.iter().all(is_stray) && is_intact(frame)).then_some(frame)
    })
}

/// Returns whether the frame ends with its checksum, low byte first. The CRC over a frame including its checksum is 0
/// only if the checksum is correct.
fn is_intact(frame: &[u8]) -> bool {
    frame.len() > CRC_LEN && crc(frame) == 0
}

/// Returns the length of the request, as far as its first bytes determine it. It is the minimum for functions of variable
/// length.
fn least_len(held: &[u8]) -> usize {
    let counted = |head: usize, at: usize| {
        let count = held.get(at).copied().unwrap_or(0);
        head.saturating_add(count.into()).saturating_add(CRC_LEN)
    };
    match held.get(1).copied().and_then(Function::from_code) {
        None | Some(Function::ReportServerId) => 2 + CRC_LEN,
        Some(Function::WriteMultipleCoils | Function::WriteMultipleRegisters) => counted(7, 6),
        Some(Function::ReadWriteMultipleRegisters) => counted(11, 10),
        Some(Function::WriteFileRecord) => counted(3, 2),
        Some(Function::MaskWriteRegister) => 8 + CRC_LEN,
        Some(Function::EncapsulatedInterfaceTransport) => 5 + CRC_LEN,
        Some(_) => 6 + CRC_LEN,
    }
}
