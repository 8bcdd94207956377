//! The whole bridge between wires, a Modbus bus, the service port and the gripper's line, with arbitrary bytes and
//! wires.
//!
//! Properties:
//! - the [`Promises`]: commands follow only edges of wires, or of images that an intact
//!   request wrote while the bus had control; FAST STOP is sent at once or after the frame in progress; the outputs
//!   are true
//! - the watchdog may be fed
//! - every frame sent on any line has a correct checksum
//! - each answer on the bus and the service port belongs to an intact request for the bridge's unit ([`Tracked`]);
//!   damaged requests and those for others have no effect
//! - the service port commands nothing. Settings from either port are equivalent: they read back as written, recipes
//!   apply to commands, and saved settings are loaded at the next start
//! - while stored settings are rejected, nothing moves until others are stored
//!
//! A case ends when the effects are invisible from outside: after Force Listen Only Mode, after a broadcast to the
//! settings, and with broadcasts enabled on a line that is not strict.

use bus_modbus::rtu::{Character, Timing};
use wsg_bridge_fw::registers::COMMAND_KEY;
use wsg_bridge_fw::storage::Page;
use wsg_bridge_fw::{BusConfig, Config, ControlSource, Station};
use wsg_fieldbus::{CommandFlags, OutputImage};

use super::input::Input;
use super::modbus::sealed;
use super::tracked::{BROADCAST, BUS_RECIPE, Done, FIRST_RECIPE, Tracked, timing};
use super::whole::{self, Ends, FLAGS, PARAMETERS, WholeBridge};
use super::whole::{pick_answer, pick_characters, pick_edge, pick_image, pick_noise};
use crate::flash_model::FlashModel;
use crate::operation::{Operation, Port, TelegramFault, Unit, image};
use crate::promises::Promises;
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::BYTES_PER_MS;
use crate::world::can::CanDouble;
use crate::world::modbus::{registers_of, write_request};
use crate::world::start;

/// Recipes: width, speed, force and release width. The gripper rejects the last one.
const RECIPES: [[u16; 4]; 4] = [
    [12_00, 40_00, 30_00, 60_00],
    [33_00, 77_00, 55_00, 90_00],
    [20_00, 50_00, 40_00, 41_00],
    [20_00, 1, 40_00, 40_00],
];

/// Silences before a character: none, and around the two limits.
fn silences(port: Port) -> [u32; 6] {
    let Timing { t1_5_us, t3_5_us } = timing(port);
    [0, t1_5_us, t1_5_us + 1, t3_5_us - 1, t3_5_us, 60_000]
}

pub(super) struct Model {
    station: Station<CanDouble>,
    flash: FlashModel,
    delivered: Config,
    bus: RtuDouble,
    service: RtuDouble,
    tracked: Tracked,
    /// Time of the PLC's last activity on the bus; `None` while it is inactive.
    received_ms: Option<u32>,
    ends: Ends,
}

/// The first byte also selects a strict bus with broadcasts (bit 1), a gripper line limited to 115 200 bit/s (bit 2),
/// and damaged stored settings (bit 3). Each further op is a byte with parameter bytes: wires, time, bytes on any
/// line, gripper replies, PLC writes. Bit 7 selects the service port.
pub fn bridge(data: &[u8]) {
    whole::run::<Model>(data);
}

/// Returns a write of registers 0 to 3.
pub(super) fn image_pdu(image: &OutputImage) -> Vec<u8> {
    write_request(0, &registers_of(image)).split_off(1)
}

