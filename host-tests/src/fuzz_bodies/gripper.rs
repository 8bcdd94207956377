//! The gripper's end, for the bodies of the whole bridge: what the bridge says to it, and a gripper that does what it is told
//! and answers late, twice, or not at all.

use wsg_protocol::frame::{OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};
use wsg_protocol::{
    Command, CommandId, DeviceType, Event, FirmwareVersion, Frame, FrameEncoder, FrameParser, GripperState,
    Kind, Reply, Status, SystemFlags, SystemInfo, SystemLimits, UpdateFlags, Value,
};

use super::input::Input;

/// What each message begins with.
pub(super) const PREAMBLE: [u8; PREAMBLE_LEN] = [PREAMBLE_BYTE; PREAMBLE_LEN];

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

/// An answer that is a status and no more.
pub(super) fn status(id: CommandId, status: Status) -> Vec<u8> {
    frame(Reply::status_only(id, status))
}

fn frame(reply: Reply<'_>) -> Vec<u8> {
    FrameEncoder::new(reply.id().code(), reply).collect()
}

/// The opening width of the gripper at the end of its stroke in mm, and its least speed in mm/s.
pub(super) const STROKE: f32 = 110.0;
pub(super) const LEAST_SPEED: f32 = 5.0;

const LIMITS: SystemLimits = SystemLimits {
    stroke: STROKE,
    min_speed: LEAST_SPEED,
    max_speed: 420.0,
    min_acceleration: 100.0,
    max_acceleration: 5_000.0,
    min_force: 5.0,
    nominal_force: 80.0,
    overdrive_force: 120.0,
};

const INFO: SystemInfo = SystemInfo {
    device: DeviceType::Wsg50,
    hardware_revision: 2,
    firmware: FirmwareVersion::new(3, 1, 2, 0),
    serial_number: 1,
};

/// What becomes of a command and its answer.
#[derive(Clone, Copy)]
enum Delivery {
    /// Carried out, and answered so many milliseconds later.
    Late(u32),
    /// Answered at once and so many milliseconds later.
    Twice(u32),
    /// Carried out, not answered.
    Unanswered,
    /// Refused.
    Refused,
    /// Not heard; nor is anything behind it before so many bytes have come, or nothing for a while.
    Unheard(u32),
}

impl Delivery {
    fn of(byte: u8) -> Self {
        match byte {
            0..=200 => Self::Late(byte.into()),
            201..=223 => Self::Twice(u32::from(byte - 200) * 9),
            224..=235 => Self::Unanswered,
            236..=239 => Self::Refused,
            _ => Self::Unheard(u32::from(byte - 240) * 68),
        }
    }
}

/// After how long without a byte the gripper gives up half a frame, in milliseconds.
const FRAME_TIMEOUT_MS: u32 = 500;

/// How soon FAST STOP reaches a gripper: behind the last fault, and where there was one at the most.
const HEALTHY_MS: u32 = 1_000;
const ONE_FAULT_MS: u32 = 250;

/// A motion lasts so many times as long as an answer.
const MOTION_FACTOR: u32 = 4;

/// What else may be the matter with a gripper: the flags that it reports, and whether there is a part to grip.
const CONDITIONS: [(SystemFlags, bool); 8] = [
    (SystemFlags::REFERENCED, true),
    (SystemFlags::REFERENCED, false),
    (SystemFlags::empty(), true),
    (SystemFlags::REFERENCED.union(SystemFlags::TEMP_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::POWER_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::CURR_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::FINGER_FAULT), true),
    (SystemFlags::REFERENCED.union(SystemFlags::FAST_STOP), true),
];

/// A gripper that does what it is told.
pub(super) struct Gripper {
    answers: bool,
    /// What becomes of one command and answer after the other, the last one for all that follow; none: answered at once.
    deliveries: Vec<u8>,
    delivered: usize,
    /// Answers and reports on their way, and when they arrive.
    on_the_way: Vec<(u32, Vec<u8>)>,
    last_arrives_ms: u32,
    flags: SystemFlags,
    state: GripperState,
    has_part: bool,
    force_limit: f32,
    /// The motion that is carried out, and when it ends.
    motion: Option<(CommandId, u32)>,
    /// It reports its states when they change.
    reports: bool,
    /// It waits for so many bytes of a frame that does not exist, and got the last one then.
    deaf: (u32, u32),
    /// When something went wrong on the line, the last two times.
    faults: [Option<u32>; 2],
    /// Somebody else has spoken in its name.
    is_forged: bool,
    /// When it heard a FAST STOP, and when it left one that the bridge has not acknowledged.
    fast_stop_ms: Option<u32>,
    left_ms: Option<u32>,
    /// It has forgotten its force limit, and was neither homed nor given another one since.
    is_restarted: bool,
}

