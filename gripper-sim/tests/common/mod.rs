//! A client with a virtual clock, so that a test reads like a script.
#![allow(dead_code, reason = "every test file uses a part of it")]

#[cfg(feature = "std")]
pub(crate) mod program;

use wsg_protocol::{
    Command, Event, Frame, FrameEncoder, FrameParser, GripperState, HomingDirection, PrePositionFlags, Reply,
    Status, SystemFlags,
};
use wsg_sim::{Config, Fault, MAX_FRAME_LEN, Part, PortId, PortKind, Time, VirtualGripper};

/// An answer and the time of its transmission, rounded down to the millisecond.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sent {
    pub(crate) at: Time,
    pub(crate) frame: Vec<u8>,
}

impl Sent {
    /// Calls `look` with the reply in the frame.
    pub(crate) fn with<T>(&self, look: impl FnOnce(Reply<'_>) -> T) -> T {
        let payload = &self.frame[6..self.frame.len() - 2];
        look(Reply::decode(&Frame { id: self.frame[3], payload }).expect("a gripper's reply decodes"))
    }

    pub(crate) fn id(&self) -> u8 {
        self.frame[3]
    }

    pub(crate) fn status(&self) -> Status {
        self.with(|reply| reply.status())
    }

    pub(crate) fn f32(&self) -> f32 {
        f32::from_le_bytes(self.frame[8..12].try_into().expect("four bytes"))
    }

    /// Returns the frame in the words of the log: `25h Grip Part E_CMD_PENDING`.
    pub(crate) fn text(&self) -> String {
        self.with(|reply| reply.to_string())
    }
}

/// A gripper with one client and virtual time.
pub(crate) struct Rig {
    pub(crate) gripper: VirtualGripper,
    pub(crate) port: PortId,
    pub(crate) now: Time,
}

impl Rig {
    pub(crate) fn new(config: Config) -> Self {
        Self::on(PortKind::Serial, config)
    }

    pub(crate) fn on(kind: PortKind, config: Config) -> Self {
        let mut gripper = VirtualGripper::new(config);
        let port = gripper.connect(kind).expect("a port is free");
        Self { gripper, port, now: Time::ZERO }
    }

    /// Returns a referenced gripper with the fingers wide open and this part between them.
    pub(crate) fn homed(part: Option<Part>) -> Self {
        Self::homed_with(Config { part, ..Config::default() })
    }

    pub(crate) fn homed_with(config: Config) -> Self {
        let mut rig = Self::new(config);
        rig.home();
        rig
    }

    pub(crate) fn home(&mut self) {
        let done = self.run(Command::Homing { direction: HomingDirection::Positive });
        assert_eq!(done, Status::Success);
    }

    pub(crate) fn send(&mut self, command: Command<'_>) {
        self.send_bytes(&FrameEncoder::new(command.id().code(), command).collect::<Vec<u8>>());
    }

    /// Sends a frame with any payload.
    pub(crate) fn send_raw(&mut self, id: u8, payload: &[u8]) {
        self.send_bytes(&FrameEncoder::new(id, payload).collect::<Vec<u8>>());
    }

    pub(crate) fn send_bytes(&mut self, bytes: &[u8]) {
        self.gripper.receive(self.port, self.now, bytes);
    }

    /// Returns all frames that are ready.
    pub(crate) fn frames(&mut self) -> Vec<Sent> {
        self.frames_of(self.port)
    }

    pub(crate) fn frames_of(&mut self, port: PortId) -> Vec<Sent> {
        let mut frames = Vec::new();
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(frame) = self.gripper.transmit(port, &mut buffer) {
            frames.push(Sent { at: self.now, frame: frame.to_vec() });
        }
        frames
    }

    /// Sends a command and returns its first answer. Fails if other frames precede it.
    pub(crate) fn ask(&mut self, command: Command<'_>) -> Sent {
        self.send(command);
        let frames = self.frames();
        assert_eq!(frames.len(), 1, "one answer to {command}: {:?}", texts(&frames));
        assert_eq!(frames[0].id(), command.id().code());
        frames.into_iter().next().expect("one frame")
    }

    pub(crate) fn status(&mut self, command: Command<'_>) -> Status {
        self.ask(command).status()
    }

    /// Advances time in steps of a millisecond and returns the frames sent meanwhile.
    pub(crate) fn wait(&mut self, millis: u64) -> Vec<Sent> {
        let mut frames = Vec::new();
        for _ in 0..millis {
            self.now = self.now.plus_millis(1);
            self.gripper.advance(self.now);
            frames.extend(self.frames());
        }
        frames
    }

    /// Advances time to the next frame.
    pub(crate) fn next(&mut self) -> Sent {
        for _ in 0..120_000 {
            if let Some(sent) = self.wait(1).into_iter().next() {
                return sent;
            }
        }
        panic!("nothing was sent for two minutes")
    }

    /// Runs a motion to its end and returns its second status.
    pub(crate) fn run(&mut self, command: Command<'_>) -> Status {
        assert_eq!(self.status(command), Status::CmdPending, "{command}");
        let done = self.next();
        assert_eq!(done.id(), command.id().code());
        done.status()
    }

    pub(crate) fn state(&self) -> GripperState {
        self.gripper.state().gripper
    }

    pub(crate) fn flags(&self) -> SystemFlags {
        self.gripper.state().flags
    }

    pub(crate) fn width(&self) -> f32 {
        self.gripper.state().width
    }

    pub(crate) fn force(&self) -> f32 {
        self.gripper.state().force
    }

    pub(crate) fn set_part(&mut self, width: Option<f32>) {
        let part = width.map(|width| Part::of_width(width).expect("a sensible part"));
        self.gripper.set_part(part, self.now);
    }

    pub(crate) fn set_fault(&mut self, fault: Fault, on: bool) {
        self.gripper.set_fault(fault, on, self.now);
    }
}

pub(crate) fn grip(width: f32) -> Command<'static> {
    Command::GripPart { width, speed: 100.0 }
}

pub(crate) fn release(width: f32) -> Command<'static> {
    Command::ReleasePart { width, speed: 200.0 }
}

pub(crate) fn go_to(width: f32) -> Command<'static> {
    Command::PrePosition { flags: PrePositionFlags::empty(), width, speed: 100.0 }
}

pub(crate) fn go_by(offset: f32) -> Command<'static> {
    Command::PrePosition { flags: PrePositionFlags::RELATIVE, width: offset, speed: 100.0 }
}

pub(crate) fn go_to_or_stop(width: f32) -> Command<'static> {
    Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed: 100.0 }
}

pub(crate) fn texts(frames: &[Sent]) -> Vec<String> {
    frames.iter().map(Sent::text).collect()
}

/// Parses a sequence of complete frames.
pub(crate) fn parse(bytes: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut parser = FrameParser::<1016>::new();
    let mut frames = Vec::new();
    let mut take = |event: Option<Event<'_>>| {
        if let Some(Event::Frame(frame)) = event {
            frames.push((frame.id, frame.payload.to_vec()));
        }
        event.is_some()
    };
    for byte in bytes {
        let mut more = take(parser.push(*byte));
        while more {
            more = take(parser.poll());
        }
    }
    while take(parser.expire()) {}
    frames
}
