//! A gripper reduced to its states: idle, moving, holding or fast-stopped (command set, 3.2 and appendix C).
//!
//! It has neither width nor time; the caller ends its motions. Its replies and their order match `wsg-sim`.

use wsg_protocol::{
    AutoUpdate, Command, CommandId, DeviceType, Event, FirmwareVersion, Frame, FrameEncoder, FrameParser,
    GripperState, Kind, Reply, Status, SystemFlags, SystemInfo, SystemLimits, UpdateFlags, Value,
};

/// Stroke in mm, where a jog in positive direction ends, and minimum speed in mm/s.
pub(crate) const STROKE: f32 = 110.0;
pub(crate) const LEAST_SPEED: f32 = 5.0;

pub(crate) const INFO: SystemInfo = SystemInfo {
    device: DeviceType::Wsg50,
    hardware_revision: 1,
    firmware: FirmwareVersion::new(4, 0, 0, 0),
    serial_number: 1,
};

pub(crate) const LIMITS: SystemLimits = SystemLimits {
    stroke: STROKE,
    min_speed: LEAST_SPEED,
    max_speed: 420.0,
    min_acceleration: 100.0,
    max_acceleration: 5_000.0,
    min_force: 5.0,
    nominal_force: 80.0,
    overdrive_force: 120.0,
};

/// A message to the gripper.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Message {
    pub(crate) id: CommandId,
    pub(crate) payload: Vec<u8>,
}

impl Message {
    pub(crate) fn command(&self) -> Command<'_> {
        let frame = Frame { id: self.id.code(), payload: &self.payload };
        Command::decode(&frame).expect("the bridge sends valid commands")
    }
}

impl From<Frame<'_>> for Message {
    fn from(frame: Frame<'_>) -> Self {
        Self { id: CommandId::from_code(frame.id), payload: frame.payload.to_vec() }
    }
}

/// Returns the messages in bytes from the bridge, all of which must be intact.
pub(crate) fn messages<const N: usize>(parser: &mut FrameParser<N>, mut bytes: &[u8]) -> Vec<Message> {
    let mut found = vec![];
    loop {
        let (taken, event) = parser.push_slice(bytes);
        bytes = &bytes[taken..];
        match event {
            None => return found,
            Some(Event::Frame(frame)) => found.push(frame.into()),
            Some(broken) => panic!("the bridge sent a broken frame: {broken:?}"),
        }
    }
}

/// A message to the bridge.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(crate) struct Answer {
    pub(crate) id: CommandId,
    pub(crate) status: Status,
    /// System flags, gripper state, or force limit in hundredths of a newton.
    value: u32,
}

impl Answer {
    pub(crate) const fn status(id: CommandId, status: Status) -> Self {
        Self { id, status, value: 0 }
    }

    const fn value(id: CommandId, value: u32) -> Self {
        Self { value, ..Self::status(id, Status::Success) }
    }

    /// Returns the system flags if this message reports them.
    pub(crate) fn flags(&self) -> Option<SystemFlags> {
        (self.id == CommandId::GetSystemState).then(|| SystemFlags::from_bits_retain(self.value))
    }

    /// Returns the gripper state if this message reports it.
    pub(crate) fn state(&self) -> Option<GripperState> {
        let is_state = self.id == CommandId::GetGripperState && self.status == Status::Success;
        GripperState::from_code(self.value as u8).filter(|_| is_state)
    }

    pub(crate) fn bytes(self) -> impl Iterator<Item = u8> + use<> {
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
            CommandId::GetOpeningWidth => Some(Value::GetOpeningWidth(50.0)),
            CommandId::GetForce => Some(Value::GetForce(0.0)),
            _ => None,
        };
        let value = value.filter(|_| self.status == Status::Success);
        let reply = value.map_or(Reply::status_only(self.id, self.status), Reply::success);
        FrameEncoder::new(self.id.code(), reply)
    }
}

