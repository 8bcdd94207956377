//! The whole bridge between wires, a Modbus bus, the service port and the gripper's line: any bytes on all lines, any wires.
//!
//! What must hold, whatever comes:
//! - the [`Oracle`](super::oracle::Oracle)'s rules: a command leaves only for an edge of a wire, or of an image that an intact request wrote while the
//!   bus commanded; a FAST STOP leaves at once, or behind the frame that is being sent; the outputs are true;
//! - the watchdog may be fed;
//! - no frame with a wrong checksum leaves, on any line;
//! - each answer on the bus and the service port has its request, intact and for the bridge's unit ([`Overheard`]); what is
//!   damaged, or for another, does nothing;
//! - the service port commands nothing, and settings count the same whichever of the two wrote them: they read as they were
//!   written, recipes are what commands go by, and what was saved is what the next start finds;
//! - while stored settings are refused, nothing moves before others are stored.
//!
//! A case ends where that cannot be followed from outside: behind Force Listen Only Mode, a broadcast to the settings, and
//! when broadcasts count on a line that is not strict.

use bus_modbus::rtu::{Character, Timing};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::registers::{COMMAND_KEY, Record};
use wsg_bridge_fw::storage::Page;
use wsg_bridge_fw::{BoardId, BusConfig, Config, ResetCause, Station};
use wsg_fieldbus::CommandFlags;

use super::frames::repair_checksums;
use super::input::Input;
use super::modbus::sealed;
use super::overheard::{BROADCAST, BUS_RECIPE, Done, FIRST_RECIPE, Overheard, Port};
use super::whole::{Ends, FLAGS, PARAMETERS, WholeBridge};
use crate::can_bench::{Double, NO_PROFIBUS};
use crate::flash_model::FlashModel;
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::BYTES_PER_MS;

/// Recipes: width, speed, force and release width. One of them the gripper does not take.
const RECIPES: [[u16; 4]; 4] = [
    [12_00, 40_00, 30_00, 60_00],
    [33_00, 77_00, 55_00, 90_00],
    [20_00, 50_00, 40_00, 41_00],
    [20_00, 1, 40_00, 40_00],
];

/// Silences before a character: none, and around the two that matter.
fn silences(port: Port) -> [u32; 6] {
    let Timing { t1_5_us, t3_5_us } = port.timing();
    [0, t1_5_us, t1_5_us + 1, t3_5_us - 1, t3_5_us, 60_000]
}

struct Model {
    station: Station<Double>,
    flash: FlashModel,
    delivered: Record,
    bus: RtuDouble,
    service: RtuDouble,
    overheard: Overheard,
    /// When the PLC on the bus was heard last; none when it was not, or fell silent.
    heard_ms: Option<u32>,
    ends: Ends,
}

/// The first byte also says whether the bus is strict and has broadcasts (bit 1), whether the gripper's line takes no more than
/// it would at 115 200 bit/s (bit 2), and whether the stored settings are damaged (bit 3). Then each op is a byte that says what,
/// and bytes that say how: wires, time, bytes on any line, how the gripper answers, a PLC that writes. With bit 7 requests come
/// over the service port.
pub fn bridge(data: &[u8]) {
    let mut input = Input::new(data);
    let choice = input.byte();
    let mut model = Model::new(choice & 2 != 0, choice & 4 != 0, choice & 8 != 0);
    model.play(choice, &mut input);
    model.check_saved();
}

/// A request about settings: one of them, a recipe or BUS_RECIPE is written, or a command; they are read.
fn settings_pdu(how: u8, input: &mut Input<'_>) -> Vec<u8> {
    let byte = input.byte();
    match how {
        0 => vec![6, 0, 100 + byte % 90, 0, input.byte()],
        1 => {
            let first = FIRST_RECIPE as u8 + 4 * (byte % 16);
            let values = input.pick(&RECIPES).map(u16::to_be_bytes).concat();
            [&[16, 0, first, 0, 4, 8][..], &values].concat()
        }
        2 if byte < 0x80 => vec![6, 0, BUS_RECIPE as u8, 0, byte % 18],
        2 => vec![3, 0, 100 + byte % 82, 0, 1 + input.byte() % 82],
        _ => {
            let [high, low] = COMMAND_KEY.to_be_bytes();
            vec![6, 0, 200 + byte % 3, high, if byte < 0xF0 { low } else { 0 }]
        }
    }
}

