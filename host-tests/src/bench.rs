//! Bridge and virtual gripper in virtual time: no emulator, no clock, a million milliseconds in seconds.
//!
//! The bridge here is the library that the image is made of; what only the board has (interrupts, registers, the size of
//! its queues) is tested in the emulator.

use std::collections::VecDeque;
use std::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Bridge, Config};
use wsg_protocol::{CommandId, Event, FrameParser, Kind, frame::MAX_MESSAGE_LEN};
use wsg_sim::{MAX_FRAME_LEN, PortId, PortKind, Time, VirtualGripper};

/// How many bytes a line at 115 200 bit/s, 8N1, carries in a millisecond.
const BYTES_PER_MS: usize = 12;

/// What becomes of bytes on their way; called once a millisecond for each direction.
pub type Disturbance = Box<dyn FnMut(&mut Vec<u8>)>;

/// The bridge's end of the line.
#[derive(Debug, Default)]
struct Line {
    to_bridge: VecDeque<u8>,
    from_bridge: Vec<u8>,
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
        Ok(self.from_bridge.len() < BYTES_PER_MS)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let room = BYTES_PER_MS - self.from_bridge.len().min(BYTES_PER_MS);
        let taken = bytes.len().min(room);
        self.from_bridge.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Bridge and gripper, and a PLC that a test plays.
pub struct Bench {
    bridge: Bridge,
    gripper: VirtualGripper<1>,
    port: PortId,
    line: Line,
    now_ms: u32,
    inputs: Inputs,
    outputs: Outputs,
    /// Finds frames in what the bridge sends.
    seen: FrameParser<MAX_MESSAGE_LEN>,
    sent: Vec<CommandId>,
    /// On the way from bridge to gripper.
    pub to_gripper: Option<Disturbance>,
    /// On the way from gripper to bridge.
    pub to_bridge: Option<Disturbance>,
}

impl Bench {
    /// A bench with all wires of the PLC low.
    #[must_use]
    pub fn new(config: wsg_sim::Config) -> Self {
        let (gripper, port) = switch_on(config);
        Self {
            bridge: Bridge::new(Config::DEFAULT),
            gripper,
            port,
            line: Line::default(),
            now_ms: 0,
            inputs: Inputs::empty(),
            outputs: Outputs::empty(),
            seen: FrameParser::new(),
            sent: Vec::new(),
            to_gripper: None,
            to_bridge: None,
        }
    }

    /// A bench that is READY: connected, FAST STOP acknowledged.
    #[must_use]
    pub fn ready(config: wsg_sim::Config) -> Self {
        let mut bench = Self::new(config);
        bench.set(Inputs::FAST_STOP_OK, true);
        bench.pass(200);
        bench.pulse(Inputs::STOP_ACK);
        bench.until(1_000, |outputs| outputs.contains(Outputs::READY));
        bench
    }

    /// A bench that is READY and REFERENCED.
    #[must_use]
    pub fn homed(config: wsg_sim::Config) -> Self {
        let mut bench = Self::ready(config);
        bench.command(Inputs::HOME);
        assert!(bench.outputs.contains(Outputs::REFERENCED | Outputs::READY), "{:?}", bench.outputs);
        bench
    }

    /// The gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.gripper
    }

    /// The moment, on the gripper's clock.
    #[must_use]
    pub fn now(&self) -> Time {
        Time::from_millis(self.now_ms.into())
    }

    /// What the bridge has met that it could not use.
    #[must_use]
    pub fn counters(&self) -> wsg_bridge_fw::Counters {
        self.bridge.counters()
    }

    /// The wires to the PLC.
    #[must_use]
    pub fn outputs(&self) -> Outputs {
        self.outputs
    }

    /// The commands that the bridge has sent since this was last asked.
    pub fn take_sent(&mut self) -> Vec<CommandId> {
        std::mem::take(&mut self.sent)
    }

    /// The motion commands among those.
    pub fn take_motions(&mut self) -> Vec<CommandId> {
        self.take_sent().into_iter().filter(|id| id.kind() == Kind::Motion).collect()
    }

    /// Sets wires of the PLC.
    pub fn set(&mut self, wires: Inputs, high: bool) {
        self.inputs.set(wires, high);
    }

    /// Lets time pass.
    pub fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// Raises wires for 5 ms and lowers them for as long.
    pub fn pulse(&mut self, wires: Inputs) {
        self.set(wires, true);
        self.pass(5);
        self.set(wires, false);
        self.pass(5);
    }

    /// Lets time pass until the outputs are as wanted, `bound_ms` at the most; whether they are.
    pub fn until(&mut self, bound_ms: u32, wanted: impl Fn(Outputs) -> bool) -> bool {
        (0..bound_ms).any(|_| {
            self.step();
            wanted(self.outputs)
        })
    }

    /// Gives a motion command and waits for its end; the outputs then.
    ///
    /// # Panics
    /// When it is not taken, or does not end within a minute.
    pub fn command(&mut self, wire: Inputs) -> Outputs {
        self.set(wire, true);
        assert!(
            self.until(1_000, |outputs| outputs.contains(Outputs::BUSY)),
            "{wire:?} is not taken: {:?}, sent {:?}",
            self.outputs,
            self.sent
        );
        self.set(wire, false);
        assert!(self.until(60_000, |outputs| !outputs.contains(Outputs::BUSY)), "{wire:?} does not end");
        self.outputs
    }

    /// Switches the gripper off and on again: it has forgotten everything, and its clock starts anew.
    pub fn restart_gripper(&mut self, config: wsg_sim::Config) {
        (self.gripper, self.port) = switch_on(config);
        let now = self.now();
        self.gripper.advance(now);
    }

    /// Sends bytes to the bridge that the gripper never sent.
    pub fn inject(&mut self, bytes: &[u8]) {
        self.line.to_bridge.extend(bytes);
    }

    /// One millisecond.
    fn step(&mut self) {
        self.now_ms += 1;
        self.outputs = self.bridge.poll(self.now_ms, self.inputs, &mut self.line);
        let mut bytes = std::mem::take(&mut self.line.from_bridge);
        self.note_frames(&bytes);
        if let Some(disturb) = &mut self.to_gripper {
            disturb(&mut bytes);
        }
        let now = self.now();
        self.gripper.receive(self.port, now, &bytes);
        self.gripper.advance(now);
        let mut buffer = [0; MAX_FRAME_LEN];
        let mut bytes = Vec::new();
        while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
            bytes.extend_from_slice(frame);
        }
        if let Some(disturb) = &mut self.to_bridge {
            disturb(&mut bytes);
        }
        self.line.to_bridge.extend(bytes);
    }

    fn note_frames(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        loop {
            let (taken, event) = self.seen.push_slice(rest);
            rest = &rest[taken..];
            match event {
                Some(Event::Frame(frame)) => self.sent.push(CommandId::from_code(frame.id)),
                Some(broken) => panic!("the bridge sent a broken frame: {broken:?}"),
                None => return,
            }
        }
    }
}

fn switch_on(config: wsg_sim::Config) -> (VirtualGripper<1>, PortId) {
    let mut gripper = VirtualGripper::with_ports(config);
    let port = gripper.connect(PortKind::Serial);
    (gripper, port.unwrap_or_else(|| unreachable!("a new gripper takes a client")))
}

impl std::fmt::Debug for Bench {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bench")
            .field("now_ms", &self.now_ms)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}
