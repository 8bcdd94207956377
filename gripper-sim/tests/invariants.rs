//! Random sequences of requests, parts, faults and pauses, after which these invariants must hold.

mod common;

use common::Sent;
use proptest::prelude::*;
use std::collections::HashMap;
use wsg_protocol::{
    AutoUpdate, Command, CommandId, Frame, FrameEncoder, GripperState, HomingDirection, Kind, LoopData,
    PrePositionFlags, Reply, SoftLimits, Status, SystemFlags, UpdateFlags, Value,
};
use wsg_sim::{
    Config, Fault, Finger, Jaw, MAX_FRAME_LEN, Part, PortId, PortKind, State, Time, VirtualGripper,
};

#[derive(Clone, Copy, Debug)]
enum Op {
    Send(Command<'static>),
    Raw(u8, [u8; 4]),
    SetPart(Option<Part>),
    SetFault(Fault, bool),
    Wait { millis: u16 },
    Reconnect,
}

fn widths() -> impl Strategy<Value = f32> {
    prop_oneof![4 => -20f32..140.0, 1 => Just(20.0), 1 => Just(0.0), 1 => Just(110.0)]
}

fn commands() -> impl Strategy<Value = Command<'static>> {
    let speeds = || 0f32..900.0;
    let motions = prop_oneof![
        (0usize..3).prop_map(|at| Command::Homing { direction: HomingDirection::ALL[at] }),
        (0u8..4, widths(), speeds()).prop_map(|(flags, width, speed)| Command::PrePosition {
            flags: PrePositionFlags::from_bits_retain(flags),
            width,
            speed
        }),
        (widths(), speeds()).prop_map(|(width, speed)| Command::GripPart { width, speed }),
        (widths(), speeds()).prop_map(|(width, speed)| Command::ReleasePart { width, speed }),
    ];
    let others = prop_oneof![
        Just(Command::Stop),
        Just(Command::FastStop),
        Just(Command::ACKNOWLEDGE),
        Just(Command::ACKNOWLEDGE),
        Just(Command::ClearSoftLimits),
        (widths(), widths())
            .prop_map(|(minus, plus)| Command::SetSoftLimits { limits: SoftLimits { minus, plus } }),
        (0f32..9_000.0).prop_map(|acceleration| Command::SetAcceleration { acceleration }),
        (0f32..200.0).prop_map(|force| Command::SetForceLimit { force }),
        any::<bool>().prop_map(|enabled| Command::OverdriveMode { enabled }),
        any::<bool>().prop_map(|enabled| Command::Finger1Power { enabled }),
        any::<bool>().prop_map(|enabled| Command::Finger2Power { enabled }),
        Just(Command::TareForceSensor),
        Just(Command::GetFinger1Data),
        Just(Command::GetFinger2Data),
        Just(Command::GetSoftLimits),
        Just(Command::GetAcceleration),
        Just(Command::GetForceLimit),
        Just(Command::GetTemperature),
        any::<bool>().prop_map(|reset| Command::GetGrippingStatistics { reset }),
        Just(Command::DisconnectAnnouncement),
        (0u8..4, 0u16..60, 0usize..5).prop_map(|(flags, period_ms, which)| {
            let update = AutoUpdate { flags: UpdateFlags::from_bits_retain(flags), period_ms };
            [
                Command::GetSystemState { update },
                Command::GetGripperState { update },
                Command::GetOpeningWidth { update },
                Command::GetSpeed { update },
                Command::GetForce { update },
            ][which]
        }),
    ];
    prop_oneof![3 => motions, 2 => others]
}

fn parts() -> impl Strategy<Value = Option<Part>> {
    proptest::option::of((1f32..120.0, 1f32..500.0, proptest::option::of(0.1f32..0.9)).prop_map(
        |(width, stiffness, hole)| {
            let solid = Part::new(width, stiffness).expect("both are above 0");
            hole.map_or(solid, |hole| solid.with_inner_width(hole * width).expect("it is narrower"))
        },
    ))
}

