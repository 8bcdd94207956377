//! Random lists of requests, parts, faults and pauses: whatever comes, these hold.

mod common;

use common::Sent;
use proptest::prelude::*;
use std::collections::HashMap;
use wsg_protocol::{
    AutoUpdate, Command, CommandId, FrameEncoder, GripperState, HomingDirection, Kind, PrePositionFlags,
    SoftLimits, Status, SystemFlags, UpdateFlags,
};
use wsg_sim::{Config, Fault, Finger, Jaw, MAX_FRAME_LEN, Part, PortKind, Time, VirtualGripper};

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
    proptest::option::of(
        (1f32..120.0, 1f32..500.0)
            .prop_map(|(width, stiffness)| Part::new(width, stiffness).expect("both are above 0")),
    )
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

fn ops() -> impl Strategy<Value = Vec<Op>> {
    let op = prop_oneof![
        12 => commands().prop_map(Op::Send),
        1 => (any::<u8>(), any::<[u8; 4]>()).prop_map(|(id, payload)| Op::Raw(id, payload)),
        2 => parts().prop_map(Op::SetPart),
        1 => (faults(), any::<bool>()).prop_map(|(fault, on)| Op::SetFault(fault, on)),
        8 => (0u16..1_500).prop_map(|millis| Op::Wait { millis }),
        1 => Just(Op::Reconnect),
    ];
    // It begins with a way to be referenced, so that most lists get anywhere.
    proptest::collection::vec(op, 1..80).prop_map(|mut ops| {
        ops.insert(0, Op::Send(Command::Homing { direction: HomingDirection::Positive }));
        ops.insert(1, Op::Wait { millis: 3_000 });
        ops
    })
}

