//! A gripper reduced to its states: idle, moving, holding or fast-stopped (command set, 3.2 and appendix C).
//!
//! It knows neither width nor time: actions end its motions. What `wsg-sim` answers in which order, this answers too.

use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceType, FirmwareVersion, FrameEncoder, GripperState, Kind, Reply,
    Status, SystemFlags, SystemInfo, SystemLimits, UpdateFlags, Value,
};

/// Stroke in mm, where a jog in positive direction ends.
pub(super) const STROKE: f32 = 110.0;

const INFO: SystemInfo = SystemInfo {
    device: DeviceType::Wsg50,
    hardware_revision: 1,
    firmware: FirmwareVersion::new(4, 0, 0, 0),
    serial_number: 1,
};

const LIMITS: SystemLimits = SystemLimits {
    stroke: STROKE,
    min_speed: 5.0,
    max_speed: 420.0,
    min_acceleration: 100.0,
    max_acceleration: 5_000.0,
    min_force: 5.0,
    nominal_force: 80.0,
    overdrive_force: 120.0,
};

/// A message to the bridge.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(super) struct Answer {
    pub(super) id: CommandId,
    pub(super) status: Status,
    /// System flags, gripper state, or force limit in hundredths of a newton.
    value: u32,
    /// It was delivered once already.
    pub(super) is_repeated: bool,
}

impl Answer {
    const fn status(id: CommandId, status: Status) -> Self {
        Self { id, status, value: 0, is_repeated: false }
    }

    const fn value(id: CommandId, value: u32) -> Self {
        Self { value, ..Self::status(id, Status::Success) }
    }

    /// The system flags, if it reports them.
    pub(super) fn flags(&self) -> Option<SystemFlags> {
        (self.id == CommandId::GetSystemState).then(|| SystemFlags::from_bits_retain(self.value))
    }

    /// Its frame.
    pub(super) fn bytes(self) -> impl Iterator<Item = u8> + use<> {
        let value = match self.id {
            CommandId::GetSystemInfo => Some(Value::GetSystemInfo(INFO)),
            CommandId::GetSystemLimits => Some(Value::GetSystemLimits(LIMITS)),
            CommandId::GetSystemState => {
                Some(Value::GetSystemState(SystemFlags::from_bits_retain(self.value)))
            }
            CommandId::GetGripperState => {
                GripperState::from_code(self.value as u8).map(Value::GetGripperState)
            }
            CommandId::GetForceLimit => Some(Value::GetForceLimit(self.value as f32 / 100.0)),
            CommandId::GetOpeningWidth => Some(Value::GetOpeningWidth(0.0)),
            CommandId::GetForce => Some(Value::GetForce(0.0)),
            _ => None,
        };
        let reply = value.map_or(Reply::status_only(self.id, self.status), Reply::success);
        FrameEncoder::new(self.id.code(), reply)
    }
}

/// Messages on their way to the bridge, in order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answers {
    waiting: [Answer; Self::ROOM],
    len: usize,
}

impl Answers {
    const ROOM: usize = 16;

    pub(super) const NONE: Self =
        Self { waiting: [Answer::status(CommandId::Loop, Status::Success); Self::ROOM], len: 0 };

    pub(super) fn waiting(&self) -> &[Answer] {
        &self.waiting[..self.len]
    }

    /// Appends a message. The answers to a burst of FAST STOPs count as one; a message without room is lost.
    fn push(&mut self, answer: Answer) {
        let is_of_burst = answer.id == CommandId::FastStop && self.waiting().last() == Some(&answer);
        if !is_of_burst && self.len < Self::ROOM {
            self.waiting[self.len] = answer;
            self.len += 1;
        }
    }

    pub(super) fn pop(&mut self) -> Option<Answer> {
        let first = *self.waiting().first()?;
        self.waiting.copy_within(1.., 0);
        self.len -= 1;
        Some(first)
    }

    /// The first message, which stays for a second delivery.
    pub(super) fn repeat(&mut self) -> Option<Answer> {
        let first = self.waiting[..self.len].first_mut()?;
        let once = *first;
        first.is_repeated = true;
        Some(once)
    }
}

impl std::hash::Hash for Answers {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.waiting().hash(state);
    }
}

/// The gripper.
#[derive(Clone, Debug, Hash)]
pub(super) struct Gripper {
    pub(super) referenced: bool,
    pub(super) fast_stop: bool,
    pub(super) motion: Option<CommandId>,
    pub(super) state: GripperState,
    /// In hundredths of a newton.
    pub(super) force_limit: u32,
    /// It refuses the next motion or setting.
    pub(super) refuses: bool,
    /// The last reported flags and state; none without a subscription.
    told: [Option<u32>; 2],
}

impl Gripper {
    pub(super) const SWITCHED_ON: Self = Self {
        referenced: false,
        fast_stop: false,
        motion: None,
        state: GripperState::Idle,
        force_limit: 80_00,
        refuses: false,
        told: [None; 2],
    };

