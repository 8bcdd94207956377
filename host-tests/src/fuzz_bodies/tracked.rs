//! Registers of the bridge as known to the PLC and to the computer on the service port: values that they wrote,
//! according to the answers (docs/registers.md, docs/commissioning.md).
//!
//! Broadcasts have no answers. They are tracked only on a strict line (BUS_CHAR_TIMEOUT 0), where each silence of
//! T3.5 ends a frame.

use bus_modbus::rtu::Timing;
use wsg_bridge_fw::registers::{self, COMMAND_KEY, Record};
use wsg_bridge_fw::{RECIPE_COUNT, Recipe};
use wsg_fieldbus::{CommandFlags, OutputImage};

use super::rtu_line::{Requests, Way};
use crate::operation::Port;
use crate::promises::Promises;
use crate::rtu_double::Event;

/// Silences on the bus and on the service port.
const BUS_TIMING: Timing = Timing::of(19_200, 11);
const SERVICE_TIMING: Timing = Timing::of(115_200, 10);

pub(super) const BROADCAST: u8 = 0;

/// Registers of the settings, followed by the tracked ones.
const SETTINGS: std::ops::Range<usize> = 100..100 + registers::SETTINGS.len();
const UNIT: usize = 100;
const BUS_TIMEOUT: usize = 101;
const BUS_REACTION: usize = 102;
const BUS_CHAR_TIMEOUT: usize = 103;
const BROADCASTS: usize = 104;
const SWAP_BYTES: usize = 105;
const DEBOUNCE: usize = 106;
const MIN_BUSY: usize = 107;
const HALF_FRAME: usize = 108;
pub(super) const FIRST_RECIPE: usize = 109;
pub(super) const BUS_RECIPE: usize = 173;

/// SAVE, RESTORE and DEFAULTS.
const COMMANDS: std::ops::Range<usize> = 200..205;
const SAVE: usize = 200;
const RESTORE: usize = 201;

/// Force Listen Only Mode, after which a unit neither answers nor acts.
const LISTEN_ONLY: [u8; 5] = [8, 0, 4, 0, 0];

const ILLEGAL_FUNCTION: u8 = 1;

pub(super) const fn timing(port: Port) -> Timing {
    match port {
        Port::Bus => BUS_TIMING,
        Port::Service => SERVICE_TIMING,
    }
}

/// Effect of an executed request.
pub(super) enum Done {
    /// Only activity of the requester.
    Activity,
    /// The PLC wrote this image; its commands use the recipe's values, if any.
    Image(OutputImage, Option<Recipe>),
    /// An effect that is not tracked.
    Unknown,
}

/// The registers as known on both lines.
pub(super) struct Tracked {
    /// The image as read over the bus.
    image: [u8; OutputImage::LEN],
    settings: Record,
    /// Settings after RESTORE, and after DEFAULTS.
    stored: Record,
    delivered: Record,
    /// Whether DEFAULTS was accepted; it takes effect at the end of the turn.
    resets: bool,
    /// Whether SAVE or DEFAULTS was accepted.
    is_saved: bool,
    bus: Requests,
    service: Requests,
}

impl Tracked {
    /// Creates the state of a bridge with these default settings.
    pub(super) fn new(delivered: &Record) -> Self {
        Self {
            image: [0; OutputImage::LEN],
            settings: *delivered,
            stored: *delivered,
            delivered: *delivered,
            resets: false,
            is_saved: false,
            bus: Requests::new(BUS_TIMING),
            service: Requests::new(SERVICE_TIMING),
        }
    }

    /// Returns the unit address on this line.
    pub(super) fn unit(&self, port: Port) -> u8 {
        match port {
            Port::Bus => self.setting(UNIT) as u8,
            Port::Service => 1,
        }
    }

    pub(super) fn timeout_ms(&self) -> u32 {
        self.setting(BUS_TIMEOUT).into()
    }

    /// Returns whether the silence of a bus that commands stops the motion (BUS_REACTION 1).
    pub(super) fn stops_at_silence(&self) -> bool {
        self.setting(BUS_REACTION) == 1
    }

    pub(super) fn min_busy_ms(&self) -> u32 {
        self.setting(MIN_BUSY).into()
    }