impl Model {
    fn new(strict_with_broadcasts: bool, slow: bool, is_damaged: bool) -> Self {
        let mut config = Config::DEFAULT;
        if strict_with_broadcasts {
            config.bus = BusConfig { broadcast: true, character_timeout_ms: 0, ..config.bus };
        }
        let mut flash = FlashModel::new();
        if is_damaged {
            flash.set(Page::First, 3, None);
        }
        let delivered = config.record();
        let mut station = Station::new(CanBus::new(Double::default(), BusOffPolicy::DEFAULT), &NO_PROFIBUS);
        let config = station.load(&delivered, &flash).expect("they go together");
        station.start(&config, BoardId::UNKNOWN, ResetCause::PowerOn);
        let mut ends = Ends::new(&config, slow.then_some(BYTES_PER_MS));
        ends.oracle.asked.refuses = is_damaged;
        Self {
            station,
            flash,
            delivered,
            bus: RtuDouble::overheard(),
            service: RtuDouble::overheard(),
            overheard: Overheard::new(&delivered),
            heard_ms: None,
            ends,
        }
    }

    /// A write of registers 0 to 3.
    fn image_frame(&self, port: Port, flags: CommandFlags, parameters: [u16; 3]) -> Vec<u8> {
        let head = [self.overheard.unit(port), 16, 0, 0, 0, 4, 8, flags.bits(), 0];
        sealed(&[&head[..], &parameters.map(u16::to_be_bytes).concat()].concat())
    }

    fn line_of(&mut self, port: Port) -> &mut RtuDouble {
        match port {
            Port::Bus => &mut self.bus,
            Port::Service => &mut self.service,
        }
    }

    /// Puts a frame on a line, now and then with a wrong bit, a damaged character or a pause in it.
    fn send(&mut self, port: Port, frame: &[u8], input: &mut Input<'_>) {
        let mut frame = frame.to_vec();
        let trouble = input.byte();
        let at = usize::from(input.byte()) % frame.len();
        match trouble % 16 {
            0 => frame[at] ^= 1 << (trouble >> 5),
            1 => frame.truncate(at),
            _ => {}
        }
        let pause = (trouble % 16 == 2).then(|| (at, input.pick(&silences(port))));
        self.put(port, &frame, (trouble % 16 == 3).then_some(at), pause);
        if trouble & 0x80 == 0 {
            // The silence that ends it; else the next frame does.
            self.pass(3);
        }
    }

    fn put(&mut self, port: Port, frame: &[u8], damaged_at: Option<usize>, pause: Option<(usize, u32)>) {
        let line = self.line_of(port);
        for (at, byte) in frame.iter().enumerate() {
            let character = if damaged_at == Some(at) { Character::Damaged } else { Character::Byte(*byte) };
            let silence_us = match pause {
                Some((pause_at, silence_us)) if pause_at == at => silence_us,
                _ if at == 0 => line.silence_us.max(port.timing().t3_5_us),
                _ => 0,
            };
            line.bring(character, silence_us);
        }
    }

    /// What the service port did comes behind all else in a turn, and counts from the next on.
    fn serve(&mut self) {
        for event in self.service.take_events() {
            match self.overheard.take(Port::Service, &event) {
                None | Some(Done::Heard) => {}
                Some(Done::Image(..)) => unreachable!("it does not command"),
                Some(Done::Unknown) => self.ends.is_over = true,
            }
        }
        self.ends.is_over |= matches!(self.overheard.end_turn(), Done::Unknown);
        let Self { ends: Ends { oracle, .. }, overheard, .. } = self;
        oracle.told.frame_timeout_ms = overheard.frame_timeout_ms();
        oracle.asked.debounce_ms = overheard.debounce_ms();
        oracle.asked.recipes = overheard.recipes();
        oracle.asked.refuses &= overheard.saved().is_none();
    }

    /// What was saved is what the next start finds.
    fn check_saved(&mut self) {
        if self.ends.is_over || self.overheard.saved().is_none() {
            return;
        }
        self.pass(SAVE_MS);
        let mut station = Station::new(CanBus::new(Double::default(), BusOffPolicy::DEFAULT), &NO_PROFIBUS);
        let found = station.load(&self.delivered, &self.flash).map(|config| config.record());
        assert_eq!(found.as_ref().ok(), self.overheard.saved());
    }
}

/// How long a save takes at the most, in turns: an erase and a double word for four settings, the same again in the other page.
const SAVE_MS: u32 = 70;

/// How long a FAST STOP may wait there for the frame before it, in milliseconds.
const SLOW_PATIENCE_MS: u32 = 2;

impl WholeBridge for Model {
    fn ends(&mut self) -> &mut Ends {
        &mut self.ends
    }