    /// Takes a command and answers it.
    pub(super) fn take(&mut self, command: &Command<'_>, answers: &mut Answers) {
        let id = command.id();
        match *command {
            Command::GetSystemState { update } => {
                self.told[0] = self.subscribe(update, self.flags());
                answers.push(Answer::value(id, self.flags()));
            }
            Command::GetGripperState { update } => {
                self.told[1] = self.subscribe(update, self.state.code().into());
                answers.push(Answer::value(id, self.state.code().into()));
            }
            Command::GetForceLimit => answers.push(Answer::value(id, self.force_limit)),
            Command::Stop => {
                answers.push(Answer::status(id, Status::Success));
                self.end_motion(Status::CmdAborted, answers);
                if self.state != GripperState::Error {
                    self.state = GripperState::Idle;
                }
            }
            Command::FastStop => {
                answers.push(Answer::status(id, Status::Success));
                self.fast_stop(answers);
            }
            Command::Acknowledge { .. } => {
                self.leave_fast_stop();
                answers.push(Answer::status(id, Status::Success));
            }
            Command::SetForceLimit { force } => {
                let refused = std::mem::take(&mut self.refuses);
                if !refused {
                    self.force_limit = (force * 100.0).round() as u32;
                }
                let status = if refused { Status::CmdFormatError } else { Status::Success };
                answers.push(Answer::status(id, status));
            }
            _ if id.kind() == Kind::Motion => answers.push(Answer::status(id, self.begin(id))),
            _ if id.kind() == Kind::Query => answers.push(Answer::value(id, 0)),
            _ => panic!("{id} is no command that a bridge sends"),
        }
        self.tell(answers);
    }

    /// Ends the motion.
    pub(super) fn finish(&mut self, succeeds: bool, answers: &mut Answers) {
        let Some(id) = self.motion else { return };
        let (state, status) = match (id, succeeds) {
            (CommandId::GripPart, true) => (GripperState::Holding, Status::Success),
            (CommandId::GripPart, false) => (GripperState::NoPart, Status::CmdFailed),
            (_, true) => (GripperState::Idle, Status::Success),
            (CommandId::ReleasePart, false) => (GripperState::Error, Status::Timeout),
            (_, false) => (GripperState::Error, Status::AxisBlocked),
        };
        self.referenced |= id == CommandId::Homing && succeeds;
        self.state = state;
        self.end_motion(status, answers);
        self.tell(answers);
    }

    /// Loses the part that is held.
    pub(super) fn lose_part(&mut self, answers: &mut Answers) {
        self.state = GripperState::PartLost;
        self.tell(answers);
    }

    /// Raises FAST STOP by itself.
    pub(super) fn raise_fast_stop(&mut self, answers: &mut Answers) {
        self.fast_stop(answers);
        self.tell(answers);
    }

    /// Takes the acknowledgement of a third party.
    pub(super) fn acknowledge(&mut self, answers: &mut Answers) {
        self.leave_fast_stop();
        self.tell(answers);
    }

    fn leave_fast_stop(&mut self) {
        self.fast_stop = false;
        if self.state == GripperState::Error {
            self.state = GripperState::Idle;
        }
    }

    fn begin(&mut self, id: CommandId) -> Status {
        if self.fast_stop || std::mem::take(&mut self.refuses) {
            return Status::AccessDenied;
        }
        if self.motion.is_some() {
            return Status::AlreadyRunning;
        }
        if id == CommandId::Homing {
            self.referenced = false;
        } else if !self.referenced {
            return Status::NotInitialized;
        }
        self.motion = Some(id);
        self.state = match id {
            CommandId::GripPart => GripperState::Gripping,
            CommandId::ReleasePart => GripperState::Releasing,
            _ => GripperState::Positioning,
        };
        Status::CmdPending
    }

    fn fast_stop(&mut self, answers: &mut Answers) {
        self.fast_stop = true;
        self.state = GripperState::Error;
        self.end_motion(Status::CmdAborted, answers);
    }

    fn end_motion(&mut self, status: Status, answers: &mut Answers) {
        if let Some(id) = self.motion.take() {
            answers.push(Answer::status(id, status));
        }
    }

    fn flags(&self) -> u32 {
        let mut flags = SystemFlags::empty();
        flags.set(SystemFlags::REFERENCED, self.referenced);
        flags.set(SystemFlags::MOVING, self.motion.is_some());
        flags.set(SystemFlags::FAST_STOP, self.fast_stop);
        flags.bits()
    }

    fn subscribe(&self, update: AutoUpdate, value: u32) -> Option<u32> {
        update.flags.contains(UpdateFlags::AUTOMATIC).then_some(value)
    }

    /// Reports what has changed.
    fn tell(&mut self, answers: &mut Answers) {
        let ids = [CommandId::GetSystemState, CommandId::GetGripperState];
        let values = [self.flags(), self.state.code().into()];
        for ((told, id), value) in self.told.iter_mut().zip(ids).zip(values) {
            if told.is_some_and(|told| told != value) {
                *told = Some(value);
                answers.push(Answer::value(id, value));
            }
        }
    }
}