fn faults() -> impl Strategy<Value = Fault> {
    prop_oneof![
        Just(Fault::AxisBlocked),
        Just(Fault::OverTemperature),
        Just(Fault::SupplyOutOfRange),
        Just(Fault::MotorCurrent),
        Just(Fault::FingerShortCircuit(Jaw::One)),
        Just(Fault::FingerCommunication(Jaw::Two)),
    ]
}

fn op() -> impl Strategy<Value = Op> {
    prop_oneof![
        12 => commands().prop_map(Op::Send),
        1 => (any::<u8>(), any::<[u8; 4]>()).prop_map(|(id, payload)| Op::Raw(id, payload)),
        2 => parts().prop_map(Op::SetPart),
        1 => (faults(), any::<bool>()).prop_map(|(fault, on)| Op::SetFault(fault, on)),
        8 => (0u16..1_500).prop_map(|millis| Op::Wait { millis }),
        1 => Just(Op::Reconnect),
    ]
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    // Starts with homing, so that most sequences get past the reference.
    proptest::collection::vec(op(), 1..80).prop_map(|mut ops| {
        ops.insert(0, Op::Send(Command::Homing { direction: HomingDirection::Positive }));
        ops.insert(1, Op::Wait { millis: 3_000 });
        ops
    })
}

/// The state that a gripper must keep, independent of the physics.
struct ReferenceModel {
    acceleration: f32,
    force_limit: f32,
    overdrive: bool,
    soft_limits: Option<SoftLimits>,
    total: u32,
    no_part: u16,
    /// Grips whose outcome was reported to no client, because their client was gone.
    unreported_grips: u16,
    /// A part held when the counts were reset may still be lost.
    held_at_reset: bool,
    /// Whether a FAST STOP has been caused and not acknowledged.
    must_be_stopped: bool,
    /// Whether a FAST STOP has just been acknowledged. Another one requires that its cause lasts.
    was_acknowledged: bool,
    /// Number of motions in progress.
    motions: usize,
}

impl ReferenceModel {
    /// Faults that refuse every motion until they end.
    const DISABLING: SystemFlags = SystemFlags::TEMP_FAULT.union(SystemFlags::POWER_FAULT);

    fn new() -> Self {
        Self {
            acceleration: 1_000.0,
            force_limit: 40.0,
            overdrive: false,
            soft_limits: None,
            total: 0,
            no_part: 0,
            unreported_grips: 0,
            held_at_reset: false,
            must_be_stopped: false,
            was_acknowledged: false,
            motions: 0,
        }
    }

    const fn greatest_force(&self) -> f32 {
        if self.overdrive { 120.0 } else { 80.0 }
    }

    /// Records the first answer to a command; `before` is the state before it.
    fn answered(&mut self, command: &Command<'_>, reply: Reply<'_>, before: &State) {
        let status = reply.status();
        if status == Status::CmdPending && command.id().kind() == Kind::Motion {
            assert!(!before.flags.contains(SystemFlags::FAST_STOP), "FAST STOP refuses {command}");
            assert!(!before.flags.intersects(Self::DISABLING), "a fault refuses {command}");
            assert_eq!(self.motions, 0, "only one motion at a time: {command}");
            self.motions += 1;
            self.total += u32::from(matches!(command, Command::GripPart { .. }));
        }
        if status != Status::Success {
            return;
        }
        match *command {
            Command::SetAcceleration { acceleration } => {
                self.acceleration = acceleration.clamp(100.0, 5_000.0);
            }
            Command::SetForceLimit { force } => self.force_limit = force.clamp(5.0, self.greatest_force()),
            Command::OverdriveMode { enabled } => {
                self.overdrive = enabled;
                self.force_limit = self.force_limit.min(self.greatest_force());
            }
            Command::SetSoftLimits { limits } => self.soft_limits = Some(limits),
            Command::ClearSoftLimits => self.soft_limits = None,
            Command::GetGrippingStatistics { reset: true } => {
                let is_unreported = before.gripper == GripperState::Gripping && self.motions == 0;
                (self.total, self.no_part, self.unreported_grips) = (0, 0, u16::from(is_unreported));
                self.held_at_reset = matches!(before.gripper, GripperState::Holding | GripperState::Gripping);
            }
            Command::FastStop => self.must_be_stopped = true,
            Command::Acknowledge { .. } => {
                self.must_be_stopped = false;
                self.was_acknowledged = true;
            }
            _ => {}
        }
        match reply.value() {
            Some(Value::GetAcceleration(value)) => assert_eq!(value, self.acceleration),
            Some(Value::GetForceLimit(value)) => assert_eq!(value, self.force_limit),
            Some(Value::GetSoftLimits(limits)) => assert_eq!(Some(limits), self.soft_limits),
            Some(Value::GetGripperState(state)) => assert_eq!(state, before.gripper),
            _ => {}
        }
    }