/// Returns a request that writes a setting, a recipe, BUS_RECIPE or a command, or reads settings.
pub(super) fn settings_pdu(how: u8, input: &mut Input<'_>) -> Vec<u8> {
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
        let mut delivered = Config::DEFAULT;
        if strict_with_broadcasts {
            delivered.bus = BusConfig { broadcast: true, character_timeout_ms: 0, ..delivered.bus };
        }
        let mut flash = FlashModel::new();
        if is_damaged {
            flash = FlashModel::with_record(1, &delivered.record());
            flash.set(Page::First, 3, None);
        }
        let (station, config) = start(&delivered, &mut flash);
        let mut ends = Ends::new(&config, slow.then_some(BYTES_PER_MS));
        ends.promises.requests.refuses = is_damaged;
        Self {
            station,
            flash,
            delivered,
            bus: RtuDouble::overheard(),
            service: RtuDouble::overheard(),
            tracked: Tracked::new(&delivered.record()),
            received_ms: None,
            ends,
        }
    }

    /// Returns a request to this unit.
    fn frame(&self, port: Port, unit: Unit, pdu: &[u8]) -> Vec<u8> {
        let unit = match unit {
            Unit::Own => self.tracked.unit(port),
            Unit::Broadcast => BROADCAST,
            Unit::Other => OTHER,
        };
        sealed(&[&[unit], pdu].concat())
    }

    fn line_of(&mut self, port: Port) -> &mut RtuDouble {
        match port {
            Port::Bus => &mut self.bus,
            Port::Service => &mut self.service,
        }
    }

    /// Puts a frame on a line.
    fn put(&mut self, port: Port, frame: &[u8], fault: TelegramFault) {
        let silence_us = self.line_of(port).silence_us.max(timing(port).t3_5_us);
        self.put_characters(port, &fault.characters(frame, silence_us));
    }

    fn put_characters(&mut self, port: Port, characters: &[(Option<u8>, u32)]) {
        for (byte, silence_us) in characters {
            let character = byte.map_or(Character::Damaged, Character::Byte);
            self.line_of(port).deliver(character, *silence_us);
        }
    }

    /// Processes the service port, which runs last in a turn and takes effect from the next turn on.
    fn serve(&mut self) {
        for event in self.service.take_events() {
            match self.tracked.take(Port::Service, &event) {
                None | Some(Done::Activity) => {}
                Some(Done::Image(..)) => unreachable!("the service port does not command"),
                Some(Done::Unknown) => self.ends.is_over = true,
            }
        }
        self.ends.is_over |= matches!(self.tracked.end_turn(), Done::Unknown);
        self.tracked.configure(&mut self.ends.promises);
    }

    /// Checks that the next start loads the saved settings.
    fn check_saved(&mut self) {
        if self.ends.is_over || self.tracked.saved().is_none() {
            return;
        }
        self.pass(SAVE_MS);
        let (_, found) = start(&self.delivered, &mut self.flash);
        assert_eq!(Some(&found.record()), self.tracked.saved());
    }
}

/// Address of a unit that does not exist.
const OTHER: u8 = 5;

/// Maximum duration of a save in turns: an erase and a double word per four settings, in both pages.
pub(super) const SAVE_MS: u32 = 70;

/// Maximum wait of a FAST STOP for the previous frame on a slow line, in milliseconds.
const SLOW_DELAY_MS: u32 = 2;

impl WholeBridge for Model {
    const NAME: &'static str = "bridge";

    fn start(choice: u8) -> Self {
        Self::new(choice & 2 != 0, choice & 4 != 0, choice & 8 != 0)
    }

    fn end(mut self) {
        self.check_saved();
    }

    fn ends(&mut self) -> &mut Ends {
        &mut self.ends
    }

    fn write_zeros(&mut self) {
        self.execute(&Operation::Write(image(CommandFlags::empty(), PARAMETERS[0])));
        self.pass(4);
    }

