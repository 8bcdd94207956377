//! The whole bridge between wires, a Modbus bus, the service port and the gripper's line: any bytes on all lines, any wires.
//!
//! What must hold, whatever comes:
//! - the [`Oracle`]'s rules: a command leaves only for an edge of a wire, or of an image that an intact request wrote while the
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

use std::convert::Infallible;

use bus_modbus::rtu::{Character, Timing};
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::registers::{COMMAND_KEY, Record};
use wsg_bridge_fw::storage::Page;
use wsg_bridge_fw::{BoardId, BusConfig, Config, ResetCause, Station};
use wsg_fieldbus::CommandFlags;
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{CommandId, FrameParser, Status};

use super::frames::repair_checksums;
use super::gripper::{self, Gripper, Message};
use super::input::Input;
use super::modbus::sealed;
use super::oracle::Oracle;
use super::overheard::{BROADCAST, BUS_RECIPE, Done, FIRST_RECIPE, Overheard, Port};
use super::rtu_line::RtuLine;
use crate::can_bench::{Double, NO_PROFIBUS};
use crate::flash_model::FlashModel;
use crate::serial_gripper::{BYTES_PER_MS, SerialLine};

pub(super) const MOTION_WIRES: [Inputs; 4] = [Inputs::GRIP, Inputs::RELEASE, Inputs::MOVE, Inputs::HOME];

/// Flags that a PLC writes: one motion, a jog, a stop, several at once.
pub(super) const FLAGS: [CommandFlags; 12] = [
    CommandFlags::empty(),
    CommandFlags::MOVE,
    CommandFlags::GRIP,
    CommandFlags::RELEASE,
    CommandFlags::HOMING,
    CommandFlags::STOP_ACK,
    CommandFlags::FASTSTOP,
    CommandFlags::JOG_PLUS,
    CommandFlags::JOG_MINUS,
    CommandFlags::MOVE.union(CommandFlags::GRIP),
    CommandFlags::GRIP.union(CommandFlags::STOP_ACK),
    CommandFlags::all(),
];

/// WIDTH, SPEED and FORCELIMIT: two that a gripper takes, and one that it does not.
pub(super) const PARAMETERS: [[u16; 3]; 3] =
    [[20_00, 50_00, 40_00], [50_00, 100_00, 40_00], [20_00, 1, 40_00]];

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
    line: GripperLine,
    bus: RtuLine,
    service: RtuLine,
    now_ms: u32,
    wires: Inputs,
    overheard: Overheard,
    /// When the PLC on the bus was heard last; none when it was not, or fell silent.
    heard_ms: Option<u32>,
    /// What comes cannot be followed.
    is_over: bool,
    gripper: Gripper,
    oracle: Oracle,
}