/// Runs the list and checks what must hold after every step; gives all that was sent.
fn run(ops: &[Op], kind: PortKind) -> Vec<u8> {
    let config = Config { fingers: [Finger::Generic, Finger::Fmf], ..Config::default() };
    let mut gripper = VirtualGripper::<2>::with_ports(config);
    let mut port = gripper.connect(kind).expect("a port is free");
    let mut now = Time::ZERO;
    let mut sent = Vec::new();
    // What is still to be answered a second time.
    let mut pending: HashMap<CommandId, usize> = HashMap::new();
    let mut held_at_reset = false;
    for op in ops {
        let before = gripper.state();
        let mut asked = None;
        let mut announced = false;
        match *op {
            Op::Send(command) => {
                asked = Some(command.id());
                announced = command == Command::DisconnectAnnouncement && kind == PortKind::Tcp;
                let frame: Vec<u8> = FrameEncoder::new(command.id().code(), command).collect();
                gripper.receive(port, now, &frame);
            }
            Op::Raw(id, payload) => {
                asked = Some(CommandId::from_code(id));
                let frame: Vec<u8> = FrameEncoder::new(id, &payload[..]).collect();
                gripper.receive(port, now, &frame);
            }
            Op::SetPart(part) => gripper.set_part(part, now),
            Op::SetFault(fault, on) => gripper.set_fault(fault, on, now),
            Op::Wait { millis } => {
                now = now.plus_millis(millis.into());
                gripper.advance(now);
            }
            Op::Reconnect => {
                gripper.disconnect(port, now);
                port = gripper.connect(kind).expect("the place is free again");
                pending.clear();
            }
        }
        let mut buffer = [0; MAX_FRAME_LEN];
        let mut first = None;
        while let Some(frame) = gripper.transmit(port, &mut buffer) {
            let reply = Sent { at: now, frame: frame.to_vec() };
            let (id, status) = (CommandId::from_code(reply.id()), reply.status());
            if asked == Some(id) && first.is_none() {
                first = Some(status);
                assert!(id.immediate_statuses().contains(&status), "{id} answered {status}");
                if status == Status::CmdPending {
                    *pending.entry(id).or_default() += 1;
                }
            } else if id.completion_statuses().contains(&status) && pending.get(&id).is_some_and(|n| *n > 0) {
                *pending.entry(id).or_default() -= 1;
            } else {
                let is_update = matches!(reply.id(), 0x40 | 0x41 | 0x43..=0x45) && status == Status::Success;
                assert!(is_update, "{} was not asked for", reply.text());
            }
            sent.extend_from_slice(frame);
        }
        assert_eq!(asked.is_some(), first.is_some(), "every request is answered: {op:?}");
        if announced {
            assert_eq!(first, Some(Status::Success));
            gripper.disconnect(port, now);
            port = gripper.connect(kind).expect("the place is free again");
            pending.clear();
        }

        let state = gripper.state();
        assert!((0.0..=110.0).contains(&state.width), "{} mm", state.width);
        assert!(state.force >= 0.0 && state.force <= 130.0, "{} N", state.force);
        assert!(state.force_limit >= 5.0 && state.force_limit <= 120.0);
        assert!(state.speed.abs() <= 420.0);
        let statistics = state.statistics;
        // A part that was held when the counts began again may still be lost.
        if matches!(op, Op::Send(Command::GetGrippingStatistics { reset: true })) {
            held_at_reset =
                before.gripper == GripperState::Holding || before.gripper == GripperState::Gripping;
        }
        assert!(
            u32::from(statistics.no_part) + u32::from(statistics.part_lost)
                <= statistics.total + u32::from(held_at_reset)
        );
        let is_motion = asked.is_some_and(|id| id.kind() == Kind::Motion);
        if before.flags.contains(SystemFlags::FAST_STOP) && is_motion {
            assert_ne!(first, Some(Status::CmdPending), "FAST STOP refuses {asked:?}");
        }
        if state.flags.contains(SystemFlags::FAST_STOP) {
            assert_eq!((state.gripper, state.speed), (GripperState::Error, 0.0));
            assert!(!state.flags.contains(SystemFlags::MOVING));
        }
        if state.gripper == GripperState::Holding {
            assert!(state.force > 0.0 && !state.flags.contains(SystemFlags::MOVING));
        }
        if before.gripper == GripperState::Idle && state.gripper == GripperState::Holding {
            assert_eq!(statistics.total, before.statistics.total + 1);
        }
    }
    // Every motion ends, and is answered, in bounded time.
    now = now.plus_millis(120_000);
    let mut buffer = [0; MAX_FRAME_LEN];
    while gripper.now() < now {
        let step = gripper.now().plus_millis(100);
        gripper.advance(step);
        while let Some(frame) = gripper.transmit(port, &mut buffer) {
            let reply = Sent { at: step, frame: frame.to_vec() };
            if let Some(count) = pending.get_mut(&CommandId::from_code(reply.id())) {
                *count = count.saturating_sub(1);
            }
        }
    }
    assert!(pending.values().all(|count| *count == 0), "never answered: {pending:?}");
    assert!(!gripper.state().gripper.is_motion());
    sent
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn whatever_comes_the_invariants_hold(ops in ops(), tcp in any::<bool>()) {
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
}

/// As many commands as the issue asks for take too long without optimization; the release run does them.
#[test]
fn many_commands_are_quick() {
    let count = if cfg!(debug_assertions) { 20_000 } else { 1_000_000 };
    let mut gripper = VirtualGripper::new(Config { part: Part::of_width(20.0), ..Config::default() });
    let port = gripper.connect(PortKind::Serial).expect("a port is free");
    let script = [
        Command::ACKNOWLEDGE,
        Command::GripPart { width: 20.0, speed: 400.0 },
        Command::GetOpeningWidth { update: AutoUpdate::once() },
        Command::ReleasePart { width: 40.0, speed: 400.0 },
        Command::PrePosition { flags: PrePositionFlags::empty(), width: 30.0, speed: 400.0 },
        Command::Stop,
        Command::GetSystemState { update: AutoUpdate::once() },
    ];
    let mut now = Time::ZERO;
    let homing = Command::Homing { direction: HomingDirection::Positive };
    let mut frames = 0u32;
    let mut buffer = [0; MAX_FRAME_LEN];
    for command in std::iter::once(&homing).chain(script.iter().cycle()).take(count) {
        let frame: Vec<u8> = FrameEncoder::new(command.id().code(), *command).collect();
        gripper.receive(port, now, &frame);
        now = now.plus_millis(if *command == homing { 4_000 } else { 60 });
        gripper.advance(now);
        while gripper.transmit(port, &mut buffer).is_some() {
            frames += 1;
        }
    }
    assert!(frames as usize >= count);
    let statistics = gripper.state().statistics;
    assert!(statistics.total as usize > count / 10);
}