    fn recipes(&self) -> [Recipe; RECIPE_COUNT] {
        std::array::from_fn(|number| {
            let [width, speed, force, release] =
                std::array::from_fn(|n| self.setting(FIRST_RECIPE + 4 * number + n));
            Recipe { width: width as i16, speed, force: force as i16, release_width: release as i16 }
        })
    }

    /// Returns the settings loaded at the next start after a completed save; `None` without one.
    pub(super) fn saved(&self) -> Option<&Record> {
        self.is_saved.then_some(&self.stored)
    }

    /// Applies the settings to the promises, from the next turn on.
    pub(super) fn configure(&self, Promises { requests, reports, .. }: &mut Promises) {
        reports.frame_timeout_ms = self.setting(HALF_FRAME).into();
        requests.debounce_ms = self.setting(DEBOUNCE).into();
        requests.recipes = self.recipes();
        requests.refuses &= !self.is_saved;
    }

    pub(super) fn end_turn(&mut self) -> Done {
        if !std::mem::take(&mut self.resets) {
            return Done::Activity;
        }
        self.change_settings(|it| {
            it.settings = it.delivered;
            it.stored = it.delivered;
        })
    }

    fn setting(&self, register: usize) -> u16 {
        self.settings[register - SETTINGS.start]
    }

    fn way(&self, port: Port) -> Way {
        let character_timeout_ms = match port {
            Port::Bus => self.setting(BUS_CHAR_TIMEOUT),
            Port::Service => 50,
        };
        Way { unit: self.unit(port), character_timeout_us: u32::from(character_timeout_ms) * 1_000 }
    }

    /// Processes the next event of a line.
    pub(super) fn take(&mut self, port: Port, event: &Event) -> Option<Done> {
        let way = self.way(port);
        let requests = match port {
            Port::Bus => &mut self.bus,
            Port::Service => &mut self.service,
        };
        if let Event::Answer(answer) = event {
            let (request, answer) = requests.answered(answer, way.unit);
            return Some(self.take_answer(port, &request, answer));
        }
        // The service port supports no broadcasts; requests without an answer have no effect there.
        let has_ended = requests.listen(event, way) && port == Port::Bus;
        if has_ended { self.unanswered(way.unit) } else { None }
    }

    /// Processes a frame on the bus that may require no answer.
    fn unanswered(&mut self, unit: u8) -> Option<Done> {
        if self.bus.request(unit).is_some_and(|pdu| pdu == LISTEN_ONLY) {
            return Some(Done::Unknown);
        }
        if self.setting(BROADCASTS) == 0 {
            return None;
        }
        let pdu = self.bus.request(BROADCAST)?;
        if !matches!(pdu[0], 5 | 6 | 15 | 16 | 22) {
            return None;
        }
        // No answer shows whether a setting was accepted.
        let write = self.write(&pdu);
        if self.bus.may_go_on() || write.as_ref().is_some_and(|write| !write.is_of_image()) {
            return Some(Done::Unknown);
        }
        Some(self.carry_out(write).unwrap_or(Done::Activity))
    }

    /// Processes the answer to a request; both are PDUs.
    pub(super) fn take_answer(&mut self, port: Port, request: &[u8], answer: &[u8]) -> Done {
        let write = self.write(request);
        let is_of_image = write.as_ref().is_some_and(Write::is_of_image);
        let what = || format!("{port:?}: {answer:02X?} to {request:02X?}");
        if answer[0] & 0x80 == 0 {
            assert!(port == Port::Bus || !is_of_image, "the service port commands: {}", what());
            let done = self.carry_out(write);
            assert!(done.is_some() || !WRITES.contains(&request[0]), "carried out: {}", what());
            self.check_read(port, request, answer);
            return done.unwrap_or(Done::Activity);
        }
        // Settings are also rejected while the fingers move.
        assert!(port == Port::Service || !is_of_image, "refused: {}", what());
        assert!(!is_of_image || answer[1] == ILLEGAL_FUNCTION, "{}", what());
        Done::Activity
    }

    /// Checks that holding registers read back as written.
    fn check_read(&self, port: Port, request: &[u8], answer: &[u8]) {
        let [3, a1, a0, ..] = *request else { return };
        let words = answer[2..].chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
        for (at, value) in (usize::from(u16::from_be_bytes([a1, a0]))..).zip(words) {
            assert_eq!(Some(value), self.register(port, at), "{port:?}: register {at}");
        }
    }

