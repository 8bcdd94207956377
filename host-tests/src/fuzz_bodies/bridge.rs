//! The whole bridge between wires, a Modbus bus and the gripper's line: any bytes on both lines, any wires.
//!
//! What must hold, whatever comes:
//! - the [`Oracle`]'s rules: a command leaves only for an edge of a wire, or of an image that an intact request wrote while the
//!   bus commanded; a FAST STOP leaves at once, or behind the frame that is being sent; the outputs are true;
//! - the watchdog may be fed;
//! - no frame with a wrong checksum leaves, on either line;
//! - each answer on the bus has its request, intact and for the bridge's unit ([`Overheard`]); what is damaged, or for
//!   another, does nothing.
//!
//! A case ends where that cannot be followed from outside: behind Force Listen Only Mode, a broadcast to the settings, and
//! when broadcasts count on a line that is not strict.

use std::convert::Infallible;

use bus_modbus::rtu::Character;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::{Bridge, BusConfig, Config};
use wsg_protocol::fieldbus::CommandFlags;
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{CommandId, FrameParser, Status};

use super::frames::repair_checksums;
use super::gripper::{self, Gripper, Message};
use super::input::Input;
use super::modbus::sealed;
use super::oracle::Oracle;
use super::rtu_line::{BROADCAST, Done, Overheard, RtuLine, TIMING};
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

/// Silences before a character: none, and around the two that matter.
const SILENCES: [u32; 6] =
    [0, TIMING.t1_5_us, TIMING.t1_5_us + 1, TIMING.t3_5_us - 1, TIMING.t3_5_us, 60_000];

struct Model {
    bridge: Bridge,
    modbus: Modbus,
    line: GripperLine,
    bus: RtuLine,
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
/// gripper's line takes no more than it would at 115 200 bit/s (bit 2), and whether the fingers move at power-up (bit 4). Then
/// each op is a byte that says what, and bytes that say how: wires, time, bytes on either line, how the gripper answers, a PLC
/// that writes.
pub fn bridge(data: &[u8]) {
    let mut input = Input::new(data);
    let choice = input.byte();
    let mut model = Model::new(choice & 2 != 0, choice & 4 != 0);
    if choice & 16 != 0 {
        model.gripper.run();
    }
    if choice & 1 != 0 {
        model.get_ready();
    }
    while !input.is_empty() && !model.is_over {
        match input.byte() % 16 {
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
                    model.bus.bring(character, input.pick(&SILENCES));
                }
            }
            9 => {
                let unit = input.pick(&[model.overheard.unit(), BROADCAST, 5]);
                let count = usize::from(input.byte() % 24);
                let frame = [&[unit], input.bytes(count)].concat();
                model.send(&sealed(&frame), &mut input);
            }
            10 => {
                let frame = model.image_frame(input.pick(&FLAGS), input.pick(&PARAMETERS));
                model.send(&frame, &mut input);
            }
            11 => {
                let unit = input.pick(&[model.overheard.unit(), BROADCAST]);
                let value = u16::from(input.byte()).to_be_bytes();
                let setting = 100 + input.byte() % 26;
                model.send(&sealed(&[&[unit, 6, 0, setting], &value[..]].concat()), &mut input);
            }
            12 => {
                let unit = input.pick(&[model.overheard.unit(), BROADCAST]);
                let (coil, value) = (input.byte() % 66, input.pick(&[0, 0xFF, 1]));
                model.send(&sealed(&[unit, 5, 0, coil, value, 0]), &mut input);
            }
            13 if input.byte() & 7 == 0 => {
                let first = input.byte() & 1;
                let frame = [model.overheard.unit(), 3, 0, first, 0, 1 + input.byte() % 4];
                model.send(&sealed(&frame), &mut input);
            }
            13 => {
                let [and, or] = [input.pick(&FLAGS).bits(), input.pick(&FLAGS).bits()];
                let frame = [model.overheard.unit(), 22, 0, 0, and, 0xFF, or, 0];
                model.send(&sealed(&frame), &mut input);
            }
            14 => {
                // An edge as a PLC gives it.
                let parameters = input.pick(&PARAMETERS);
                for flags in [CommandFlags::empty(), input.pick(&FLAGS)] {
                    let frame = model.image_frame(flags, parameters);
                    model.bring(&frame, None, None);
                    model.pass(4);
                }
            }
            _ => model.pass(u32::from(input.byte())),
        }
        model.pass(1);
    }
    model.pass(10);
}