/// The first byte says whether the bridge is ready (bit 0), whether the bus is strict and has broadcasts (bit 1), whether the
/// gripper's line takes no more than it would at 115 200 bit/s (bit 2), whether the stored settings are damaged (bit 3), and
/// whether the fingers move at power-up (bit 4). Then each op is a byte that says what, and bytes that say how: wires, time,
/// bytes on any line, how the gripper answers, a PLC that writes. With bit 7 requests come over the service port.
pub fn bridge(data: &[u8]) {
    let mut input = Input::new(data);
    let choice = input.byte();
    let mut model = Model::new(choice & 2 != 0, choice & 4 != 0, choice & 8 != 0);
    if choice & 16 != 0 {
        model.gripper.run();
    }
    if choice & 1 != 0 {
        model.get_ready();
    }
    while !input.is_empty() && !model.is_over {
        let op = input.byte();
        let port = if op & 0x80 == 0 { Port::Bus } else { Port::Service };
        match op % 16 {
            0 | 1 => model.wires = Inputs::from_bits_retain(input.byte()),
            2 => model.wires = input.pick(&MOTION_WIRES) | Inputs::FAST_STOP_OK,
            3 => {
                let count = usize::from(input.byte() % 40);
                model.bring_to_bridge(input.bytes(count));
            }
            4 => {
                let count = usize::from(input.byte() % 40);
                let mut bytes = input.bytes(count).to_vec();
                repair_checksums(&mut bytes);
                model.bring_to_bridge(&bytes);
            }
            5 => {
                let status = input.pick(&[
                    Status::Success,
                    Status::CmdPending,
                    Status::CmdFailed,
                    Status::AccessDenied,
                ]);
                model.bring_to_bridge(&gripper::status(input.pick(CommandId::ALL), status));
            }
            6 => model.gripper.change(model.now_ms, &mut input),
            7 => model.pass(u32::from(input.byte() % 32)),
            8 => {
                let count = usize::from(input.byte() % 24);
                for _ in 0..count {
                    let character =
                        if input.byte() == 0xFF { Character::Damaged } else { Character::Byte(input.byte()) };
                    model.line_of(port).bring(character, input.pick(&silences(port)));
                }
            }
            9 => {
                let unit = input.pick(&[model.overheard.unit(port), BROADCAST, 5]);
                let count = usize::from(input.byte() % 24);
                let frame = [&[unit], input.bytes(count)].concat();
                model.send(port, &sealed(&frame), &mut input);
            }
            10 => {
                let frame = model.image_frame(port, input.pick(&FLAGS), input.pick(&PARAMETERS));
                model.send(port, &frame, &mut input);
            }
            11 => {
                let unit = input.pick(&[model.overheard.unit(port), BROADCAST]);
                let pdu = settings_pdu(op >> 5 & 3, &mut input);
                model.send(port, &sealed(&[&[unit], &pdu[..]].concat()), &mut input);
            }
            12 => {
                let unit = input.pick(&[model.overheard.unit(port), BROADCAST]);
                let (coil, value) = (input.byte() % 66, input.pick(&[0, 0xFF, 1]));
                model.send(port, &sealed(&[unit, 5, 0, coil, value, 0]), &mut input);
            }
            13 if input.byte() & 7 == 0 => {
                let first = input.byte() & 1;
                let frame = [model.overheard.unit(port), 3, 0, first, 0, 1 + input.byte() % 4];
                model.send(port, &sealed(&frame), &mut input);
            }
            13 => {
                let [and, or] = [input.pick(&FLAGS).bits(), input.pick(&FLAGS).bits()];
                let frame = [model.overheard.unit(port), 22, 0, 0, and, 0xFF, or, 0];
                model.send(port, &sealed(&frame), &mut input);
            }
            14 => {
                // An edge as a PLC gives it.
                let parameters = input.pick(&PARAMETERS);
                for flags in [CommandFlags::empty(), input.pick(&FLAGS)] {
                    let frame = model.image_frame(Port::Bus, flags, parameters);
                    model.bring(Port::Bus, &frame, None, None);
                    model.pass(4);
                }
            }
            _ => model.pass(u32::from(input.byte())),
        }
        model.pass(1);
    }
    model.pass(10);
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
        let mut oracle = Oracle::new(&config);
        oracle.asked.refuses = is_damaged;
        Self {
            station,
            flash,
            delivered,
            line: GripperLine::new(if slow { BYTES_PER_MS } else { usize::MAX }),
            bus: RtuLine::default(),
            service: RtuLine::default(),
            now_ms: 0,
            wires: Inputs::empty(),
            overheard: Overheard::new(&delivered),
            heard_ms: None,
            is_over: false,
            gripper: Gripper::new(),
            oracle,
        }
    }

    /// What most of the interesting states lie behind: connected, FAST STOP acknowledged, a bus that has written zeros.
    fn get_ready(&mut self) {
        self.gripper.answer();
        self.wires = Inputs::FAST_STOP_OK;
        self.pass(12);
        self.wires = Inputs::FAST_STOP_OK | Inputs::STOP_ACK;
        let zeros = self.image_frame(Port::Bus, CommandFlags::empty(), PARAMETERS[0]);
        self.bring(Port::Bus, &zeros, None, None);
        self.pass(4);
        self.wires = Inputs::FAST_STOP_OK;
        self.pass(4);
        let shown = if self.oracle.asked.refuses { REFUSED } else { READY };
        assert_eq!(self.oracle.shown.outputs, shown);
    }

    /// Something that the gripper did not say.
    fn bring_to_bridge(&mut self, bytes: &[u8]) {
        self.gripper.forge(self.now_ms, bytes);
        self.line.bring(bytes);
    }

    /// A write of registers 0 to 3.
    fn image_frame(&self, port: Port, flags: CommandFlags, parameters: [u16; 3]) -> Vec<u8> {
        let head = [self.overheard.unit(port), 16, 0, 0, 0, 4, 8, flags.bits(), 0];
        sealed(&[&head[..], &parameters.map(u16::to_be_bytes).concat()].concat())
    }

    fn line_of(&mut self, port: Port) -> &mut RtuLine {
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
        self.bring(port, &frame, (trouble % 16 == 3).then_some(at), pause);
        if trouble & 0x80 == 0 {
            // The silence that ends it; else the next frame does.
            self.pass(3);
        }
    }

    fn bring(&mut self, port: Port, frame: &[u8], damaged_at: Option<usize>, pause: Option<(usize, u32)>) {
        let line = self.line_of(port);
        for (at, byte) in frame.iter().enumerate() {
            let character = if damaged_at == Some(at) { Character::Damaged } else { Character::Byte(*byte) };
            let silence_us = match pause {
                Some((pause_at, silence_us)) if pause_at == at => silence_us,
                _ if at == 0 => line.silence_us().max(port.timing().t3_5_us),
                _ => 0,
            };
            line.bring(character, silence_us);
        }
    }

    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            if self.is_over {
                return;
            }
            self.turn();
        }
    }

    /// One turn of the main loop, a millisecond after the one before.
    fn turn(&mut self) {
        self.now_ms += 1;
        self.bus.pass_ms();
        self.service.pass_ms();
        let Self { station, flash, line, bus, service, .. } = self;
        let was_connected = station.bridge().is_connected();
        line.left = line.per_ms;
        let outputs = station.turn(self.now_ms, self.wires, line, bus, service, flash);
        assert!(station.bridge().may_feed_watchdog(self.now_ms));
        let oracle = &mut self.oracle;
        oracle.begin_turn(self.now_ms, &std::mem::take(&mut line.heard), self.wires);
        for event in self.bus.take_events() {
            match self.overheard.take(Port::Bus, &event) {
                None => continue,
                Some(Done::Heard) => {}
                Some(Done::Image(image, recipe)) => oracle.asked.take_image(image, recipe),
                Some(Done::Unknown) => self.is_over = true,
            }
            self.heard_ms = Some(self.now_ms);
        }
        if self.is_over {
            return;
        }
        oracle.shown.min_busy_ms = self.overheard.min_busy_ms();
        let timeout_ms = self.overheard.timeout_ms();
        if timeout_ms > 0 && self.heard_ms.is_some_and(|heard_ms| self.now_ms - heard_ms >= timeout_ms) {
            self.heard_ms = None;
            oracle.asked.lose_bus();
        }
        let connected = self.station.bridge().is_connected();
        if was_connected && !connected {
            self.line.cut();
        }
        let is_slow = self.line.per_ms == BYTES_PER_MS;
        let patience_ms = Some(if is_slow { SLOW_PATIENCE_MS } else { 1 });
        oracle.begin_leaving(patience_ms);
        for id in self.line.begun.drain(..).filter(|_| is_slow) {
            oracle.leaves(id, None, &self.gripper);
        }
        for message in self.line.take_whole() {
            if !is_slow {
                oracle.leaves(message.id, Some(&message.command()), &self.gripper);
            }
            self.gripper.hear(self.now_ms, &message);
        }
        oracle.end_turn(outputs, &self.gripper);
        for answer in self.gripper.speak(self.now_ms) {
            self.line.bring(&answer);
        }
        self.serve();
    }

    /// What the service port did comes behind all else in a turn, and counts from the next on.
    fn serve(&mut self) {
        for event in self.service.take_events() {
            match self.overheard.take(Port::Service, &event) {
                None | Some(Done::Heard) => {}
                Some(Done::Image(..)) => unreachable!("it does not command"),
                Some(Done::Unknown) => self.is_over = true,
            }
        }
        self.is_over |= matches!(self.overheard.end_turn(), Done::Unknown);
        let (oracle, overheard) = (&mut self.oracle, &self.overheard);
        oracle.told.frame_timeout_ms = overheard.frame_timeout_ms();
        oracle.asked.debounce_ms = overheard.debounce_ms();
        oracle.asked.recipes = overheard.recipes();
        oracle.asked.refuses &= overheard.saved().is_none();
    }

    /// What was saved is what the next start finds.
    fn check_saved(&mut self) {
        if self.is_over || self.overheard.saved().is_none() {
            return;
        }
        self.pass(SAVE_MS);
        let mut station = Station::new(CanBus::new(Double::default(), BusOffPolicy::DEFAULT), &NO_PROFIBUS);
        let found = station.load(&self.delivered, &self.flash).map(|config| config.record());
        assert_eq!(found.as_ref().ok(), self.overheard.saved());
    }
}