    fn write_zeros(&mut self) {
        let zeros = self.image_frame(Port::Bus, CommandFlags::empty(), PARAMETERS[0]);
        self.put(Port::Bus, &zeros, None, None);
        self.pass(4);
    }

    fn passes_after(&self, _: u8) -> bool {
        true
    }

    fn turn(&mut self) {
        self.ends.now_ms += 1;
        self.bus.pass_ms();
        self.service.pass_ms();
        let Self { station, flash, bus, service, ends, .. } = self;
        let now_ms = ends.now_ms;
        let was_connected = station.bridge().is_connected();
        let outputs = station.turn(now_ms, ends.wires, ends.line.turn(), bus, service, flash);
        assert!(station.bridge().may_feed_watchdog(now_ms));
        ends.begin_turn();
        let Ends { oracle, is_over, .. } = ends;
        for event in self.bus.take_events() {
            match self.overheard.take(Port::Bus, &event) {
                None => continue,
                Some(Done::Heard) => {}
                Some(Done::Image(image, recipe)) => oracle.asked.take_image(image, recipe),
                Some(Done::Unknown) => *is_over = true,
            }
            self.heard_ms = Some(now_ms);
        }
        if *is_over {
            return;
        }
        oracle.shown.min_busy_ms = self.overheard.min_busy_ms();
        let timeout_ms = self.overheard.timeout_ms();
        if timeout_ms > 0 && self.heard_ms.is_some_and(|heard_ms| now_ms - heard_ms >= timeout_ms) {
            self.heard_ms = None;
            oracle.asked.lose_bus();
        }
        if was_connected && !self.station.bridge().is_connected() {
            ends.line.cut();
        }
        let patience_ms = if ends.line.is_slow() { SLOW_PATIENCE_MS } else { 1 };
        ends.end_turn(outputs, patience_ms);
        self.serve();
    }

    fn take(&mut self, op: u8, input: &mut Input<'_>) {
        let port = if op & 0x80 == 0 { Port::Bus } else { Port::Service };
        match op % 16 {
            3 => {
                let count = usize::from(input.byte() % 40);
                self.forge(input.bytes(count));
            }
            4 => {
                let count = usize::from(input.byte() % 40);
                let mut bytes = input.bytes(count).to_vec();
                repair_checksums(&mut bytes);
                self.forge(&bytes);
            }
            5 => self.forge_status(input),
            8 => {
                let count = usize::from(input.byte() % 24);
                for _ in 0..count {
                    let character =
                        if input.byte() == 0xFF { Character::Damaged } else { Character::Byte(input.byte()) };
                    self.line_of(port).bring(character, input.pick(&silences(port)));
                }
            }
            9 => {
                let unit = input.pick(&[self.overheard.unit(port), BROADCAST, 5]);
                let count = usize::from(input.byte() % 24);
                let frame = [&[unit], input.bytes(count)].concat();
                self.send(port, &sealed(&frame), input);
            }
            10 => {
                let frame = self.image_frame(port, input.pick(&FLAGS), input.pick(&PARAMETERS));
                self.send(port, &frame, input);
            }
            11 => {
                let unit = input.pick(&[self.overheard.unit(port), BROADCAST]);
                let pdu = settings_pdu(op >> 5 & 3, input);
                self.send(port, &sealed(&[&[unit], &pdu[..]].concat()), input);
            }
            12 => {
                let unit = input.pick(&[self.overheard.unit(port), BROADCAST]);
                let (coil, value) = (input.byte() % 66, input.pick(&[0, 0xFF, 1]));
                self.send(port, &sealed(&[unit, 5, 0, coil, value, 0]), input);
            }
            13 if input.byte() & 7 == 0 => {
                let first = input.byte() & 1;
                let frame = [self.overheard.unit(port), 3, 0, first, 0, 1 + input.byte() % 4];
                self.send(port, &sealed(&frame), input);
            }
            13 => {
                let [and, or] = [input.pick(&FLAGS).bits(), input.pick(&FLAGS).bits()];
                let frame = [self.overheard.unit(port), 22, 0, 0, and, 0xFF, or, 0];
                self.send(port, &sealed(&frame), input);
            }
            _ => {
                // An edge as a PLC gives it.
                let parameters = input.pick(&PARAMETERS);
                for flags in [CommandFlags::empty(), input.pick(&FLAGS)] {
                    let frame = self.image_frame(Port::Bus, flags, parameters);
                    self.put(Port::Bus, &frame, None, None);
                    self.pass(4);
                }
            }
        }
    }
}