impl Model {
    fn new(strict_with_broadcasts: bool, slow: bool) -> Self {
        let mut config = Config::DEFAULT;
        if strict_with_broadcasts {
            config.bus = BusConfig { broadcast: true, character_timeout_ms: 0, ..config.bus };
        }
        Self {
            bridge: Bridge::new(config),
            modbus: Modbus::new(&config),
            line: GripperLine::new(if slow { BYTES_PER_MS } else { usize::MAX }),
            bus: RtuLine::default(),
            now_ms: 0,
            wires: Inputs::empty(),
            overheard: Overheard::new(&config),
            heard_ms: None,
            is_over: false,
            gripper: Gripper::new(),
            oracle: Oracle::new(&config),
        }
    }

    /// What most of the interesting states lie behind: connected, FAST STOP acknowledged, a bus that has written zeros.
    fn get_ready(&mut self) {
        self.gripper.answer();
        self.wires = Inputs::FAST_STOP_OK;
        self.pass(12);
        self.wires = Inputs::FAST_STOP_OK | Inputs::STOP_ACK;
        let zeros = self.image_frame(CommandFlags::empty(), PARAMETERS[0]);
        self.bring(&zeros, None, None);
        self.pass(4);
        self.wires = Inputs::FAST_STOP_OK;
        self.pass(4);
        assert_eq!(self.oracle.shown.outputs, READY);
    }

    /// Something that the gripper did not say.
    fn bring_to_bridge(&mut self, bytes: &[u8]) {
        self.gripper.forge(self.now_ms, bytes);
        self.line.bring(bytes);
    }

    /// A write of registers 0 to 3.
    fn image_frame(&self, flags: CommandFlags, parameters: [u16; 3]) -> Vec<u8> {
        let head = [self.overheard.unit(), 16, 0, 0, 0, 4, 8, flags.bits(), 0];
        sealed(&[&head[..], &parameters.map(u16::to_be_bytes).concat()].concat())
    }

    /// Puts a frame on the bus, now and then with a wrong bit, a damaged character or a pause in it.
    fn send(&mut self, frame: &[u8], input: &mut Input<'_>) {
        let mut frame = frame.to_vec();
        let trouble = input.byte();
        let at = usize::from(input.byte()) % frame.len();
        match trouble % 16 {
            0 => frame[at] ^= 1 << (trouble >> 5),
            1 => frame.truncate(at),
            _ => {}
        }
        let pause = (trouble % 16 == 2).then(|| (at, input.pick(&SILENCES)));
        self.bring(&frame, (trouble % 16 == 3).then_some(at), pause);
        if trouble & 0x80 == 0 {
            // The silence that ends it; else the next frame does.
            self.pass(3);
        }
    }

    fn bring(&mut self, frame: &[u8], damaged_at: Option<usize>, pause: Option<(usize, u32)>) {
        for (at, byte) in frame.iter().enumerate() {
            let character = if damaged_at == Some(at) { Character::Damaged } else { Character::Byte(*byte) };
            let silence_us = match pause {
                Some((pause_at, silence_us)) if pause_at == at => silence_us,
                _ if at == 0 => self.bus.silence_us().max(TIMING.t3_5_us),
                _ => 0,
            };
            self.bus.bring(character, silence_us);
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
        let Self { bridge, modbus, line, bus, .. } = self;
        let was_connected = bridge.is_connected();
        line.left = line.per_ms;
        let outputs = bridge.poll(self.now_ms, self.wires, line, &mut modbus.over(bus));
        assert!(bridge.may_feed_watchdog(self.now_ms));
        let oracle = &mut self.oracle;
        oracle.begin_turn(self.now_ms, &std::mem::take(&mut line.heard), self.wires);
        for event in self.bus.take_events() {
            match self.overheard.take(event) {
                None => continue,
                Some(Done::Heard) => {}
                Some(Done::Image(image)) => oracle.asked.take_image(image),
                Some(Done::Unknown) => self.is_over = true,
            }
            self.heard_ms = Some(self.now_ms);
        }
        if self.is_over {
            return;
        }
        oracle.told.frame_timeout_ms = self.overheard.frame_timeout_ms();
        oracle.shown.min_busy_ms = self.overheard.min_busy_ms();
        oracle.asked.debounce_ms = self.overheard.debounce_ms();
        oracle.asked.recipes = self.overheard.recipes();
        let timeout_ms = self.overheard.timeout_ms();
        if timeout_ms > 0 && self.heard_ms.is_some_and(|heard_ms| self.now_ms - heard_ms >= timeout_ms) {
            self.heard_ms = None;
            oracle.asked.lose_bus();
        }
        let connected = self.bridge.is_connected();
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
    }
}

/// What a bridge shows whose gripper takes commands.
pub(super) const READY: Outputs = Outputs::READY.union(Outputs::REFERENCED).union(Outputs::LINK_OK);

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