/// An event in the gripper, apart from the commands that it receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GripperEvent {
    /// The motion succeeds.
    Finishes,
    /// The motion fails or finds no part.
    Fails,
    /// The gripped part is lost.
    LosesPart,
    /// The gripper enters FAST STOP, as at a soft limit.
    StopsFast,
    /// A third party, such as the gripper's web page, acknowledges FAST STOP.
    ThirdPartyAcknowledges,
    /// A third party stops a motion, or the monitoring of a held part.
    ThirdPartyStops,
    /// A third party starts a motion.
    ThirdPartyBegins(CommandId),
    /// The gripper rejects the next motion or setting.
    RefusesNext,
    /// The gripper is power-cycled.
    Restarts,
}

/// The gripper. Each method that changes its state passes the resulting messages to `send`.
#[derive(Clone, Debug, Hash)]
pub(crate) struct States {
    /// All flags except MOVING.
    pub(crate) flags: SystemFlags,
    pub(crate) motion: Option<CommandId>,
    /// A third party commands the motion, and receives its result.
    pub(crate) is_foreign: bool,
    pub(crate) state: GripperState,
    /// In hundredths of a newton.
    pub(crate) force_limit: u32,
    /// Whether it rejects the next motion or setting.
    pub(crate) refuses: bool,
    /// The last reported flags and state; `None` without a subscription.
    pub(crate) reported: [Option<u32>; 2],
}

impl States {
    pub(crate) const SWITCHED_ON: Self = Self {
        flags: SystemFlags::empty(),
        motion: None,
        is_foreign: false,
        state: GripperState::Idle,
        force_limit: 80_00,
        refuses: false,
        reported: [None; 2],
    };

    pub(crate) const fn fast_stop(&self) -> bool {
        self.flags.contains(SystemFlags::FAST_STOP)
    }

    pub(crate) const fn referenced(&self) -> bool {
        self.flags.contains(SystemFlags::REFERENCED)
    }

    /// Executes a command and replies.
    pub(crate) fn take(&mut self, command: &Command<'_>, send: &mut dyn FnMut(Answer)) {
        let id = command.id();
        match *command {
            Command::GetSystemState { update } => {
                self.reported[0] = subscribe(update, self.all_flags());
                send(Answer::value(id, self.all_flags()));
            }
            Command::GetGripperState { update } => {
                self.reported[1] = subscribe(update, self.state.code().into());
                send(Answer::value(id, self.state.code().into()));
            }
            Command::GetForceLimit => send(Answer::value(id, self.force_limit)),
            Command::Stop => {
                send(Answer::status(id, Status::Success));
                self.stop(send);
            }
            Command::FastStop => {
                send(Answer::status(id, Status::Success));
                self.stop_fast(send);
            }
            Command::Acknowledge { .. } => {
                self.leave_fast_stop();
                send(Answer::status(id, Status::Success));
            }
            Command::SetForceLimit { force } => {
                let refused = std::mem::take(&mut self.refuses);
                if !refused {
                    let force = force.clamp(LIMITS.min_force, LIMITS.nominal_force);
                    self.force_limit = (force * 100.0).round() as u32;
                }
                let status = if refused { Status::CmdFormatError } else { Status::Success };
                send(Answer::status(id, status));
            }
            _ if id.kind() == Kind::Motion => send(Answer::status(id, self.take_motion(id))),
            _ if id.kind() == Kind::Query => send(Answer::value(id, 0)),
            _ => panic!("{id} is not a command of the bridge"),
        }
        self.report(send);
    }

    /// Returns whether an event can occur in this state.
    pub(crate) fn allows(&self, event: GripperEvent) -> bool {
        let (moves, holds) = (self.motion.is_some(), self.state == GripperState::Holding);
        match event {
            GripperEvent::Finishes | GripperEvent::Fails | GripperEvent::StopsFast => moves,
            GripperEvent::LosesPart => holds,
            GripperEvent::ThirdPartyAcknowledges => self.fast_stop(),
            GripperEvent::ThirdPartyStops => !self.fast_stop() && (moves || holds),
            GripperEvent::ThirdPartyBegins(_) => !moves && !self.fast_stop() && self.referenced(),
            GripperEvent::RefusesNext => !self.refuses && !moves && !self.fast_stop(),
            GripperEvent::Restarts => true,
        }
    }

