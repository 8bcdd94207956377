//! What the gripper has told the bridge: the intact frames in what the bridge has read.

use wsg_bridge_fw::MAX_REPLY_LEN;
use wsg_protocol::{CommandId, Event, FrameParser, GripperState, Kind, Reply, Status, SystemFlags, Value};

/// What the bridge may know of its gripper.
pub(super) struct Told {
    /// After how long without a byte half a frame is given up, in milliseconds.
    pub(super) frame_timeout_ms: u32,
    parser: FrameParser<MAX_REPLY_LEN>,
    read_ms: u32,
    /// When the last intact frame ended.
    pub(super) heard_ms: u32,
    /// The states that were reported last, since the connection was lost.
    pub(super) flags: Option<SystemFlags>,
    pub(super) state: Option<GripperState>,
    /// The result of a grip, since another motion was sent and since a stop was answered. Until then the part may still be held.
    pub(super) grip: Option<Status>,
    /// In this turn, a report of FAST STOP was followed by one without it.
    pub(super) has_left_fast_stop: bool,
    /// What was answered by a status alone in this turn.
    answered: Vec<(CommandId, Status)>,
}

impl Told {
    pub(super) const fn new(frame_timeout_ms: u32) -> Self {
        Self {
            frame_timeout_ms,
            parser: FrameParser::new(),
            read_ms: 0,
            heard_ms: 0,
            flags: None,
            state: None,
            grip: None,
            has_left_fast_stop: false,
            answered: Vec::new(),
        }
    }

    /// The connection is lost.
    pub(super) fn forget(&mut self) {
        (self.flags, self.state, self.grip) = (None, None, None);
    }

    /// Whether the gripper reports that the fingers move, as far as it has.
    pub(super) fn moves(&self) -> bool {
        self.flags.is_some_and(|flags| flags.contains(SystemFlags::MOVING))
            || self.state.is_some_and(GripperState::is_motion)
    }

    /// Whether the gripper reports that they stand.
    pub(super) fn stands(&self) -> bool {
        self.flags.is_some() && !self.moves()
    }

    /// Whether the gripper has answered this command in this turn, for good; FAST STOP is only answered by E_SUCCESS.
    pub(super) fn is_answered(&self, command: CommandId) -> bool {
        self.answered.iter().any(|(id, status)| {
            *id == command
                && status.is_final()
                && (command != CommandId::FastStop || *status == Status::Success)
        })
    }

    /// The bridge reads this, in this turn.
    pub(super) fn read(&mut self, now_ms: u32, mut bytes: &[u8]) {
        self.answered.clear();
        self.has_left_fast_stop = false;
        if !bytes.is_empty() {
            self.read_ms = now_ms;
        }
        loop {
            let (taken, event) = self.parser.push_slice(bytes);
            bytes = &bytes[taken..];
            let Some(event) = event else { break };
            let heard = heard(&event);
            self.take(now_ms, heard);
        }
        if self.parser.is_mid_frame() && now_ms - self.read_ms >= self.frame_timeout_ms {
            while let Some(heard) = self.parser.expire().map(|event| heard(&event)) {
                self.take(now_ms, heard);
            }
        }
    }

    fn take(&mut self, now_ms: u32, heard: Heard) {
        match heard {
            Heard::Nothing => return,
            Heard::Flags(flags) => {
                let before = self.flags.replace(flags).unwrap_or_default();
                self.has_left_fast_stop |= (before - flags).contains(SystemFlags::FAST_STOP);
            }
            Heard::State(state) => self.state = Some(state),
            Heard::Status(id, status) => {
                self.answered.push((id, status));
                // A second answer of E_CMD_PENDING, after the result, changes nothing.
                if id == CommandId::GripPart && status.is_final() {
                    self.grip = Some(status);
                } else if id.kind() == Kind::Stop {
                    self.grip = None;
                }
            }
            Heard::Other => {}
        }
        self.heard_ms = now_ms;
    }
}

enum Heard {
    /// A frame that is not intact.
    Nothing,
    Flags(SystemFlags),
    State(GripperState),
    Status(CommandId, Status),
    /// Something that is not for the bridge.
    Other,
}

fn heard(event: &Event<'_>) -> Heard {
    let Event::Frame(frame) = event else { return Heard::Nothing };
    match Reply::decode(frame) {
        Err(_) => Heard::Other,
        Ok(reply) => match reply.value() {
            Some(Value::GetSystemState(flags)) => Heard::Flags(flags),
            Some(Value::GetGripperState(state)) => Heard::State(state),
            _ => Heard::Status(reply.id(), reply.status()),
        },
    }
}