/// What a bridge shows whose gripper takes commands.
pub(super) const READY: Outputs = Outputs::READY.union(Outputs::REFERENCED).union(Outputs::LINK_OK);

/// And one that refuses the stored settings.
const REFUSED: Outputs = READY.difference(Outputs::READY).union(Outputs::ERROR);

/// How long a save takes at the most, in turns: an erase and a double word for four settings, the same again in the other page.
const SAVE_MS: u32 = 70;

/// How long a FAST STOP may wait there for the frame before it, in milliseconds.
const SLOW_PATIENCE_MS: u32 = 2;

/// Bytes of a frame up to its id.
const UP_TO_ID: usize = 4;

/// The gripper's line. It takes no frame in a millisecond in which it would not take the id as well: what leaves is known when
/// it begins to leave.
struct GripperLine {
    line: SerialLine,
    per_ms: usize,
    /// What it takes in this millisecond.
    left: usize,
    /// The frame that is being sent.
    frame: Vec<u8>,
    /// What the bridge read in this millisecond.
    heard: Vec<u8>,
    /// The ids of the frames that began in this millisecond.
    begun: Vec<CommandId>,
    /// Whole frames.
    whole: Vec<u8>,
    /// Finds messages in them.
    parser: FrameParser<64>,
}

impl GripperLine {
    fn new(per_ms: usize) -> Self {
        Self {
            line: SerialLine::with_room(usize::MAX),
            per_ms,
            left: 0,
            frame: Vec::new(),
            heard: Vec::new(),
            begun: Vec::new(),
            whole: Vec::new(),
            parser: FrameParser::new(),
        }
    }

