//! From an edge of the PLC to the first byte on the gripper's line, on the board's own drivers.

use core::cell::Cell;

use cortex_m_semihosting::hprintln;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::{Deque, Vec};
// What is counted is what runs on the board.
use wsg_b_l475e_iot01a::drivers::pins::{self, Pins};
use wsg_b_l475e_iot01a::drivers::uart::{self, GripperLine};
use wsg_bridge_fw::gripper::WouldBlock;
use wsg_bridge_fw::io::{InputPort, Inputs, OutputPort, Outputs};
use wsg_bridge_fw::{Bridge, Config, NoBus};
use wsg_protocol::CommandId;
use wsg_protocol::frame::PREAMBLE_LEN;
use wsg_sim::{MAX_FRAME_LEN, PortKind, Time, VirtualGripper};

use crate::counting::{self, Counter, Moment};

/// The board's line, which the virtual gripper listens in on and answers to.
struct Line {
    board: GripperLine,
    sent: Vec<u8, 64>,
    answers: Deque<u8, 512>,
    first_byte: Cell<Option<Moment>>,
}

impl ErrorType for Line {
    type Error = WouldBlock;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, WouldBlock> {
        Ok(!self.answers.is_empty())
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, WouldBlock> {
        let slots = buffer.iter_mut();
        Ok(slots.map_while(|slot| self.answers.pop_front().map(|byte| *slot = byte)).count())
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, WouldBlock> {
        self.board.write_ready()
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, WouldBlock> {
        let taken = self.board.write(bytes)?;
        // The interrupt is pending since the write, and nothing masks it: by now the byte is in the transmitter.
        if self.first_byte.get().is_none() {
            self.first_byte.set(Some(counting::now()));
        }
        let sent = bytes.get(..taken).unwrap_or(&[]);
        assert!(self.sent.extend_from_slice(sent).is_ok(), "a turn of the main loop sends a few frames");
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), WouldBlock> {
        self.board.flush()
    }
}

/// When the PLC's wire changes.
const EDGE_MS: u32 = 700;

/// Each wire that gives a command, and the command that its edge lets out first.
const EDGES: [(&str, Inputs, CommandId); 6] = [
    ("edge-to-first-byte/home", Inputs::HOME, CommandId::Homing),
    ("edge-to-first-byte/move", Inputs::MOVE, CommandId::PrePosition),
    // The force limit goes ahead of the motion.
    ("edge-to-first-byte/grip", Inputs::GRIP, CommandId::SetForceLimit),
    ("edge-to-first-byte/release", Inputs::RELEASE, CommandId::ReleasePart),
    ("edge-to-first-byte/stop", Inputs::STOP_ACK, CommandId::Stop),
    ("edge-to-first-byte/fast-stop", Inputs::FAST_STOP_OK, CommandId::FastStop),
];

/// Counts the turn of the main loop in which an edge counts, from its beginning to the first byte.
// Apart from the others, whose registers would be its own.
#[inline(never)]
pub(crate) fn count(counter: &Counter) {
    let mut pins = pins::init();
    uart::start();
    let mut line =
        Line { board: uart::line(), sent: Vec::new(), answers: Deque::new(), first_byte: Cell::new(None) };
    for (name, wire, command) in EDGES {
        hprintln!("{} {} 1", name, count_one(counter, &mut pins, &mut line, wire, command));
    }
}

fn count_one(counter: &Counter, pins: &mut Pins, line: &mut Line, wire: Inputs, command: CommandId) -> u32 {
    let mut gripper = VirtualGripper::<1>::with_ports(wsg_sim::Config::default());
    let Some(port) = gripper.connect(PortKind::Serial) else { unreachable!("a new gripper takes a client") };
    let mut bridge = Bridge::new(Config::DEFAULT);
    let mut buffer = [0; MAX_FRAME_LEN];
    line.answers.clear();
    for ms in 1..2_000 {
        let levels = match ms {
            300..400 => Inputs::FAST_STOP_OK | Inputs::STOP_ACK,
            ..EDGE_MS => Inputs::FAST_STOP_OK,
            _ => Inputs::FAST_STOP_OK.symmetric_difference(wire),
        };
        line.first_byte.set(None);
        let begun = counter.now();
        // What reading the pins costs is counted; the levels are the script's.
        let read = pins.read();
        let outputs = bridge.poll(ms, levels | (read & Inputs::empty()), line, &mut NoBus);
        pins.write(outputs);
        if let Some(sent) = line.first_byte.get()
            && ms >= EDGE_MS
            && line.sent.get(PREAMBLE_LEN) == Some(&command.code())
        {
            line.sent.clear();
            return begun.instructions_to(sent);
        }
        assert!(ms != EDGE_MS - 1 || outputs.contains(Outputs::READY), "READY before the edge");

        let time = Time::from_millis(ms.into());
        gripper.receive(port, time, &line.sent);
        line.sent.clear();
        gripper.advance(time);
        while let Some(frame) = gripper.transmit(port, &mut buffer) {
            line.answers.extend(frame.iter().copied());
        }
    }
    panic!("the edge is not taken: {}", command.name());
}