    /// Records the second answer to a command.
    fn completed(&mut self, id: CommandId, status: Status) {
        self.motions -= usize::from(id.kind() == Kind::Motion);
        self.no_part += u16::from(id == CommandId::GripPart && status == Status::CmdFailed);
    }

    /// Records a disconnect; the motion of the client continues.
    fn disconnected(&mut self, kind: PortKind, announced: bool, state: &State) {
        self.unreported_grips += u16::from(state.gripper == GripperState::Gripping);
        self.motions = 0;
        self.must_be_stopped |= kind == PortKind::Tcp && !announced;
    }

    fn check(&mut self, state: &State, reports_motions: bool) {
        let State { flags, statistics, .. } = *state;
        assert!((0.0..=110.0).contains(&state.width), "{} mm", state.width);
        assert!(state.force >= 0.0 && state.force <= 130.0, "{} N", state.force);
        assert!(state.speed.abs() <= 420.0, "{} mm/s", state.speed);
        assert_eq!(state.force_limit, self.force_limit);
        assert_eq!(flags.contains(SystemFlags::OVERDRIVE_MODE), self.overdrive);

        assert_eq!(statistics.total, self.total, "every started grip is counted");
        assert!((self.no_part..=self.no_part + self.unreported_grips).contains(&statistics.no_part));
        let ended_badly = u32::from(statistics.no_part) + u32::from(statistics.part_lost);
        assert!(ended_badly <= statistics.total + u32::from(self.held_at_reset), "{statistics}");

        self.must_be_stopped |= flags.contains(SystemFlags::CURR_FAULT);
        if self.must_be_stopped {
            assert!(flags.contains(SystemFlags::FAST_STOP), "{flags}");
        } else if std::mem::take(&mut self.was_acknowledged) {
            assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
        }
        if flags.contains(SystemFlags::FAST_STOP) {
            assert_eq!((state.gripper, state.speed), (GripperState::Error, 0.0));
            assert!(!flags.contains(SystemFlags::MOVING));
        }
        if flags.intersects(Self::DISABLING) {
            assert_eq!((state.speed, state.force), (0.0, 0.0));
            assert!(!flags.contains(SystemFlags::MOVING) && !state.gripper.is_motion());
        }
        if state.gripper == GripperState::Holding {
            assert!(state.force > 0.0 && !flags.contains(SystemFlags::MOVING));
        }
        assert!(!flags.contains(SystemFlags::BLOCKED_MINUS | SystemFlags::BLOCKED_PLUS), "{flags}");
        if reports_motions {
            assert_eq!(state.gripper.is_motion(), self.motions == 1, "{}", state.gripper);
        }
    }
}

/// A gripper under test, with checks after every step.
struct Trial {
    kind: PortKind,
    gripper: VirtualGripper<2>,
    port: PortId,
    now: Time,
    model: ReferenceModel,
    /// Commands without their second answer.
    pending: HashMap<CommandId, usize>,
    /// Whether all motions belong to this client, and none to an earlier one.
    reports_motions: bool,
    commands: usize,
    sent: Vec<u8>,
}

