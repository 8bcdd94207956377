//! The whole bridge: any bytes on its line, any wires.

use std::collections::{BTreeMap, VecDeque};
use std::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::{Bridge, Config};
use wsg_protocol::{CommandId, Event, FrameEncoder, FrameParser, Kind, Reply, Status};

use super::frames::repair_checksums;
use super::input::Input;

/// The wires that ask for motions, and the commands that may leave for them.
const MOTIONS: [(Inputs, CommandId); 4] = [
    (Inputs::GRIP, CommandId::GripPart),
    (Inputs::RELEASE, CommandId::ReleasePart),
    (Inputs::MOVE, CommandId::PrePosition),
    (Inputs::HOME, CommandId::Homing),
];

/// How long the wire of FAST STOP must be low before no motion may leave: debouncing, a turn, and a frame on its way.
const FAST_STOP_MS: u32 = 5;

/// The line: what comes to the bridge, what it sends.
#[derive(Default)]
struct Line {
    to_bridge: VecDeque<u8>,
    from_bridge: Vec<u8>,
}

struct Model {
    bridge: Bridge,
    line: Line,
    /// Finds frames in what the bridge sends.
    sent: FrameParser<64>,
    now_ms: u32,
    wires: Inputs,
    low_since_ms: u32,
    /// Edges of each motion's wire that no command has left for.
    edges: BTreeMap<u8, u32>,
    /// The gripper answers as a real one would that succeeds in everything.
    answers: bool,
}

/// Each op is a byte that says what, and bytes that say how: wires, time, bytes on the line, a gripper that answers.
pub fn bridge(data: &[u8]) {
    let mut input = Input::new(data);
    let mut model = Model {
        bridge: Bridge::new(Config::DEFAULT),
        line: Line::default(),
        sent: FrameParser::new(),
        now_ms: 0,
        wires: Inputs::empty(),
        low_since_ms: 0,
        edges: BTreeMap::new(),
        answers: false,
    };
    if input.byte() & 1 != 0 {
        model.get_ready();
    }
    while !input.is_empty() {
        match input.byte() % 8 {
            0 | 1 => model.set(Inputs::from_bits_retain(input.byte())),
            2 => model.set(input.pick(&MOTIONS).0 | Inputs::FAST_STOP_OK),
            3 => {
                let count = usize::from(input.byte() % 40);
                model.line.to_bridge.extend(input.bytes(count));
            }
            4 => {
                let count = usize::from(input.byte() % 40);
                let mut bytes = input.bytes(count).to_vec();
                repair_checksums(&mut bytes);
                model.line.to_bridge.extend(bytes);
            }
            5 => {
                let status = input.pick(&[
                    Status::Success,
                    Status::CmdPending,
                    Status::CmdFailed,
                    Status::AccessDenied,
                ]);
                model.reply(Reply::status_only(input.pick(CommandId::ALL), status));
            }
            6 => model.answers = input.byte() & 1 != 0,
            _ => model.pass(u32::from(input.byte() % 32)),
        }
        model.pass(1);
    }
    model.pass(10);
}

impl Model {
    /// What most of the interesting states lie behind: connected, FAST STOP acknowledged.
    fn get_ready(&mut self) {
        self.answers = true;
        self.set(Inputs::FAST_STOP_OK);
        self.pass(12);
        self.set(Inputs::FAST_STOP_OK | Inputs::STOP_ACK);
        self.pass(4);
        self.set(Inputs::FAST_STOP_OK);
        self.pass(4);
    }

    fn set(&mut self, wires: Inputs) {
        for (wire, id) in MOTIONS {
            if wires.difference(self.wires).contains(wire) {
                *self.edges.entry(id.code()).or_default() += 1;
            }
        }
        if self.wires.contains(Inputs::FAST_STOP_OK) && !wires.contains(Inputs::FAST_STOP_OK) {
            self.low_since_ms = self.now_ms;
        }
        self.wires = wires;
    }

    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.now_ms += 1;
            self.bridge.poll(self.now_ms, self.wires, &mut self.line);
            let sent = std::mem::take(&mut self.line.from_bridge);
            self.look_at(&sent);
        }
    }

    fn look_at(&mut self, mut sent: &[u8]) {
        loop {
            let (taken, event) = self.sent.push_slice(sent);
            sent = &sent[taken..];
            let id = match event {
                None => return,
                Some(Event::Frame(frame)) => CommandId::from_code(frame.id),
                Some(broken) => panic!("the bridge sends a broken frame: {broken:?}"),
            };
            if id.kind() == Kind::Motion {
                let edges = self.edges.entry(id.code()).or_default();
                *edges = edges.checked_sub(1).unwrap_or_else(|| panic!("{id} without an edge"));
                let low = !self.wires.contains(Inputs::FAST_STOP_OK);
                assert!(!low || self.now_ms - self.low_since_ms < FAST_STOP_MS, "{id} during FAST STOP");
            }
            if self.answers {
                self.answer(id);
            }
        }
    }

    fn answer(&mut self, id: CommandId) {
        let payload: &[u8] = match id {
            CommandId::GetSystemInfo => &[0, 0, 1, 2, 0x20, 0x31, 1, 0, 0, 0],
            CommandId::GetSystemState => &[0, 0, 1, 0, 0, 0],
            CommandId::GetGripperState => &[0, 0, 0],
            CommandId::GetSystemLimits => {
                let limits = [110.0_f32, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0];
                let payload = [[0, 0].as_slice(), &limits.map(f32::to_le_bytes).concat()].concat();
                self.line.to_bridge.extend(FrameEncoder::new(id.code(), &payload[..]));
                return;
            }
            _ => &[0, 0],
        };
        if id.kind() == Kind::Motion {
            self.reply(Reply::status_only(id, Status::CmdPending));
        }
        self.line.to_bridge.extend(FrameEncoder::new(id.code(), payload));
    }

    fn reply(&mut self, reply: Reply<'_>) {
        self.line.to_bridge.extend(FrameEncoder::new(reply.id().code(), reply));
    }
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.to_bridge.is_empty())
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let count = buffer.len().min(self.to_bridge.len());
        for (slot, byte) in buffer.iter_mut().zip(self.to_bridge.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.from_bridge.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
