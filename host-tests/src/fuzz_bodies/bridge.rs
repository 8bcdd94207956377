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
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::registers::COMMAND_KEY;
use wsg_bridge_fw::storage::Page;
use wsg_bridge_fw::{BusConfig, Config, ControlSource, ResetCause, Station};
use wsg_fieldbus::CommandFlags;

use super::frames::repair_checksums;
use super::input::Input;
use super::modbus::sealed;
use super::tracked::{BROADCAST, BUS_RECIPE, Done, FIRST_RECIPE, Port, Tracked};
use super::whole::{Ends, FLAGS, PARAMETERS, WholeBridge};
use crate::flash_model::FlashModel;
use crate::promises::Promises;
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::BYTES_PER_MS;
use crate::world::boot;
use crate::world::can::CanDouble;

/// Recipes: width, speed, force and release width. The gripper rejects the last one.
const RECIPES: [[u16; 4]; 4] = [
    [12_00, 40_00, 30_00, 60_00],
    [33_00, 77_00, 55_00, 90_00],
    [20_00, 50_00, 40_00, 41_00],
    [20_00, 1, 40_00, 40_00],
];

/// Silences before a character: none, and around the two limits.
fn silences(port: Port) -> [u32; 6] {
    let Timing { t1_5_us, t3_5_us } = port.timing();
    [0, t1_5_us, t1_5_us + 1, t3_5_us - 1, t3_5_us, 60_000]
}

struct Model {
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
    let mut input = Input::new(data);
    let choice = input.byte();
    let mut model = Model::new(choice & 2 != 0, choice & 4 != 0, choice & 8 != 0);
    model.play(choice, &mut input);
    model.check_saved();
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

/// Starts a bridge. Returns it, and the settings of this start.
pub(super) fn start(delivered: &Config, flash: &mut FlashModel) -> (Station<CanDouble>, Config) {
    let can = CanBus::new(CanDouble::default(), BusOffPolicy::DEFAULT);
    let (station, _, config) = boot(delivered, flash, can, ResetCause::PowerOn);
    (station, config)
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

    /// Returns a write of registers 0 to 3.
    fn image_frame(&self, port: Port, flags: CommandFlags, parameters: [u16; 3]) -> Vec<u8> {
        let head = [self.tracked.unit(port), 16, 0, 0, 0, 4, 8, flags.bits(), 0];
        sealed(&[&head[..], &parameters.map(u16::to_be_bytes).concat()].concat())
    }

    fn line_of(&mut self, port: Port) -> &mut RtuDouble {
        match port {
            Port::Bus => &mut self.bus,
            Port::Service => &mut self.service,
        }
    }

    /// Puts a frame on a line, sometimes with a wrong bit, a damaged character or a pause.
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
            // Adds the silence that ends the frame; otherwise the next frame does.
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
            line.deliver(character, silence_us);
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

/// Maximum duration of a save in turns: an erase and a double word per four settings, in both pages.
pub(super) const SAVE_MS: u32 = 70;

/// Maximum wait of a FAST STOP for the previous frame on a slow line, in milliseconds.
const SLOW_DELAY_MS: u32 = 2;

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

    fn take(&mut self, op: u8, input: &mut Input<'_>) {
        let port = if op & 0x80 == 0 { Port::Bus } else { Port::Service };
        match op % 16 {
            3 => {
                self.forge(input.fewer_than(40));
            }
            4 => {
                let mut bytes = input.fewer_than(40).to_vec();
                repair_checksums(&mut bytes);
                self.forge(&bytes);
            }
            5 => self.forge_status(input),
            8 => {
                let count = usize::from(input.byte() % 24);
                for _ in 0..count {
                    let character =
                        if input.byte() == 0xFF { Character::Damaged } else { Character::Byte(input.byte()) };
                    self.line_of(port).deliver(character, input.pick(&silences(port)));
                }
            }
            9 => {
                let unit = input.pick(&[self.tracked.unit(port), BROADCAST, 5]);
                let frame = [&[unit], input.fewer_than(24)].concat();
                self.send(port, &sealed(&frame), input);
            }
            10 => {
                let frame = self.image_frame(port, input.pick(&FLAGS), input.pick(&PARAMETERS));
                self.send(port, &frame, input);
            }
            11 => {
                let unit = input.pick(&[self.tracked.unit(port), BROADCAST]);
                let pdu = settings_pdu(op >> 5 & 3, input);
                self.send(port, &sealed(&[&[unit], &pdu[..]].concat()), input);
            }
            12 => {
                let unit = input.pick(&[self.tracked.unit(port), BROADCAST]);
                let (coil, value) = (input.byte() % 66, input.pick(&[0, 0xFF, 1]));
                self.send(port, &sealed(&[unit, 5, 0, coil, value, 0]), input);
            }
            13 if input.byte() & 7 == 0 => {
                let first = input.byte() & 1;
                let frame = [self.tracked.unit(port), 3, 0, first, 0, 1 + input.byte() % 4];
                self.send(port, &sealed(&frame), input);
            }
            13 => {
                let [and, or] = [input.pick(&FLAGS).bits(), input.pick(&FLAGS).bits()];
                let frame = [self.tracked.unit(port), 22, 0, 0, and, 0xFF, or, 0];
                self.send(port, &sealed(&frame), input);
            }
            _ => {
                // An edge as a PLC writes it.
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
