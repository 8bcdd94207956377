//! The virtual gripper behind a serial line, in virtual time, and what a bridge sends to it.

use std::collections::VecDeque;
use std::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_protocol::{CommandId, Event, FrameParser, Kind, frame::MAX_MESSAGE_LEN};
use wsg_sim::{MAX_FRAME_LEN, PortId, PortKind, Time, VirtualGripper};

/// How many bytes a line at 115 200 bit/s, 8N1, carries in a millisecond.
pub const BYTES_PER_MS: usize = 12;

/// What becomes of bytes on their way; called once a millisecond for each direction.
pub type Disturbance = Box<dyn FnMut(&mut Vec<u8>)>;

/// The bridge's end of the line.
#[derive(Debug)]
pub struct SerialLine {
    to_bridge: VecDeque<u8>,
    from_bridge: Vec<u8>,
    /// What it takes until that is fetched.
    room: usize,
}

impl SerialLine {
    /// A line that takes so many bytes until they are fetched.
    #[must_use]
    pub fn with_room(room: usize) -> Self {
        Self { to_bridge: VecDeque::new(), from_bridge: Vec::new(), room }
    }

    /// Brings bytes to the bridge.
    pub fn bring(&mut self, bytes: &[u8]) {
        self.to_bridge.extend(bytes);
    }

    /// What the bridge has sent since this was last asked.
    pub fn take_sent(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.from_bridge)
    }
}

impl ErrorType for SerialLine {
    type Error = Infallible;
}

impl ReadReady for SerialLine {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.to_bridge.is_empty())
    }
}

impl Read for SerialLine {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let count = buffer.len().min(self.to_bridge.len());
        for (slot, byte) in buffer.iter_mut().zip(self.to_bridge.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}

impl WriteReady for SerialLine {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.from_bridge.len() < self.room)
    }
}

impl Write for SerialLine {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let taken = bytes.len().min(self.room.saturating_sub(self.from_bridge.len()));
        self.from_bridge.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A gripper and its line.
pub struct SerialGripper {
    /// The gripper.
    pub gripper: VirtualGripper<1>,
    port: PortId,
    /// The bridge's end of its line.
    pub line: SerialLine,
    /// Finds frames in what the bridge sends.
    seen: FrameParser<MAX_MESSAGE_LEN>,
    sent: Vec<CommandId>,
    /// On the way from bridge to gripper.
    pub to_gripper: Option<Disturbance>,
    /// On the way from gripper to bridge.
    pub to_bridge: Option<Disturbance>,
}

impl SerialGripper {
    /// A gripper that was just switched on.
    #[must_use]
    pub fn new(config: wsg_sim::Config) -> Self {
        let (gripper, port) = switch_on(config);
        Self {
            gripper,
            port,
            line: SerialLine::with_room(BYTES_PER_MS),
            seen: FrameParser::new(),
            sent: Vec::new(),
            to_gripper: None,
            to_bridge: None,
        }
    }

    /// Switches the gripper off and on again: it has forgotten everything, and its clock starts anew.
    pub fn restart(&mut self, config: wsg_sim::Config, now: Time) {
        (self.gripper, self.port) = switch_on(config);
        self.gripper.advance(now);
    }

    /// Sends bytes to the bridge that the gripper never sent.
    pub fn inject(&mut self, bytes: &[u8]) {
        self.line.bring(bytes);
    }

    /// The commands that the bridge has sent since this was last asked.
    pub fn take_sent(&mut self) -> Vec<CommandId> {
        std::mem::take(&mut self.sent)
    }

    /// Carries what was sent, both ways, and lets the gripper go on until now.
    ///
    /// # Panics
    /// When the bridge has sent a broken frame.
    pub fn advance(&mut self, now: Time) {
        let mut bytes = self.line.take_sent();
        self.note_frames(&bytes);
        if let Some(disturb) = &mut self.to_gripper {
            disturb(&mut bytes);
        }
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
        self.line.bring(&bytes);
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

/// The motion commands among these.
#[must_use]
pub fn motions(sent: Vec<CommandId>) -> Vec<CommandId> {
    sent.into_iter().filter(|id| id.kind() == Kind::Motion).collect()
}

impl std::fmt::Debug for SerialGripper {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SerialGripper").field("line", &self.line).finish_non_exhaustive()
    }
}
