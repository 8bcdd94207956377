//! Reports of the gripper: intact frames in the bytes read by the bridge.

use std::hash::{Hash, Hasher};

use wsg_bridge_fw::MAX_REPLY_LEN;
use wsg_protocol::{
    CommandId, Event, FrameParser, GripperState, Instant, Kind, Reply, Status, SystemFlags, Value,
};

use super::gstate::GstateRule;
use crate::gripper_states::Answer;

/// State of the gripper as known to the bridge.
#[derive(Clone, Debug)]
pub(crate) struct Reports {
    /// Time-out of an incomplete frame, in milliseconds.
    pub(crate) frame_timeout_ms: u32,
    parser: FrameParser<MAX_REPLY_LEN>,
    now: Instant,
    read: Instant,
    /// End of the last intact frame.
    pub(super) received: Instant,
    /// Last reported states since the connection was lost.
    pub(super) flags: Option<SystemFlags>,
    pub(super) state: Option<GripperState>,
    /// The rule of GSTATE.
    pub(super) gstate: GstateRule,
    /// Result of the last grip, until another motion is sent or a stop is confirmed; until then the part may be held.
    pub(super) grip: Option<Status>,
    /// Whether FAST STOP was reported and then cleared in this turn.
    pub(super) has_left_fast_stop: bool,
    /// Status-only answers in this turn.
    answered: Vec<(CommandId, Status)>,
}

impl Hash for Reports {
    /// Ignores what the bridge stores as well, and the time of the last frame, or few states would be equal.
    fn hash<H: Hasher>(&self, state: &mut H) {
        (&self.gstate, self.grip).hash(state);
    }
}

impl Reports {
    pub(super) const fn new(now: Instant, frame_timeout_ms: u32) -> Self {
        Self {
            frame_timeout_ms,
            parser: FrameParser::new(),
            now,
            read: now,
            received: now,
            flags: None,
            state: None,
            gstate: GstateRule::new(),
            grip: None,
            has_left_fast_stop: false,
            answered: Vec::new(),
        }
    }

    /// Discards all states after the loss of the connection.
    pub(super) fn forget(&mut self) {
        (self.flags, self.state, self.grip) = (None, None, None);
        self.gstate.disconnect();
    }

    /// Returns whether the gripper has reported moving fingers.
    pub(super) fn moves(&self) -> bool {
        self.flags.is_some_and(|flags| flags.contains(SystemFlags::MOVING))
            || self.state.is_some_and(GripperState::is_motion)
    }

    /// Returns whether the gripper has reported fingers at rest.
    pub(super) fn stands(&self) -> bool {
        self.flags.is_some() && !self.moves()
    }

    /// Returns whether this command received a final answer in this turn; for FAST STOP only E_SUCCESS counts.
    pub(super) fn is_answered(&self, command: CommandId) -> bool {
        self.answered.iter().any(|(id, status)| {
            *id == command
                && status.is_final()
                && (command != CommandId::FastStop || *status == Status::Success)
        })
    }

    pub(super) fn begin_turn(&mut self, now: Instant) {
        self.now = now;
        self.answered.clear();
        self.has_left_fast_stop = false;
    }

    /// Processes bytes read by the bridge in this turn.
    pub(crate) fn read(&mut self, mut bytes: &[u8]) {
        if !bytes.is_empty() {
            self.read = self.now;
        }
        loop {
            let (taken, event) = self.parser.push_slice(bytes);
            bytes = &bytes[taken..];
            let Some(event) = event else { break };
            let report = report(&event);
            self.take(report);
        }
        if self.parser.is_mid_frame() && self.now.since(self.read) >= self.frame_timeout_ms {
            while let Some(report) = self.parser.expire().map(|event| report(&event)) {
                self.take(report);
            }
        }
    }

    /// Processes a message that reaches the bridge intact in this turn.
    pub(crate) fn receive(&mut self, answer: &Answer) {
        self.take(match (answer.flags(), answer.state()) {
            (Some(flags), _) => Report::Flags(flags),
            (None, Some(state)) => Report::State(state),
            (None, None) => Report::Status(answer.id, answer.status),
        });
    }

    fn take(&mut self, report: Report) {
        match report {
            Report::Nothing => return,
            Report::Flags(flags) => {
                let before = self.flags.replace(flags).unwrap_or_default();
                self.has_left_fast_stop |= (before - flags).contains(SystemFlags::FAST_STOP);
            }
            Report::State(state) => {
                self.state = Some(state);
                self.gstate.report(state);
            }
            Report::Status(id, status) => {
                self.answered.push((id, status));
                self.gstate.answer(id, status);
                // A further E_CMD_PENDING after the result has no effect.
                if id == CommandId::GripPart && status.is_final() {
                    self.grip = Some(status);
                } else if id.kind() == Kind::Stop {
                    self.grip = None;
                }
            }
            Report::Other => {}
        }
        self.received = self.now;
    }
}

enum Report {
    Nothing,
    Flags(SystemFlags),
    State(GripperState),
    Status(CommandId, Status),
    /// A frame that does not concern the bridge.
    Other,
}

fn report(event: &Event<'_>) -> Report {
    let Event::Frame(frame) = event else { return Report::Nothing };
    match Reply::decode(frame) {
        Err(_) => Report::Other,
        Ok(reply) => match reply.value() {
            Some(Value::GetSystemState(flags)) => Report::Flags(flags),
            Some(Value::GetGripperState(state)) => Report::State(state),
            _ => Report::Status(reply.id(), reply.status()),
        },
    }
}
