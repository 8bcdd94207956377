//! The interface between scripts and the gripper in virtual time: claimed commands and script motions.

use crate::common::{Rig, go_to, grip, release};
use wsg_protocol::{
    Command, FingerFlags, GripperState, HomingDirection, SoftLimits, Status, SystemFlags, Value,
};
use wsg_sim::{Config, Fault, Finger, Jaw, MAX_REQUEST_LEN, Part, PortKind, ScriptState};

fn running(part: Option<Part>) -> Rig {
    let mut rig = Rig::homed(part);
    rig.gripper.set_script_state(ScriptState::Running, rig.now);
    rig
}

fn run(rig: &mut Rig, speed: f32) -> Status {
    rig.gripper.run_for_script(speed, rig.now)
}

#[test]
fn only_claimed_commands_wait_for_the_script() {
    for kind in [PortKind::Tcp, PortKind::Udp, PortKind::Serial, PortKind::Can] {
        let mut rig = Rig::on(kind, Config::default());
        rig.gripper.set_script_state(ScriptState::Running, rig.now);
        assert!(rig.gripper.claim_for_script(0xA0) && rig.gripper.claim_for_script(0xBF));
        for id in [0x00, 0x20, 0x9F, 0xC0, 0xFF] {
            assert!(!rig.gripper.claim_for_script(id), "{id:02X}h");
        }
        rig.send_raw(0xBF, &[1, 2]);
        rig.send_raw(0xBE, &[]);
        let frames = rig.frames();
        assert_eq!(frames.len(), 1);
        assert_eq!((frames[0].id(), frames[0].frame[6]), (0xBE, 14), "E_CMD_UNKNOWN");
        let request = rig.gripper.take_script_request().unwrap();
        assert_eq!((request.port, request.id, &request.payload[..]), (rig.port, 0xBF, &[1, 2][..]));
        assert_eq!(rig.gripper.take_script_request(), None);
        assert!(rig.gripper.answer_for_script(request.port, 0xBF, &[0, 0, 7]));
        assert_eq!(rig.frames()[0].frame[3..9], [0xBF, 3, 0, 0, 0, 7]);
    }
}

#[test]
fn full_script_queue_refuses_commands_and_ends_with_the_script() {
    let mut rig = running(None);
    rig.gripper.claim_for_script(0xB0);
    let mut waiting = 0;
    let refused = loop {
        rig.send_raw(0xB0, &[]);
        if let Some(answer) = rig.frames().pop() {
            break answer;
        }
        waiting += 1;
        assert!(waiting < 1_000, "the queue must be bounded");
    };
    assert_eq!(refused.frame[6], 10, "E_INSUFFICIENT_RESOURCES");
    assert!(rig.flags().contains(SystemFlags::SCRIPT_RUNNING | SystemFlags::CMD_FAILURE));
    rig.gripper.take_script_request().unwrap();
    rig.send_raw(0xB0, &[0; MAX_REQUEST_LEN]);
    assert_eq!(rig.frames(), []);
    rig.send_raw(0xB0, &[0; MAX_REQUEST_LEN + 1]);
    assert_eq!(rig.frames()[0].frame[6], 15, "E_CMD_FORMAT_ERROR");

    rig.gripper.set_script_state(ScriptState::Failed, rig.now);
    assert_eq!(rig.gripper.take_script_request(), None);
    rig.send_raw(0xB0, &[]);
    assert_eq!(rig.frames()[0].frame[6], 14, "E_CMD_UNKNOWN");
    assert!(rig.flags().contains(SystemFlags::SCRIPT_FAILURE));
    assert!(!rig.flags().contains(SystemFlags::SCRIPT_RUNNING));
}

#[test]
fn velocity_mode_keeps_its_speed_until_a_new_one_is_set() {
    let mut rig = running(None);
    assert_eq!(run(&mut rig, -50.0), Status::CmdPending);
    rig.wait(200);
    assert_eq!(rig.gripper.state().speed, -50.0);
    // Repeating the same speed, as a control loop does, does not disturb the motion.
    let before = rig.width();
    for _ in 0..100 {
        run(&mut rig, -50.0);
        rig.wait(10);
        assert_eq!(rig.gripper.state().speed, -50.0);
    }
    assert!((before - rig.width() - 50.0).abs() < 0.1, "{before} mm, {} mm", rig.width());
    run(&mut rig, 20.0);
    rig.wait(200);
    assert_eq!(rig.gripper.state().speed, 20.0);
    assert_eq!(run(&mut rig, 0.0), Status::Success);
    let stopped = rig.width();
    assert!(rig.wait(100).is_empty(), "no answer without a request");
    assert_eq!((rig.width(), rig.state()), (stopped, GripperState::Idle));
    assert!(!rig.flags().contains(SystemFlags::CMD_FAILURE), "the command succeeded");
}