    fn passes_after(_: u8) -> bool {
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
        let received = ends.line.take_received();
        ends.begin_turn(&received);
        let Ends { promises: Promises { requests, levels, .. }, is_over, .. } = ends;
        for event in self.bus.take_events() {
            match self.tracked.take(Port::Bus, &event) {
                None => continue,
                Some(Done::Activity) => {}
                Some(Done::Image(image, recipe)) => requests.take_image(image, recipe),
                Some(Done::Unknown) => *is_over = true,
            }
            self.received_ms = Some(now_ms);
        }
        if *is_over {
            return;
        }
        levels.min_busy_ms = self.tracked.min_busy_ms();
        let timeout_ms = self.tracked.timeout_ms();
        if timeout_ms > 0 && self.received_ms.is_some_and(|received_ms| now_ms - received_ms >= timeout_ms) {
            self.received_ms = None;
            let commands = station.bridge().control_source() == ControlSource::Bus;
            requests.lose_bus(commands && self.tracked.stops_at_silence());
        }
        if was_connected && !self.station.bridge().is_connected() {
            ends.line.cut();
        }
        let max_delay_ms = if ends.line.is_slow() { SLOW_DELAY_MS } else { 1 };
        ends.end_turn(self.station.bridge(), outputs, Some(max_delay_ms));
        self.serve();
    }

    fn decode(op: u8, input: &mut Input<'_>, script: &mut Vec<Operation>) {
        let port = if op & 0x80 == 0 { Port::Bus } else { Port::Service };
        let (unit, pdu) = match op % 16 {
            3 | 4 => return script.push(pick_noise(input, op % 16 == 4)),
            5 => return script.push(pick_answer(input)),
            8 => {
                let characters = pick_characters(input, &silences(port));
                return script.push(Operation::Characters(port, characters));
            }
            9 => {
                let unit = input.pick(&[Unit::Own, Unit::Broadcast, Unit::Other]);
                (unit, input.fewer_than(24).to_vec())
            }
            10 => (Unit::Own, image_pdu(&pick_image(input))),
            11 => {
                let unit = input.pick(&[Unit::Own, Unit::Broadcast]);
                (unit, settings_pdu(op >> 5 & 3, input))
            }
            12 => {
                let unit = input.pick(&[Unit::Own, Unit::Broadcast]);
                (unit, coil_pdu(input))
            }
            13 => (Unit::Own, flags_pdu(input)),
            _ => {
                let edge = pick_edge(input).map(|image| [Operation::Write(image), Operation::Pass(4)]);
                return script.extend(edge.into_iter().flatten());
            }
        };
        let (how, at) = (input.byte(), input.byte());
        let fault = TelegramFault::of(how, at, || input.pick(&silences(port)));
        script.push(Operation::Modbus { port, unit, pdu, fault });
        if how & 0x80 == 0 {
            // Adds the silence that ends the frame; otherwise the next frame does.
            script.push(Operation::Pass(3));
        }
    }

    fn execute(&mut self, operation: &Operation) {
        match operation {
            Operation::Write(image) => {
                let frame = self.frame(Port::Bus, Unit::Own, &image_pdu(image));
                self.put(Port::Bus, &frame, TelegramFault::Intact);
            }
            Operation::Modbus { port, unit, pdu, fault } => {
                let frame = self.frame(*port, *unit, pdu);
                self.put(*port, &frame, *fault);
            }
            Operation::Characters(port, characters) => self.put_characters(*port, characters),
            other => whole::cannot(other),
        }
    }
}

/// Returns a write of a coil.
pub(super) fn coil_pdu(input: &mut Input<'_>) -> Vec<u8> {
    vec![5, 0, input.byte() % 66, input.pick(&[0, 0xFF, 1]), 0]
}

/// Returns a read of the image, or a change of its flags (FC 22).
pub(super) fn flags_pdu(input: &mut Input<'_>) -> Vec<u8> {
    if input.byte() & 7 == 0 {
        return vec![3, 0, input.byte() & 1, 0, 1 + input.byte() % 4];
    }
    let [and, or] = [input.pick(&FLAGS), input.pick(&FLAGS)];
    vec![22, 0, 0, and.bits(), 0xFF, or.bits(), 0]
}