    fn bring(&mut self, bytes: &[u8]) {
        self.line.bring(bytes);
    }

    fn take_whole(&mut self) -> Vec<Message> {
        gripper::messages(&mut self.parser, &std::mem::take(&mut self.whole))
    }

    /// The rest of the frame that is being sent will not come, unless it is a FAST STOP.
    fn cut(&mut self) {
        if self.frame.get(UP_TO_ID - 1) != Some(&CommandId::FastStop.code()) {
            self.frame.clear();
        }
    }

    fn take(&mut self, byte: u8) {
        self.left -= 1;
        self.frame.push(byte);
        if self.frame.len() == UP_TO_ID {
            self.begun.push(CommandId::from_code(byte));
        }
        if let [_, _, _, _, low, high, ..] = self.frame[..]
            && self.frame.len() == OVERHEAD + usize::from(u16::from_le_bytes([low, high]))
        {
            self.whole.append(&mut self.frame);
        }
    }
}

impl ErrorType for GripperLine {
    type Error = Infallible;
}

impl ReadReady for GripperLine {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        self.line.read_ready()
    }
}

impl Read for GripperLine {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let count = self.line.read(buffer)?;
        self.heard.extend_from_slice(&buffer[..count]);
        Ok(count)
    }
}

impl WriteReady for GripperLine {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.left >= if self.frame.is_empty() { UP_TO_ID } else { 1 })
    }
}

impl Write for GripperLine {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let count = bytes.len().min(self.left);
        bytes[..count].iter().for_each(|byte| self.take(*byte));
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