#[test]
fn velocity_mode_ends_at_stroke_and_soft_limits() {
    let mut rig = running(None);
    run(&mut rig, -400.0);
    rig.wait(2_000);
    assert_eq!((rig.width(), rig.state()), (0.0, GripperState::Idle));
    let limits = SoftLimits { minus: 20.0, plus: 60.0 };
    assert_eq!(rig.run(go_to(40.0)), Status::Success);
    assert_eq!(rig.status(Command::SetSoftLimits { limits }), Status::Success);
    run(&mut rig, 300.0);
    rig.wait(2_000);
    assert_eq!((rig.width(), rig.state()), (60.0, GripperState::Idle));
    assert!(!rig.flags().contains(SystemFlags::FAST_STOP));
}

#[test]
fn velocity_mode_pushes_with_the_force_limit() {
    let mut rig = running(Part::of_width(20.0));
    assert_eq!(rig.status(Command::SetForceLimit { force: 30.0 }), Status::Success);
    run(&mut rig, -100.0);
    rig.wait(60_000);
    assert_eq!(rig.force(), 30.0);
    assert!(rig.flags().contains(SystemFlags::BLOCKED_MINUS) && !rig.flags().contains(SystemFlags::MOVING));
    rig.set_part(None);
    rig.wait(2_000);
    assert_eq!(rig.width(), 0.0, "it continues when the part is removed");
}

/// Appendix B, D1 and D2, for a controller that repeats its speed 30 to 60 times a second: the flags read right after
/// the command must indicate fingers blocked by the part.
#[test]
fn repeated_speed_against_a_part_is_blocked_and_not_moving() {
    for (speed, period_ms) in [(-50.0, 33), (-50.0, 16), (-5.0, 1)] {
        let mut rig = running(Part::of_width(20.0));
        rig.status(Command::SetForceLimit { force: 80.0 });
        run(&mut rig, -200.0);
        rig.wait(1_500);
        for cycle in 0..60 {
            assert_eq!(run(&mut rig, speed), Status::CmdPending);
            let flags = rig.flags();
            assert!(flags.contains(SystemFlags::BLOCKED_MINUS), "cycle {cycle}: {flags:?}");
            assert!(!flags.contains(SystemFlags::MOVING), "cycle {cycle}: {flags:?}");
            rig.wait(period_ms);
            assert_eq!(rig.force(), 80.0);
        }
        // A lower force limit does not resolve the block, nor does a later speed in the same direction.
        rig.status(Command::SetForceLimit { force: 20.0 });
        run(&mut rig, speed);
        assert!(rig.flags().contains(SystemFlags::BLOCKED_MINUS));
        rig.wait(period_ms + 20);
        assert_eq!(rig.force(), 20.0);
        // The opposite direction resolves it, and so does a speed of 0, which is a stop.
        run(&mut rig, -speed);
        rig.wait(20);
        assert!(!rig.flags().contains(SystemFlags::BLOCKED_MINUS));
        run(&mut rig, -200.0);
        rig.wait(1_000);
        assert!(rig.flags().contains(SystemFlags::BLOCKED_MINUS));
        assert_eq!(run(&mut rig, 0.0), Status::Success);
        assert!(!rig.flags().contains(SystemFlags::BLOCKED_MINUS));
    }
}

#[test]
fn repeated_speed_against_a_jam_follows_the_force_limit() {
    let mut rig = running(None);
    rig.set_fault(Fault::AxisBlocked, true);
    for (limit, least) in [(60.0, 0.0), (60.0, 60.0), (25.0, 25.0)] {
        rig.status(Command::SetForceLimit { force: limit });
        for _ in 0..10 {
            run(&mut rig, -50.0);
            assert!((least..=limit).contains(&rig.force()), "{} N of {limit} N", rig.force());
            rig.wait(10);
        }
        assert_eq!(rig.force(), limit);
    }
}

#[test]
fn velocity_mode_and_commands_replace_each_other() {
    let mut rig = running(Part::of_width(20.0));
    run(&mut rig, -10.0);
    rig.wait(50);
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    assert_eq!(rig.state(), GripperState::Holding);
    assert_eq!(rig.status(release(100.0)), Status::CmdPending);
    assert_eq!(run(&mut rig, 5.0), Status::CmdPending);
    assert_eq!(rig.next().status(), Status::CmdAborted, "the client of the motion is notified");
    assert_eq!(rig.status(Command::Stop), Status::Success);
    assert_eq!(rig.wait(50), [], "no other client is notified");
    assert_eq!(rig.gripper.state().speed, 0.0);

    assert_eq!(rig.status(go_to(100.0)), Status::CmdPending);
    rig.wait(50);
    assert_eq!(run(&mut rig, 0.0), Status::Success);
    assert_eq!(rig.next().status(), Status::CmdAborted, "a speed of 0 also ends a motion");
    let stopped = rig.width();
    rig.wait(50);
    assert_eq!((rig.width(), rig.state()), (stopped, GripperState::Idle));
}