impl Gripper {
    /// One that is referenced and stands, and says nothing.
    pub(super) fn new() -> Self {
        let (flags, has_part) = CONDITIONS[0];
        Self {
            answers: false,
            deliveries: Vec::new(),
            delivered: 0,
            on_the_way: Vec::new(),
            last_arrives_ms: 0,
            flags,
            state: GripperState::Idle,
            has_part,
            force_limit: LIMITS.nominal_force,
            motion: None,
            reports: false,
            deaf: (0, 0),
            faults: [None; 2],
            is_forged: false,
            fast_stop_ms: None,
            left_ms: None,
            is_restarted: false,
        }
    }

    /// Its fingers move, and go on until they are stopped.
    pub(super) fn run(&mut self) {
        self.begin(CommandId::PrePosition, u32::MAX);
    }

    /// It answers from now on, at once.
    pub(super) fn answer(&mut self) {
        self.answers = true;
        self.deliveries.clear();
    }

    /// A byte says whether it answers (bit 0), how many bytes follow that say what becomes of one command and answer after the
    /// other (bits 1 to 3), and its condition (bits 4 to 6). Condition 2 is a restart. With bit 7 it begins to move or loses
    /// its part; a third party acknowledges its FAST STOP if that is its condition.
    pub(super) fn change(&mut self, now_ms: u32, input: &mut Input<'_>) {
        let how = input.byte();
        let was_dead = !std::mem::replace(&mut self.answers, how & 1 != 0);
        if was_dead && self.answers {
            // It was no single fault: what it has missed meanwhile may be a whole burst of FAST STOPs.
            self.faults = [Some(now_ms); 2];
        }
        self.deliveries = input.bytes(usize::from(how >> 1 & 7)).to_vec();
        self.delivered = 0;
        let (flags, has_part) = CONDITIONS[usize::from(how >> 4 & 7)];
        let was_fast_stopped = self.flags.contains(SystemFlags::FAST_STOP);
        (self.flags, self.has_part) = (flags | self.flags & SystemFlags::FAST_STOP, has_part);
        let is_acknowledged = flags.contains(SystemFlags::FAST_STOP) && how & 0x80 != 0;
        if is_acknowledged || flags.is_empty() {
            self.flags -= SystemFlags::FAST_STOP;
            self.left_ms = if was_fast_stopped { Some(now_ms) } else { self.left_ms };
        }
        if is_acknowledged && self.state == GripperState::Error {
            self.state = GripperState::Idle;
        }
        if flags.is_empty() {
            (self.motion, self.reports, self.state) = (None, false, GripperState::Idle);
            (self.force_limit, self.on_the_way) = (LIMITS.nominal_force, Vec::new());
            self.is_restarted = true;
        }
        if self.flags.contains(SystemFlags::FAST_STOP) {
            self.abort(now_ms, Delivery::Late(0));
            self.state = GripperState::Error;
        }
        if how & 0x80 != 0 {
            if self.state == GripperState::Holding {
                self.state = GripperState::PartLost;
            } else if self.motion.is_none() && !self.flags.contains(SystemFlags::FAST_STOP) {
                self.begin(CommandId::PrePosition, now_ms + MOTION_FACTOR * 200);
            }
        }
        if how >> 4 != 0 {
            self.report(now_ms, Delivery::Late(0));
        }
    }