impl Trial {
    fn new(kind: PortKind) -> Self {
        let config = Config { fingers: [Finger::Generic, Finger::Fmf], ..Config::default() };
        let mut gripper = VirtualGripper::with_ports(config);
        let port = gripper.connect(kind).expect("a port is free");
        Self {
            kind,
            gripper,
            port,
            now: Time::ZERO,
            model: ReferenceModel::new(),
            pending: HashMap::new(),
            reports_motions: true,
            commands: 0,
            sent: Vec::new(),
        }
    }

    fn step(&mut self, op: &Op) {
        match *op {
            Op::Send(command) => {
                self.command(
                    command.id(),
                    &FrameEncoder::new(command.id().code(), command).collect::<Vec<u8>>(),
                );
            }
            Op::Raw(id, payload) => {
                let frame: Vec<u8> = FrameEncoder::new(id, &payload[..]).collect();
                self.command(CommandId::from_code(id), &frame);
            }
            Op::SetPart(part) => self.gripper.set_part(part, self.now),
            Op::SetFault(fault, on) => self.gripper.set_fault(fault, on, self.now),
            Op::Wait { millis } => {
                self.now = self.now.plus_millis(millis.into());
                self.gripper.advance(self.now);
            }
            Op::Reconnect => self.reconnect(false),
        }
        while let Some(frame) = self.next_frame() {
            self.take_unsolicited(&frame);
        }
        let state = self.gripper.state();
        self.reports_motions |= !state.gripper.is_motion();
        self.model.check(&state, self.reports_motions);
    }

    /// Sends a request and takes its first answer, which must precede everything else.
    fn command(&mut self, id: CommandId, request: &[u8]) {
        self.commands += 1;
        let before = self.gripper.state();
        self.gripper.receive(self.port, self.now, request);
        let frame = self.next_frame().expect("every request is answered");
        let payload = &request[6..request.len() - 2];
        // A FAST STOP is executed regardless of its payload.
        let payload = if id == CommandId::FastStop { &[] } else { payload };
        let command = Command::decode(&Frame { id: id.code(), payload });
        frame.with(|reply| {
            let status = reply.status();
            assert_eq!(reply.id(), id, "the first answer is to the request");
            assert!(id.immediate_statuses().contains(&status), "{id} answered {status}");
            if let Ok(command) = &command {
                self.model.answered(command, reply, &before);
            }
        });
        if frame.status() == Status::CmdPending {
            *self.pending.entry(id).or_default() += 1;
        }
        if command == Ok(Command::DisconnectAnnouncement) && self.kind == PortKind::Tcp {
            assert_eq!(frame.status(), Status::Success);
            while let Some(frame) = self.next_frame() {
                self.take_unsolicited(&frame);
            }
            self.reconnect(true);
        }
    }

    fn reconnect(&mut self, announced: bool) {
        self.model.disconnected(self.kind, announced, &self.gripper.state());
        self.gripper.disconnect(self.port, self.now);
        self.port = self.gripper.connect(self.kind).expect("the place is free again");
        self.pending.clear();
        self.reports_motions = false;
    }

    /// Takes a frame that is not a first answer: a second answer or an update.
    fn take_unsolicited(&mut self, frame: &Sent) {
        let (id, status) = (CommandId::from_code(frame.id()), frame.status());
        match self.pending.get_mut(&id) {
            Some(count) if *count > 0 && id.completion_statuses().contains(&status) => {
                *count -= 1;
                self.model.completed(id, status);
            }
            _ => {
                let is_update = matches!(frame.id(), 0x40 | 0x41 | 0x43..=0x45) && status == Status::Success;
                assert!(is_update, "{} was not requested", frame.text());
            }
        }
    }

    fn next_frame(&mut self) -> Option<Sent> {
        let mut buffer = [0; MAX_FRAME_LEN];
        let frame = self.gripper.transmit(self.port, &mut buffer)?.to_vec();
        self.sent.extend_from_slice(&frame);
        Some(Sent { at: self.now, frame })
    }