#[test]
fn motions_of_a_script_are_refused_like_motions_of_clients() {
    let mut rig = Rig::new(Config::default());
    assert_eq!(run(&mut rig, 10.0), Status::NotInitialized);
    assert_eq!(rig.gripper.command(&go_to(50.0), rig.now), Status::NotInitialized);
    let homing = Command::Homing { direction: HomingDirection::Positive };
    assert_eq!(rig.gripper.command(&homing, rig.now), Status::CmdPending);
    assert_eq!(rig.wait(5_000), [], "the client requested nothing");
    assert!(rig.flags().contains(SystemFlags::REFERENCED));
    rig.set_fault(Fault::MotorCurrent, true);
    assert_eq!(run(&mut rig, 10.0), Status::AccessDenied);
    assert_eq!(rig.width(), 110.0);
}

/// `while mc.busy() do sleep(1) end mc.move(...)` must never be refused as "already running", nor wait for nothing.
#[test]
fn busy_is_true_exactly_while_a_motion_would_be_refused() {
    let here = go_to(110.0);
    let cases: [(&str, Option<Part>, &[Command<'_>]); 6] = [
        ("a move to the present width", None, &[here]),
        ("a move", None, &[go_to(60.0)]),
        ("a homing, with its reversals", None, &[Command::Homing { direction: HomingDirection::Negative }]),
        ("a grip, while its force builds up", Part::of_width(20.0), &[grip(20.0)]),
        ("a block on a part", Part::of_width(20.0), &[go_to(5.0)]),
        ("a release of nothing", None, &[release(110.0)]),
    ];
    for (case, part, commands) in cases {
        let mut rig = running(part);
        for command in commands {
            assert_eq!(rig.gripper.command(command, rig.now), Status::CmdPending, "{case}");
        }
        let mut was_busy = false;
        for _ in 0..6_000 {
            // On a copy, which the command does not disturb. A held part has its own refusal.
            let mut copy = rig.gripper.clone();
            let refused = copy.command(&here, rig.now) == Status::AlreadyRunning;
            let expected = refused && rig.state() != GripperState::Holding;
            assert_eq!(rig.gripper.is_busy(), expected, "{case} at {:?}: {:?}", rig.now, rig.state());
            was_busy |= expected;
            rig.wait(1);
        }
        assert!(was_busy && !rig.gripper.is_busy(), "{case}");
    }
}

#[test]
fn interface_of_a_finger_is_open_until_the_script_ends() {
    let flags = |rig: &mut Rig| {
        rig.ask(Command::GetFinger1Flags).with(|reply| match reply.value() {
            Some(Value::GetFinger1Flags(flags)) => flags,
            other => panic!("{other:?}"),
        })
    };
    for (finger, before, opened) in [
        (Finger::Generic, false, true),
        (Finger::None, false, true),
        // The gripper itself uses the interface of a known finger.
        (Finger::Fmf, true, true),
    ] {
        for end in [ScriptState::None, ScriptState::Failed] {
            let config = Config { fingers: [finger, Finger::Generic], ..Config::default() };
            let mut rig = Rig::homed_with(config);
            rig.gripper.set_script_state(ScriptState::Running, rig.now);
            let open = |rig: &mut Rig| flags(rig).contains(FingerFlags::COMM_OPEN);
            assert_eq!(open(&mut rig), before, "{finger:?}");
            rig.gripper.open_finger_interface(Jaw::One);
            assert_eq!(open(&mut rig), opened, "{finger:?}");
            rig.gripper.set_script_state(end, rig.now);
            assert_eq!(open(&mut rig), before, "{finger:?} after {end:?}");
        }
    }
}

#[test]
fn answer_to_a_disconnected_client_is_discarded() {
    let mut rig = running(None);
    rig.gripper.claim_for_script(0xB0);
    rig.send_raw(0xB0, &[]);
    let request = rig.gripper.take_script_request().unwrap();
    rig.gripper.disconnect(rig.port, rig.now);
    rig.port = rig.gripper.connect(PortKind::Serial).unwrap();
    assert!(rig.gripper.answer_for_script(request.port, request.id, &[0, 0]));
    assert_eq!(rig.frames(), []);
}

#[test]
fn command_released_by_a_script_is_unknown_again() {
    let mut rig = running(None);
    assert!(rig.gripper.claim_for_script(0xB0) && rig.gripper.claim_for_script(0xB1));
    assert_eq!(rig.gripper.script_requests(), 0);
    rig.send_raw(0xB0, &[]);
    rig.send_raw(0xB1, &[]);
    assert_eq!(rig.gripper.script_requests(), 2);
    assert!(
        rig.gripper.release_for_script(0xB0) && rig.gripper.release_for_script(0xB0),
        "releasing twice is harmless"
    );
    assert!(!rig.gripper.release_for_script(0x20));
    rig.send_raw(0xB0, &[]);
    assert_eq!(rig.frames().pop().map(|answer| answer.frame[6]), Some(14), "E_CMD_UNKNOWN");
    rig.send_raw(0xB1, &[]);
    assert_eq!(rig.gripper.script_requests(), 3);
}