    /// Returns the expected value of a holding register on this line.
    fn register(&self, port: Port, at: usize) -> Option<u16> {
        let mut image = self.image;
        if port == Port::Service && self.setting(SWAP_BYTES) != 0 {
            swap(&mut image);
        }
        match image.get(2 * at..2 * at + 2) {
            Some(pair) => Some(u16::from_be_bytes([pair[0], pair[1]])),
            None if COMMANDS.contains(&at) => Some(0),
            None => self.settings.get(at.checked_sub(SETTINGS.start)?).copied(),
        }
    }

    /// Returns the write requested by a PDU per the specification; `None` for any other or invalid request.
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
                let before = self.register(Port::Bus, at)?;
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

    /// Processes an image of a cyclic master. `held` has the flags that were 1 in its image before, unless no master wrote since the
    /// bus was lost. A flag of them that others have cleared has no effect, nor has a motion beside STOP/ACK.
    pub(super) fn take_cyclic(
        &mut self,
        mut image: OutputImage,
        held: Option<CommandFlags>,
    ) -> (OutputImage, Option<Recipe>) {
        if let Some(held) = held {
            let cleared = held - CommandFlags::from_bits_retain(self.image[0]);
            let mut ignored = cleared - CommandFlags::FASTSTOP;
            if cleared.intersects(CommandFlags::JOG) {
                // Both directions at once mean a stop.
                ignored |= CommandFlags::JOG;
            }
            if image.flags.contains(CommandFlags::STOP_ACK) {
                ignored |= CommandFlags::MOTIONS | CommandFlags::JOG;
            }
            image.flags -= ignored;
        }
        self.image = image.to_bytes();
        if self.setting(SWAP_BYTES) != 0 {
            swap(&mut self.image);
        }
        (image, self.recipe())
    }

    /// Returns the recipe of the bus, if it uses one.
    fn recipe(&self) -> Option<Recipe> {
        self.recipes().get(usize::from(self.setting(BUS_RECIPE))).copied()
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
            Write::Words(first, values) if COMMANDS.contains(&first) => {
                assert_eq!(values, [COMMAND_KEY], "the key of {first}");
                return Some(self.command(first));
            }
            Write::Words(first, values) if first >= SETTINGS.start => {
                return Some(self.change_settings(|it| {
                    it.settings[first - SETTINGS.start..][..values.len()].copy_from_slice(&values);
                }));
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
        Some(Done::Image(OutputImage::from_bytes(image), self.recipe()))
    }

    /// Executes SAVE, RESTORE or DEFAULTS. During SAVE and DEFAULTS, settings do not change.
    fn command(&mut self, register: usize) -> Done {
        assert!(!self.resets, "another command before DEFAULTS has completed");
        match register {
            SAVE => self.stored = self.settings,
            RESTORE => return self.change_settings(|it| it.settings = it.stored),
            _ => self.resets = true,
        }
        self.is_saved = true;
        Done::Activity
    }

    fn change_settings(&mut self, change: impl FnOnce(&mut Self)) -> Done {
        assert!(!self.resets, "settings changed before DEFAULTS has completed");
        let before = self.setting(SWAP_BYTES);
        change(self);
        if self.setting(SWAP_BYTES) != before {
            swap(&mut self.image);
        }
        let is_followed = self.setting(BROADCASTS) == 0 || self.way(Port::Bus).is_strict();
        if is_followed { Done::Activity } else { Done::Unknown }
    }
}

/// Functions with a write.
const WRITES: [u8; 6] = [5, 6, 15, 16, 22, 23];

/// A write to consecutive coils or registers.
enum Write {
    Coils(usize, Vec<bool>),
    Words(usize, Vec<u16>),
}

impl Write {
    fn is_of_image(&self) -> bool {
        matches!(self, Self::Coils(..) | Self::Words(..4, _))
    }
}

/// Returns whether these holding registers exist and are of one kind.
fn exist(first: usize, count: usize) -> bool {
    let last = first + count;
    let is_in = |range: &std::ops::Range<usize>| range.contains(&first) && last <= range.end;
    count > 0 && (last <= 4 || is_in(&SETTINGS) || is_in(&COMMANDS))
}

/// Swaps the bytes of WIDTH, SPEED and FORCELIMIT.
fn swap(image: &mut [u8; OutputImage::LEN]) {
    image.chunks_exact_mut(2).skip(1).for_each(<[u8]>::reverse);
}
