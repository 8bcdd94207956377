//! Cost from a PLC edge to the first byte on the gripper's line, with the board's drivers. For a GRIP with a known force
//! limit, also the size of the frame, which is sent first.

use core::cell::Cell;

use cortex_m_semihosting::hprintln;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::{Deque, Vec};
// The same drivers run on the board.
#[cfg(feature = "b-l475e-iot01a")]
use wsg_b_l475e_iot01a::drivers::Iot01a as Board;
use wsg_bridge_fw::gripper::WouldBlock;
use wsg_bridge_fw::io::{InputPort, Inputs, OutputPort, Outputs};
use wsg_bridge_fw::{Bridge, Config, NoBus};
#[cfg(feature = "nucleo-g474re")]
use wsg_nucleo_g474re::drivers::Nucleo as Board;
use wsg_protocol::CommandId;
use wsg_protocol::frame::PREAMBLE_LEN;
use wsg_sim::{MAX_FRAME_LEN, Part, PortKind, Time, VirtualGripper};
use wsg_stm32::board::Stm32Board;
use wsg_stm32::gpio::{self, Pins};
use wsg_stm32::gripper_line::{self, GripperLine};

use crate::counting::{self, Counter, Moment};

/// The board's line. The virtual gripper receives its bytes and answers.
struct Line {
    board: GripperLine<Board>,
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
        // The interrupt has been pending since the write and is not masked, so the byte is now in the transmitter.
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

/// Actions of the PLC before the edge: times in ms at which it raises a wire, for 100 ms each.
type Script = [(u32, Inputs)];

/// Time from the last action of the script to the measured edge.
const REST_MS: u32 = 400;

/// The FAST STOP is acknowledged.
const READY: &Script = &[(300, Inputs::STOP_ACK)];

/// A GRIP has set the force limit, and it has been read back since.
const LIMITED: &Script =
    &[(300, Inputs::STOP_ACK), (500, Inputs::HOME), (700, Inputs::GRIP), (900, Inputs::RELEASE)];

/// Each command wire with its preparation and the command that its edge sends first.
const EDGES: [(&str, Inputs, &Script, CommandId); 7] = [
    ("edge-to-first-byte/home", Inputs::HOME, READY, CommandId::Homing),
    ("edge-to-first-byte/move", Inputs::MOVE, READY, CommandId::PrePosition),
    // The force limit precedes the motion.
    ("edge-to-first-byte/grip", Inputs::GRIP, READY, CommandId::SetForceLimit),
    ("edge-to-first-byte/release", Inputs::RELEASE, READY, CommandId::ReleasePart),
    ("edge-to-first-byte/stop", Inputs::STOP_ACK, READY, CommandId::Stop),
    ("edge-to-first-byte/fast-stop", Inputs::FAST_STOP_OK, READY, CommandId::FastStop),
    (LAST_BYTE, Inputs::GRIP, LIMITED, CommandId::GripPart),
];

/// Measured like the others, with the number of bytes sent in that turn.
const LAST_BYTE: &str = "edge-to-last-byte/grip";

/// The core clock in MHz, with which the instructions become a time.
const CLOCK: &str = "edge-clock-mhz";

/// Counts the main loop's turn of the edge, from its start to the first byte.
// Not inlined, so that register allocation is independent of the other measurements.
#[inline(never)]
pub(crate) fn count(counter: &Counter) {
    hprintln!("{} {} 1", CLOCK, Board::HCLK_HZ / 1_000_000);
    let (mut pins, _) = gpio::init::<Board>();
    gripper_line::start::<Board>();
    let mut line = Line {
        board: gripper_line::line(),
        sent: Vec::new(),
        answers: Deque::new(),
        first_byte: Cell::new(None),
    };
    for (name, wire, script, command) in EDGES {
        let (instructions, bytes) = count_one(counter, &mut pins, &mut line, wire, script, command);
        hprintln!("{} {} {}", name, instructions, if name == LAST_BYTE { bytes } else { 1 });
    }
}

/// Returns the instructions to the first byte, and the bytes sent in that turn, which begin with this command's frame.
fn count_one(
    counter: &Counter,
    pins: &mut Pins<Board>,
    line: &mut Line,
    wire: Inputs,
    script: &Script,
    command: CommandId,
) -> (u32, usize) {
    let config =
        wsg_sim::Config { time_scale: 100.0, part: Part::of_width(20.0), ..wsg_sim::Config::default() };
    let mut gripper = VirtualGripper::<1>::with_ports(config);
    let Some(port) = gripper.connect(PortKind::Serial) else { unreachable!("a new gripper takes a client") };
    let mut bridge = Bridge::new(Config::DEFAULT);
    let mut buffer = [0; MAX_FRAME_LEN];
    line.answers.clear();
    let edge_ms = script.last().map_or(0, |(raised_ms, _)| raised_ms + REST_MS);
    for ms in 1..2_000 {
        let pressed = script.iter().filter(|(raised_ms, _)| (*raised_ms..raised_ms + 100).contains(&ms));
        let mut levels = pressed.fold(Inputs::FAST_STOP_OK, |levels, (_, wire)| levels | *wire);
        if ms >= edge_ms {
            levels.toggle(wire);
        }
        line.first_byte.set(None);
        let begun = counter.now();
        // The cost of reading the pins is included; the levels come from the script.
        let read = pins.read();
        let outputs = bridge.poll(ms, levels | (read & Inputs::empty()), line, &mut NoBus);
        pins.write(outputs);
        if let Some(sent) = line.first_byte.get()
            && ms >= edge_ms
            && line.sent.get(PREAMBLE_LEN) == Some(&command.code())
        {
            let bytes = line.sent.len();
            line.sent.clear();
            return (begun.instructions_to(sent), bytes);
        }
        let sets_limit = line.sent.get(PREAMBLE_LEN) == Some(&CommandId::SetForceLimit.code());
        assert!(
            !sets_limit || ms < edge_ms || command != CommandId::GripPart,
            "the force limit must be known"
        );
        assert!(ms != edge_ms - 1 || outputs.contains(Outputs::READY), "READY must be high before the edge");

        let time = Time::from_millis(ms.into());
        gripper.receive(port, time, &line.sent);
        line.sent.clear();
        gripper.advance(time);
        while let Some(frame) = gripper.transmit(port, &mut buffer) {
            line.answers.extend(frame.iter().copied());
        }
    }
    panic!("the edge sent no byte: {}", command.name());
}
