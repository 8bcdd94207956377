//! The gripper's end, for the bodies of the whole bridge: what the bridge says to it, and one that succeeds in everything.

use wsg_protocol::{Command, CommandId, Event, Frame, FrameEncoder, FrameParser, Kind, Reply, Status};

/// A message by value.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Message {
    pub(super) id: CommandId,
    payload: Vec<u8>,
}

impl Message {
    /// What it asks for.
    pub(super) fn command(&self) -> Command<'_> {
        let frame = Frame { id: self.id.code(), payload: &self.payload };
        Command::decode(&frame).expect("the bridge says what is allowed")
    }
}

impl From<Frame<'_>> for Message {
    fn from(frame: Frame<'_>) -> Self {
        Self { id: CommandId::from_code(frame.id), payload: frame.payload.to_vec() }
    }
}

/// The messages in what the bridge says, all of them intact.
pub(super) fn messages(parser: &mut FrameParser<64>, mut said: &[u8]) -> Vec<Message> {
    let mut found = vec![];
    loop {
        let (taken, event) = parser.push_slice(said);
        said = &said[taken..];
        match event {
            None => return found,
            Some(Event::Frame(frame)) => found.push(frame.into()),
            Some(broken) => panic!("the bridge sends a broken frame: {broken:?}"),
        }
    }
}

/// The opening width of the gripper at the end of its stroke in mm, and its least speed in mm/s.
pub(super) const STROKE: f32 = 110.0;
pub(super) const LEAST_SPEED: f32 = 5.0;

/// What the gripper answers to a request with this id, message by message.
pub(super) fn answers(id: CommandId) -> Vec<Vec<u8>> {
    let limits = [STROKE, LEAST_SPEED, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0];
    let value = match id {
        CommandId::GetSystemInfo => vec![1, 2, 0x20, 0x31, 1, 0, 0, 0],
        CommandId::GetSystemState => vec![1, 0, 0, 0],
        CommandId::GetGripperState => vec![0],
        CommandId::GetSystemLimits => limits.map(f32::to_le_bytes).concat(),
        _ => vec![],
    };
    let success = FrameEncoder::new(id.code(), &[&[0, 0], &value[..]].concat()[..]).collect();
    if id.kind() == Kind::Motion { vec![status(id, Status::CmdPending), success] } else { vec![success] }
}

/// An answer that is a status and no more.
pub(super) fn status(id: CommandId, status: Status) -> Vec<u8> {
    FrameEncoder::new(id.code(), Reply::status_only(id, status)).collect()
}
