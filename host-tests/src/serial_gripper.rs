//! The virtual gripper on a serial line in virtual time, and the commands that a bridge sends to it.

use std::collections::VecDeque;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_protocol::{CommandId, FrameParser, Kind, frame::MAX_MESSAGE_LEN};
use wsg_sim::{MAX_FRAME_LEN, PortId, PortKind, Time, VirtualGripper};

use crate::faulty_link::FaultyWay;
use crate::gripper_states::messages;

/// Bytes per millisecond on a line at 115 200 bit/s, 8N1.
pub const BYTES_PER_MS: usize = 12;

/// Modifies bytes in transit; called once per millisecond and direction.
pub type Disturbance = Box<dyn FnMut(&mut Vec<u8>)>;

/// The bridge's end of the line.
#[derive(Clone, Debug)]
pub struct SerialLine {
    to_bridge: VecDeque<u8>,
    from_bridge: Vec<u8>,
    /// Capacity of `from_bridge`, in bytes.
    room: usize,
    /// Whether every access returns an error.
    fails: bool,
}

impl SerialLine {
    /// Creates a line that accepts `room` bytes until they are fetched.
    #[must_use]
    pub fn with_room(room: usize) -> Self {
        Self { to_bridge: VecDeque::new(), from_bridge: Vec::new(), room, fails: false }
    }

    /// Creates a line that only returns errors.
    #[must_use]
    pub fn failing() -> Self {
        Self { fails: true, ..Self::with_room(0) }
    }

    fn check(&self) -> Result<(), ErrorKind> {
        if self.fails { Err(ErrorKind::Other) } else { Ok(()) }
    }

    /// Delivers bytes to the bridge.
    pub fn deliver(&mut self, bytes: &[u8]) {
        self.to_bridge.extend(bytes);
    }

    /// Returns the bytes that the bridge has sent since the last call.
    pub fn take_sent(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.from_bridge)
    }
}

impl ErrorType for SerialLine {
    type Error = ErrorKind;
}

impl ReadReady for SerialLine {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        self.check().map(|()| !self.to_bridge.is_empty())
    }
}

impl Read for SerialLine {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        self.check()?;
        let count = buffer.len().min(self.to_bridge.len());
        for (slot, byte) in buffer.iter_mut().zip(self.to_bridge.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}

impl WriteReady for SerialLine {
    fn write_ready(&mut self) -> Result<bool, ErrorKind> {
        self.check().map(|()| self.from_bridge.len() < self.room)
    }
}

impl Write for SerialLine {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        self.check()?;
        let taken = bytes.len().min(self.room.saturating_sub(self.from_bridge.len()));
        self.from_bridge.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
        self.check()
    }
}

/// One direction of a line.
pub trait Carry {
    /// Carries one millisecond's share of the waiting bytes, and returns the bytes that arrive.
    fn carry(&mut self, waiting: &mut Vec<u8>) -> Vec<u8>;
}

impl Carry for Option<Disturbance> {
    fn carry(&mut self, waiting: &mut Vec<u8>) -> Vec<u8> {
        let mut bytes = std::mem::take(waiting);
        if let Some(disturb) = self {
            disturb(&mut bytes);
        }
        bytes
    }
}

impl Carry for FaultyWay {
    /// Carries all bytes at once. No time passes on the line, so a delayed byte and all later ones never arrive.
    fn carry(&mut self, waiting: &mut Vec<u8>) -> Vec<u8> {
        self.pass(0, &std::mem::take(waiting));
        self.arrive(0)
    }
}

/// A gripper and its line.
#[derive(Clone, Debug)]
pub struct SerialGripper<W = Option<Disturbance>> {
    /// The gripper.
    pub gripper: VirtualGripper<1>,
    pub(crate) port: PortId,
    pub(crate) kind: PortKind,
    /// The bridge's end of the line.
    pub line: SerialLine,
    /// Bytes from the gripper that are still waiting for the line.
    from_gripper: Vec<u8>,
    /// Parses frames from the bridge; `seen_len` is the number of waiting bytes already parsed.
    seen: FrameParser<MAX_MESSAGE_LEN>,
    seen_len: usize,
    sent: Vec<CommandId>,
    /// Disturbance from bridge to gripper.
    pub to_gripper: W,
    /// Disturbance from gripper to bridge.
    pub to_bridge: W,
}

impl SerialGripper {
    /// Creates a gripper immediately after power-up.
    #[must_use]
    pub fn new(config: wsg_sim::Config) -> Self {
        Self::over(config, PortKind::Serial, BYTES_PER_MS, [None, None])
    }

    /// Sends bytes to the bridge in the gripper's place.
    pub fn inject(&mut self, bytes: &[u8]) {
        self.line.deliver(bytes);
    }
}

impl<W: Carry> SerialGripper<W> {
    /// Creates a gripper with this port, and a line with `room` bytes at the bridge's end and the given directions.
    #[must_use]
    pub fn over(
        config: wsg_sim::Config,
        kind: PortKind,
        room: usize,
        [to_gripper, to_bridge]: [W; 2],
    ) -> Self {
        let (gripper, port) = switch_on(config, kind);
        Self {
            gripper,
            port,
            kind,
            line: SerialLine::with_room(room),
            from_gripper: Vec::new(),
            seen: FrameParser::new(),
            seen_len: 0,
            sent: Vec::new(),
            to_gripper,
            to_bridge,
        }
    }

    /// Power-cycles the gripper; it loses all state, and its clock restarts at zero.
    pub fn restart(&mut self, config: wsg_sim::Config, now: Time) {
        (self.gripper, self.port) = switch_on(config, self.kind);
        self.gripper.advance(now);
    }

    /// Returns the commands that the bridge has sent since the last [`take_sent`](Self::take_sent).
    #[must_use]
    pub fn sent(&self) -> &[CommandId] {
        &self.sent
    }

    /// Returns the commands that the bridge has sent since the last call.
    pub fn take_sent(&mut self) -> Vec<CommandId> {
        std::mem::take(&mut self.sent)
    }

    /// Carries bytes in both directions and advances the gripper to `now`.
    ///
    /// # Panics
    /// Panics when the bridge has sent a broken frame.
    pub fn advance(&mut self, now: Time) {
        let sent = messages(&mut self.seen, &self.line.from_bridge[self.seen_len..]);
        self.sent.extend(sent.into_iter().map(|message| message.id));
        let bytes = self.to_gripper.carry(&mut self.line.from_bridge);
        self.seen_len = self.line.from_bridge.len();
        self.gripper.receive(self.port, now, &bytes);
        self.gripper.advance(now);
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = self.gripper.transmit(self.port, &mut buffer) {
            self.from_gripper.extend_from_slice(frame);
        }
        let bytes = self.to_bridge.carry(&mut self.from_gripper);
        self.line.deliver(&bytes);
    }
}

/// Powers up a gripper, and connects to it.
pub(crate) fn switch_on(config: wsg_sim::Config, kind: PortKind) -> (VirtualGripper<1>, PortId) {
    let mut gripper = VirtualGripper::with_ports(config);
    let port = gripper.connect(kind);
    (gripper, port.unwrap_or_else(|| unreachable!("a new gripper takes a client")))
}

/// Returns the motion commands among these.
#[must_use]
pub fn motions(sent: Vec<CommandId>) -> Vec<CommandId> {
    sent.into_iter().filter(|id| id.kind() == Kind::Motion).collect()
}