    /// Checks that every motion ends and is answered in bounded time; returns all sent bytes.
    fn end(mut self) -> Vec<u8> {
        let end = self.now.plus_millis(120_000);
        while self.now < end {
            self.step(&Op::Wait { millis: 100 });
        }
        assert!(self.pending.values().all(|count| *count == 0), "never answered: {:?}", self.pending);
        assert!(!self.gripper.state().gripper.is_motion());
        self.sent
    }
}

fn run(ops: &[Op], kind: PortKind) -> Vec<u8> {
    let mut trial = Trial::new(kind);
    for op in ops {
        trial.step(op);
    }
    trial.end()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn invariants_hold_for_arbitrary_requests(ops in ops(), tcp in any::<bool>()) {
        run(&ops, if tcp { PortKind::Tcp } else { PortKind::Serial });
    }

    #[test]
    fn same_inputs_at_same_times_give_the_same_bytes(ops in ops()) {
        prop_assert_eq!(run(&ops, PortKind::Serial), run(&ops, PortKind::Serial));
    }

    #[test]
    fn random_bytes_leave_it_answering(noise in proptest::collection::vec(any::<u8>(), 0..3_000)) {
        let mut rig = common::Rig::new(Config::default());
        rig.send_bytes(&noise);
        rig.wait(600);
        rig.frames();
        prop_assert_eq!(rig.status(Command::GetForceLimit), Status::Success);
    }

    #[test]
    fn bytes_like_frames_leave_it_answering_without_checksums(
        noise in proptest::collection::vec(
            prop_oneof![4 => Just(0xAA), 4 => 0u8..4, 2 => 0x20u8..0x27, 1 => any::<u8>()],
            0..1_500,
        ),
    ) {
        let mut rig = common::Rig::new(Config { check_checksum: false, ..Config::default() });
        for segment in noise.chunks(200) {
            rig.send_bytes(segment);
            rig.frames();
        }
        rig.wait(600);
        let data = LoopData::new(b"still there").expect("short enough");
        rig.send(Command::Loop { data });
        let answered = rig.frames().iter().any(|frame| frame.with(|reply| reply.value() == Some(Value::Loop(data))));
        prop_assert!(answered);
    }
}

/// Measures the CPU time of a thread, which requires Unix.
#[cfg(unix)]
mod timed {
    use super::*;
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    use rustix::time::{ClockId, clock_gettime};

    /// Uses the same sequence on every run. The full number of commands takes too long without optimization;
    /// `docs/figures.md` describes how to run it.
    #[test]
    fn many_random_commands_keep_every_invariant_and_are_quick() {
        const COMMANDS: usize = if cfg!(debug_assertions) { 20_000 } else { 1_000_000 };
        const LIMIT_S: i64 = 60;
        let mut runner = TestRunner::deterministic();
        let lists = proptest::collection::vec(op(), 2_000);
        // Only this thread counts, so that other load on the machine has no effect.
        let cpu_s = || clock_gettime(ClockId::ThreadCPUTime).tv_sec;
        let start_s = cpu_s();
        let mut commands = 0;
        let mut virtual_s = 0;
        for kind in [PortKind::Tcp, PortKind::Serial].into_iter().cycle() {
            if commands >= COMMANDS {
                break;
            }
            let mut trial = Trial::new(kind);
            trial.step(&Op::Send(Command::Homing { direction: HomingDirection::Positive }));
            for op in lists.new_tree(&mut runner).expect("a list").current() {
                trial.step(&op);
            }
            commands += trial.commands;
            virtual_s += trial.now.as_micros() / 1_000_000;
            trial.end();
        }
        let taken_s = cpu_s() - start_s;
        println!("{commands} commands, {virtual_s} s of the gripper's time, in {taken_s} s");
        assert!(taken_s < LIMIT_S, "{taken_s} s");
    }
}