    /// Hears a command.
    pub(super) fn hear(&mut self, now_ms: u32, message: &Message) {
        let delivery = self.delivery();
        if !matches!(delivery, Delivery::Late(_)) || !self.answers {
            self.fault(now_ms);
        }
        if !self.hears(now_ms, message, delivery) {
            return;
        }
        let id = message.id;
        if matches!(delivery, Delivery::Refused) {
            return self.send(now_ms, delivery, &status(id, Status::AccessDenied));
        }
        let command = message.command();
        let before = (self.system_flags(), self.state);
        let mut value = None;
        let mut result = Status::Success;
        match command {
            Command::GetSystemInfo => value = Some(Value::GetSystemInfo(INFO)),
            Command::GetSystemLimits => value = Some(Value::GetSystemLimits(LIMITS)),
            Command::GetForceLimit => value = Some(Value::GetForceLimit(self.force_limit)),
            Command::GetSystemState { update } => {
                self.reports = update.flags.contains(UpdateFlags::AUTOMATIC);
                value = Some(Value::GetSystemState(self.system_flags()));
            }
            Command::GetGripperState { .. } => value = Some(Value::GetGripperState(self.state)),
            Command::GetOpeningWidth { .. } => value = Some(Value::GetOpeningWidth(50.0)),
            Command::GetForce { .. } => value = Some(Value::GetForce(0.0)),
            Command::SetForceLimit { force } => {
                self.is_restarted = false;
                self.force_limit = force.clamp(LIMITS.min_force, LIMITS.nominal_force);
            }
            Command::FastStop => {
                self.fast_stop_ms = Some(now_ms);
                self.abort(now_ms, delivery);
                self.flags |= SystemFlags::FAST_STOP;
                self.state = GripperState::Error;
            }
            Command::Stop => {
                self.abort(now_ms, delivery);
                self.state = GripperState::Idle;
            }
            Command::Acknowledge { .. } => {
                self.flags -= SystemFlags::FAST_STOP;
                self.state = if self.motion.is_some() { self.state } else { GripperState::Idle };
            }
            _ if id.kind() == Kind::Motion => result = self.take_motion(now_ms, id),
            other => panic!("the bridge has no use for {other:?}"),
        }
        let reply = value.map_or(Reply::status_only(id, result), Reply::success);
        self.send(now_ms, delivery, &frame(reply));
        if before != (self.system_flags(), self.state) {
            self.report(now_ms, delivery);
        }
    }

    /// Something goes wrong on the line.
    pub(super) fn fault(&mut self, now_ms: u32) {
        if self.faults[0] != Some(now_ms) {
            self.faults = [Some(now_ms), self.faults[0]];
        }
    }

    /// These bytes reach the bridge, and the gripper did not say them: noise, or something that the bridge takes for its word.
    pub(super) fn forge(&mut self, now_ms: u32, bytes: &[u8]) {
        self.fault(now_ms);
        self.is_forged |= bytes.windows(PREAMBLE.len()).any(|window| window == PREAMBLE);
    }

    /// The force limit in hundredths, if the bridge can know it. A gripper that was restarted refuses to grip until it is homed.
    pub(super) fn force_limit(&self) -> Option<i32> {
        (!self.is_forged && !self.is_restarted).then_some((self.force_limit * 100.0).round() as i32)
    }

    /// Whether the gripper has heard a FAST STOP since it was asked for, or may still have to wait for it. One that is dead
    /// cannot hear. While it `is_held`, one that has left it must hear another.
    pub(super) fn has_stopped(&self, now_ms: u32, asked_ms: u32, is_held: bool) -> bool {
        // The bridge learns of it by a report, which may be late or lost.
        if let Some(left_ms) = self.left_ms.filter(|left_ms| is_held && *left_ms > asked_ms) {
            let healthy_ms = self.faults[0].map_or(left_ms, |fault_ms| fault_ms.max(left_ms));
            let has_heard = self.fast_stop_ms.is_some_and(|heard_ms| heard_ms >= left_ms);
            return has_heard || !self.answers || self.is_forged || now_ms <= healthy_ms + HEALTHY_MS;
        }
        let latest_ms = match self.faults {
            [Some(last_ms), Some(second_ms)] if second_ms + HEALTHY_MS > asked_ms => {
                last_ms.max(asked_ms) + HEALTHY_MS
            }
            _ => asked_ms + ONE_FAULT_MS,
        };
        let has_heard = self.fast_stop_ms.is_some_and(|heard_ms| heard_ms >= asked_ms);
        has_heard || !self.answers || self.is_forged || now_ms <= latest_ms
    }

    fn hears(&mut self, now_ms: u32, message: &Message, delivery: Delivery) -> bool {
        let (left, last_ms) = std::mem::replace(&mut self.deaf, (0, now_ms));
        if !self.answers {
            return false;
        }
        let length = (OVERHEAD + message.payload.len()) as u32;
        let left = if now_ms - last_ms >= FRAME_TIMEOUT_MS { 0 } else { left };
        self.deaf.0 = match delivery {
            _ if left > 0 => left.saturating_sub(length),
            Delivery::Unheard(bytes) => bytes,
            _ => 0,
        };
        left == 0 && !matches!(delivery, Delivery::Unheard(_))
    }