    /// Executes an event in any state.
    pub(crate) fn happen(&mut self, event: GripperEvent, send: &mut dyn FnMut(Answer)) {
        match event {
            GripperEvent::Finishes => self.finish(true, send),
            GripperEvent::Fails => self.finish(false, send),
            GripperEvent::LosesPart => self.state = GripperState::PartLost,
            GripperEvent::StopsFast => self.stop_fast(send),
            GripperEvent::ThirdPartyAcknowledges => self.leave_fast_stop(),
            GripperEvent::ThirdPartyStops => self.stop(send),
            GripperEvent::ThirdPartyBegins(id) => {
                self.begin(id);
                self.is_foreign = true;
            }
            GripperEvent::RefusesNext => self.refuses = true,
            GripperEvent::Restarts => *self = Self::SWITCHED_ON,
        }
        self.report(send);
    }

    fn finish(&mut self, succeeds: bool, send: &mut dyn FnMut(Answer)) {
        let Some(id) = self.motion else { return };
        let (state, status) = match (id, succeeds) {
            (CommandId::GripPart, true) => (GripperState::Holding, Status::Success),
            (CommandId::GripPart, false) => (GripperState::NoPart, Status::CmdFailed),
            (_, true) => (GripperState::Idle, Status::Success),
            (CommandId::ReleasePart, false) => (GripperState::Error, Status::Timeout),
            (_, false) => (GripperState::Error, Status::AxisBlocked),
        };
        self.flags.set(SystemFlags::REFERENCED, self.referenced() || id == CommandId::Homing && succeeds);
        self.state = state;
        self.end_motion(status, send);
    }

    /// Starts a motion in any state.
    pub(crate) fn begin(&mut self, id: CommandId) {
        self.motion = Some(id);
        self.is_foreign = false;
        self.state = match id {
            CommandId::GripPart => GripperState::Gripping,
            CommandId::ReleasePart => GripperState::Releasing,
            _ => GripperState::Positioning,
        };
    }

    /// Reports changed flags and states to subscribers.
    pub(crate) fn report(&mut self, send: &mut dyn FnMut(Answer)) {
        let ids = [CommandId::GetSystemState, CommandId::GetGripperState];
        let values = [self.all_flags(), self.state.code().into()];
        for ((reported, id), value) in self.reported.iter_mut().zip(ids).zip(values) {
            if reported.is_some_and(|reported| reported != value) {
                *reported = Some(value);
                send(Answer::value(id, value));
            }
        }
    }

    fn leave_fast_stop(&mut self) {
        self.flags -= SystemFlags::FAST_STOP;
        if self.state == GripperState::Error {
            self.state = GripperState::Idle;
        }
    }

    fn take_motion(&mut self, id: CommandId) -> Status {
        if self.fast_stop() || std::mem::take(&mut self.refuses) {
            return Status::AccessDenied;
        }
        if self.motion.is_some() {
            return Status::AlreadyRunning;
        }
        if id == CommandId::Homing {
            self.flags -= SystemFlags::REFERENCED;
        } else if !self.referenced() {
            return Status::NotInitialized;
        }
        self.begin(id);
        Status::CmdPending
    }

    fn stop(&mut self, send: &mut dyn FnMut(Answer)) {
        self.end_motion(Status::CmdAborted, send);
        if self.state != GripperState::Error {
            self.state = GripperState::Idle;
        }
    }

    fn stop_fast(&mut self, send: &mut dyn FnMut(Answer)) {
        self.flags |= SystemFlags::FAST_STOP;
        self.state = GripperState::Error;
        self.end_motion(Status::CmdAborted, send);
    }

    fn end_motion(&mut self, status: Status, send: &mut dyn FnMut(Answer)) {
        if let Some(id) = self.motion.take().filter(|_| !self.is_foreign) {
            send(Answer::status(id, status));
        }
    }

    fn all_flags(&self) -> u32 {
        let moving = if self.motion.is_some() { SystemFlags::MOVING } else { SystemFlags::empty() };
        (self.flags | moving).bits()
    }
}

fn subscribe(update: AutoUpdate, value: u32) -> Option<u32> {
    update.flags.contains(UpdateFlags::AUTOMATIC).then_some(value)
}
