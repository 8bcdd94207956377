//! The session against a small model of requested, sent and completed commands.

use wsg_protocol::session::{Config, Event, FastStopPattern, Session};
use wsg_protocol::{
    Command, CommandId, Event as FrameEvent, Frame, GripperState, HomingDirection, Instant, Kind, Payload,
    PrePositionFlags, Reply, Status, SystemFlags, Value,
};

use super::input::Input;
use crate::gripper_states::{INFO, LIMITS};

/// Tracked requests: motions, acknowledgements, settings, and a query that the session does not send by itself.
const REQUESTS: [Command<'static>; 8] = [
    Command::Homing { direction: HomingDirection::Default },
    Command::GripPart { width: 20.0, speed: 50.0 },
    Command::ReleasePart { width: 40.0, speed: 50.0 },
    Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width: 30.0, speed: 50.0 },
    Command::ACKNOWLEDGE,
    Command::SetForceLimit { force: 40.0 },
    Command::SetAcceleration { acceleration: 100.0 },
    Command::GetTemperature,
];

const STATUSES: [Status; 6] = [
    Status::Success,
    Status::CmdPending,
    Status::CmdFailed,
    Status::CmdAborted,
    Status::AccessDenied,
    Status::AxisBlocked,
];

/// Answers to the session's own queries.
const ANSWERS: [Value<'static>; 4] = [
    Value::GetSystemInfo(INFO),
    Value::GetSystemLimits(LIMITS),
    Value::GetSystemState(SystemFlags::REFERENCED),
    Value::GetGripperState(GripperState::Idle),
];

#[derive(Debug)]
struct Accepted {
    id: CommandId,
    sent: bool,
}

/// Maximum number of commands at one moment: a burst of FAST STOPs and the commands queued after it.
const MOST_COMMANDS: usize = 16 + FastStopPattern::DEFAULT.burst_frames as usize;

struct Model {
    session: Session,
    now_ms: u32,
    /// Accepted requests that have not completed.
    open: Vec<Accepted>,
}

/// Each op is a byte with parameter bytes: a request, an answer, other frames, time.
pub fn session(data: &[u8]) {
    let mut input = Input::new(data);
    let config = Config { verify_settings: input.byte() & 1 != 0, ..Config::DEFAULT };
    let mut model = Model { session: Session::new(config), now_ms: 0, open: Vec::new() };
    while !input.is_empty() {
        match input.byte() % 8 {
            0 | 1 => model.request(input.pick(&REQUESTS)),
            2 => model.request(Command::FastStop),
            3 => model.request(Command::Stop),
            4 => model.receive(input.byte(), &[input.bytes(2), &[0; 6][..]].concat()),
            5 => model.answer(input.pick(&REQUESTS).id(), input.pick(&STATUSES)),
            6 => model.answer_everything(usize::from(input.byte() % 8)),
            _ => model.pass(u32::from(input.byte()) * 4),
        }
    }
    model.end();
}

impl Model {
    fn now(&self) -> Instant {
        Instant::from_millis(self.now_ms)
    }

    fn request(&mut self, command: Command<'static>) {
        let id = command.id();
        let motion_before = self.session.motion();
        if self.session.request(command).is_ok() && id.kind() != Kind::Stop {
            if id.kind() == Kind::Motion {
                assert_eq!(motion_before, None, "one motion at a time");
                assert!(!self.session.fast_stop_pending(), "no motion while a FAST STOP is owed");
            }
            self.open.push(Accepted { id, sent: false });
        }
        self.pass(0);
    }

    fn receive(&mut self, id: u8, payload: &[u8]) {
        let event = FrameEvent::Frame(Frame { id, payload });
        if let Some(event) = self.session.handle(self.now(), &event) {
            note(&mut self.open, &event);
        }
        self.pass(0);
    }

    fn answer(&mut self, id: CommandId, status: Status) {
        let payload = status.code().to_le_bytes();
        self.receive(id.code(), &payload);
    }

    /// Answers the session's own queries, so that it connects and stays connected.
    fn answer_everything(&mut self, rounds: usize) {
        for _ in 0..rounds {
            for value in ANSWERS {
                let reply = Reply::success(value);
                let payload: Vec<u8> = (0..reply.len()).map(|at| reply.byte(at)).collect();
                self.receive(reply.id().code(), &payload);
            }
            self.pass(20);
        }
    }

    /// Advances time, then fetches all events and commands as the contract requires.
    fn pass(&mut self, ms: u32) {
        self.now_ms = self.now_ms.wrapping_add(ms);
        let now = self.now();
        let mut events = 0;
        while let Some(event) = self.session.tick(now) {
            note(&mut self.open, &event);
            events += 1;
            assert!(events < 64, "the number of events is bounded");
        }
        let mut commands = 0;
        while let Some(command) = self.session.poll_transmit(now) {
            self.sent(command.id());
            commands += 1;
            assert!(commands <= MOST_COMMANDS, "the number of commands is bounded");
        }
    }

    fn sent(&mut self, id: CommandId) {
        if matches!(id.kind(), Kind::Motion | Kind::Acknowledge) {
            let request = self.open.iter_mut().find(|open| open.id == id && !open.sent);
            request.unwrap_or_else(|| panic!("{id} was sent without a request")).sent = true;
        }
    }

    /// Checks that every request has completed after unlimited silence.
    fn end(mut self) {
        for _ in 0..40 {
            let Some(deadline) = self.session.poll_timeout() else { break };
            let ms = deadline.since(self.now()).max(1);
            self.pass(ms);
        }
        assert!(self.open.is_empty(), "requests that never completed: {:?}", self.open);
        assert!(!self.session.is_connected());
        assert_eq!(self.session.motion(), None);
    }
}

/// Removes the request that an event completes.
fn note(open: &mut Vec<Accepted>, event: &Event<'_>) {
    let (id, was_sent) = match event {
        Event::Answered(reply) => (reply.id(), true),
        Event::Unanswered(id) => (*id, true),
        Event::Withdrawn(id) => (*id, false),
        Event::Disconnected => {
            assert!(open.is_empty(), "requests were lost with the connection without an event: {open:?}");
            return;
        }
        _ => return,
    };
    if id.kind() == Kind::Stop {
        return;
    }
    let is_it = |open: &Accepted| {
        open.id == id && (!matches!(id.kind(), Kind::Motion | Kind::Acknowledge) || open.sent == was_sent)
    };
    let at = open.iter().position(is_it);
    open.remove(at.unwrap_or_else(|| panic!("{event:?} without a request")));
}