    /// What arrives at the bridge now.
    pub(super) fn speak(&mut self, now_ms: u32) -> Vec<Vec<u8>> {
        if let Some((id, ends_ms)) = self.motion
            && now_ms >= ends_ms
        {
            self.end(now_ms, id);
        }
        let mut arrived = Vec::new();
        self.on_the_way.retain_mut(|(arrives_ms, frame)| {
            let is_there = now_ms >= *arrives_ms;
            if is_there {
                arrived.push(std::mem::take(frame));
            }
            !is_there
        });
        if self.answers { arrived } else { vec![] }
    }

    fn take_motion(&mut self, now_ms: u32, id: CommandId) -> Status {
        if self.flags.contains(SystemFlags::FAST_STOP) {
            return Status::AccessDenied;
        }
        if self.motion.is_some() {
            return Status::AlreadyRunning;
        }
        if !self.flags.contains(SystemFlags::REFERENCED) && id != CommandId::Homing {
            return Status::NotInitialized;
        }
        let lasts_ms = match self.delivery() {
            Delivery::Late(ms) | Delivery::Twice(ms) => ms * MOTION_FACTOR,
            // Until it is stopped.
            Delivery::Unanswered | Delivery::Refused | Delivery::Unheard(_) => u32::MAX / 2,
        };
        self.begin(id, now_ms + lasts_ms);
        Status::CmdPending
    }

    fn begin(&mut self, id: CommandId, ends_ms: u32) {
        self.motion = Some((id, ends_ms));
        self.state = match id {
            CommandId::GripPart => GripperState::Gripping,
            CommandId::ReleasePart => GripperState::Releasing,
            _ => GripperState::Positioning,
        };
    }

    fn end(&mut self, now_ms: u32, id: CommandId) {
        self.motion = None;
        let finds_none = id == CommandId::GripPart && !self.has_part;
        self.state = match id {
            CommandId::GripPart if finds_none => GripperState::NoPart,
            CommandId::GripPart => GripperState::Holding,
            _ => GripperState::Idle,
        };
        if id == CommandId::Homing {
            self.is_restarted = false;
            self.flags |= SystemFlags::REFERENCED;
        }
        let delivery = self.delivery();
        self.send(
            now_ms,
            delivery,
            &status(id, if finds_none { Status::CmdFailed } else { Status::Success }),
        );
        self.report(now_ms, delivery);
    }

    fn abort(&mut self, now_ms: u32, delivery: Delivery) {
        if let Some((id, _)) = self.motion.take() {
            self.send(now_ms, delivery, &status(id, Status::CmdAborted));
        }
    }

    fn system_flags(&self) -> SystemFlags {
        let moving = if self.motion.is_some() { SystemFlags::MOVING } else { SystemFlags::empty() };
        self.flags | moving
    }

    fn delivery(&mut self) -> Delivery {
        let byte = self.deliveries.get(self.delivered).or(self.deliveries.last());
        self.delivered += 1;
        Delivery::of(byte.copied().unwrap_or(0))
    }

    /// Answers do not overtake each other.
    fn send(&mut self, now_ms: u32, delivery: Delivery, frame: &[u8]) {
        let (first_ms, second_ms) = match delivery {
            Delivery::Late(ms) => (ms, None),
            Delivery::Refused => (0, None),
            Delivery::Twice(ms) => (0, Some(ms)),
            Delivery::Unanswered | Delivery::Unheard(_) => return,
        };
        self.last_arrives_ms = self.last_arrives_ms.max(now_ms + first_ms);
        self.on_the_way.push((self.last_arrives_ms, frame.to_vec()));
        self.on_the_way.extend(second_ms.map(|ms| (self.last_arrives_ms + ms, frame.to_vec())));
    }

    fn report(&mut self, now_ms: u32, delivery: Delivery) {
        if self.reports {
            for value in [Value::GetSystemState(self.system_flags()), Value::GetGripperState(self.state)] {
                self.send(now_ms, delivery, &frame(Reply::success(value)));
            }
        }
    }
}
