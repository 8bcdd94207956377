//! Motion commands: movement, outcome and refusals (command set, 3.2 and appendix C).

use crate::common::{Rig, Sent, go_by, go_to, go_to_or_stop, grip, release, texts};
use wsg_protocol::{
    AutoUpdate, Command, GripperState, HomingDirection, SoftLimits, Status, SystemFlags, Value,
};
use wsg_sim::{Config, Direction, Fault, Finger, Model, Part};

#[test]
fn homing_takes_under_four_seconds_on_every_model() {
    for &model in Model::ALL {
        for (direction, reference) in
            [(HomingDirection::Positive, model.parameters().limits.stroke), (HomingDirection::Negative, 0.0)]
        {
            // The opposite end.
            let mut rig = Rig::homed_with(Config { model, ..Config::default() });
            if direction == HomingDirection::Positive {
                assert_eq!(rig.run(go_to(0.0)), Status::Success);
            }
            let start = rig.now;
            assert_eq!(rig.run(Command::Homing { direction }), Status::Success, "{model}");
            assert!(rig.now < start.plus_millis(4_000), "{model}: {start} to {}", rig.now);
            assert_eq!(rig.width(), reference, "{model}");
            assert!(rig.flags().contains(SystemFlags::REFERENCED));
            assert_eq!(rig.state(), GripperState::Idle);
        }
    }
}

#[test]
fn homing_against_a_part_takes_it_for_the_end_stop() {
    let mut rig = Rig::new(Config { part: Part::of_width(20.0), ..Config::default() });
    assert_eq!(rig.run(Command::Homing { direction: HomingDirection::Negative }), Status::Success);
    let state = rig.gripper.state();
    assert!(state.reported_width.abs() < 1e-3 && (state.width - 19.95).abs() < 1e-3, "{state:?}");
    // The gripper counts 110 mm at a position beyond the real end stop.
    assert_eq!(rig.run(go_to(110.0)), Status::RangeError);
    assert_eq!(rig.width(), 110.0);
}

#[test]
fn homing_on_a_jammed_axis_cannot_move_away_from_the_end_stop() {
    let mut rig = Rig::new(Config::default());
    rig.set_fault(Fault::AxisBlocked, true);
    let homing = Command::Homing { direction: HomingDirection::Positive };
    assert_eq!(rig.run(homing), Status::AxisBlocked);
    assert!(!rig.flags().contains(SystemFlags::REFERENCED));
    assert_eq!(rig.state(), GripperState::Error);
    rig.set_fault(Fault::AxisBlocked, false);
    assert_eq!(rig.run(homing), Status::Success);
}

#[test]
fn motions_other_than_homing_need_a_reference() {
    let mut rig = Rig::new(Config::default());
    for command in [go_to(20.0), go_by(1.0), grip(20.0), release(50.0)] {
        assert_eq!(rig.status(command), Status::NotInitialized, "{command}");
    }
    // An aborted homing does not set a reference.
    assert_eq!(rig.status(Command::Homing { direction: HomingDirection::Positive }), Status::CmdPending);
    rig.wait(100);
    rig.send(Command::Stop);
    rig.frames();
    assert_eq!(rig.status(go_to(20.0)), Status::NotInitialized);
}

#[test]
fn pre_position_answers_pending_and_then_success_at_the_target() {
    let mut rig = Rig::homed(None);
    assert_eq!(rig.status(go_to(30.0)), Status::CmdPending);
    assert_eq!(rig.state(), GripperState::Positioning);
    rig.wait(100);
    assert!(rig.flags().contains(SystemFlags::MOVING));
    assert!(!rig.flags().contains(SystemFlags::TARGET_POS_REACHED));
    let done = rig.next();
    assert_eq!(done.status(), Status::Success);
    assert_eq!((rig.width(), rig.state()), (30.0, GripperState::Idle));
    assert!(rig.flags().contains(SystemFlags::TARGET_POS_REACHED));
    assert!(!rig.flags().contains(SystemFlags::MOVING));
}

#[test]
fn motion_to_where_the_fingers_are_succeeds_at_once() {
    let mut rig = Rig::homed(None);
    for target in [110.0, 80.0, 80.0] {
        rig.run(go_to(target));
    }
    let start = rig.now;
    assert_eq!(rig.run(go_to(80.0)), Status::Success);
    assert!(rig.now <= start.plus_millis(2), "{}", rig.now);
    assert!(rig.flags().contains(SystemFlags::TARGET_POS_REACHED));
}

#[test]
fn position_and_speed_are_clamped_to_the_limits_of_the_gripper() {
    let mut rig = Rig::homed(None);
    assert_eq!(rig.run(go_to(-30.0)), Status::Success);
    assert_eq!(rig.width(), 0.0);
    let fastest = Command::PrePosition { flags: Default::default(), width: 500.0, speed: 9_999.0 };
    rig.status(Command::SetAcceleration { acceleration: 5_000.0 });
    assert_eq!(rig.status(fastest), Status::CmdPending);
    let mut top = 0.0f32;
    while rig.frames().is_empty() {
        rig.now = rig.now.plus_millis(1);
        rig.gripper.advance(rig.now);
        top = top.max(rig.gripper.state().speed);
    }
    assert!((419.9..=420.0).contains(&top), "{top} mm/s");
    assert_eq!(rig.width(), 110.0);
}

#[test]
fn time_scale_makes_the_fingers_travel_that_many_times_as_fast() {
    let travel_ms = |time_scale: f32| {
        let mut rig = Rig::homed_with(Config { time_scale, ..Config::default() });
        let start = rig.now;
        assert_eq!(rig.run(go_to(10.0)), Status::Success);
        (rig.now.as_micros() - start.as_micros()) / 1_000
    };
    assert_eq!(travel_ms(1.0), 1_100);
    assert!((109..=112).contains(&travel_ms(10.0)), "{}", travel_ms(10.0));
    assert!((2_200..=2_206).contains(&travel_ms(0.5)), "{}", travel_ms(0.5));
    assert!((1..=3).contains(&travel_ms(1_000.0)));
}

#[test]
fn stop_on_block_turns_the_motor_off() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    assert_eq!(rig.run(go_to_or_stop(10.0)), Status::AxisBlocked);
    assert_eq!(rig.state(), GripperState::Error);
    assert!(rig.flags().contains(SystemFlags::BLOCKED_MINUS));
    rig.wait(20);
    assert_eq!((rig.width(), rig.force()), (20.0, 0.0));
    // The blocking condition is resolved.
    rig.set_part(None);
    rig.wait(100);
    assert!(!rig.flags().contains(SystemFlags::BLOCKED_MINUS));
    assert_eq!(rig.width(), 20.0);
}

#[test]
fn clamp_on_block_pushes_with_half_the_nominal_force() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.status(Command::SetForceLimit { force: 10.0 });
    assert_eq!(rig.run(go_to(10.0)), Status::AxisBlocked);
    rig.wait(20);
    assert_eq!(rig.force(), 40.0);
    assert!(rig.flags().contains(SystemFlags::BLOCKED_MINUS));
    rig.set_part(None);
    rig.wait(1);
    assert!(rig.flags().contains(SystemFlags::MOVING));
    assert_eq!(texts(&rig.wait(500)), Vec::<String>::new(), "the command has already been answered");
    assert_eq!((rig.width(), rig.force()), (10.0, 0.0));
}

#[test]
fn grip_at_the_nominal_width_holds_with_the_force_limit() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.status(Command::SetForceLimit { force: 30.0 });
    assert_eq!(rig.status(grip(20.0)), Status::CmdPending);
    assert_eq!(rig.state(), GripperState::Gripping);
    assert_eq!(rig.next().status(), Status::Success);
    assert_eq!(rig.state(), GripperState::Holding);
    assert_eq!(rig.force(), 30.0);
    assert!((rig.width() - 19.7).abs() < 1e-3);
    assert_eq!(texts(&rig.wait(5_000)), Vec::<String>::new());
    assert_eq!((rig.state(), rig.force()), (GripperState::Holding, 30.0));
}

/// A part of 80 mm with a hole of 60 mm.
fn ring() -> Part {
    Part::of_width(80.0).and_then(|part| part.with_inner_width(60.0)).unwrap()
}

/// "A part can be gripped from inside" (command set, 3.2.6; GCL, 2.2.3): the fingers open against it.
#[test]
fn hollow_part_is_gripped_from_inside_released_and_lost() {
    let mut rig = Rig::homed(None);
    assert_eq!(rig.run(go_to(40.0)), Status::Success);
    rig.gripper.set_part(Some(ring()), rig.now);
    assert_eq!(rig.run(grip(60.0)), Status::Success);
    assert_eq!((rig.state(), rig.force()), (GripperState::Holding, 40.0));
    assert!((rig.width() - 60.4).abs() < 1e-4, "{} mm", rig.width());
    assert!(rig.flags().contains(SystemFlags::BLOCKED_PLUS));

    assert_eq!(rig.run(release(40.0)), Status::Success);
    assert_eq!((rig.state(), rig.force(), rig.width()), (GripperState::Idle, 0.0, 40.0));

    assert_eq!(rig.run(grip(60.0)), Status::Success);
    rig.set_part(None);
    assert_eq!(rig.state(), GripperState::PartLost);
    assert_eq!(rig.gripper.state().statistics.part_lost, 1);
}

#[test]
fn grip_from_inside_requires_a_hole_at_its_width() {
    // The width of the fingers before the grip, its nominal width, and the outcome.
    for (from, nominal, state, what) in [
        (40.0, 60.0, GripperState::Holding, "the width of the hole"),
        (40.0, 45.0, GripperState::NoPart, "the clamping travel ends before the part"),
        (40.0, 75.0, GripperState::NoPart, "the part is met 15 mm too early"),
        (100.0, 80.0, GripperState::Holding, "the same part from outside"),
    ] {
        let mut rig = Rig::homed(None);
        rig.run(go_to(from));
        rig.gripper.set_part(Some(ring()), rig.now);
        let expected = if state == GripperState::Holding { Status::Success } else { Status::CmdFailed };
        assert_eq!((rig.run(grip(nominal)), rig.state()), (expected, state), "{what}");
    }
    // A solid part of the same width waits outside of the fingers.
    let mut rig = Rig::homed(None);
    rig.run(go_to(40.0));
    rig.set_part(Some(80.0));
    assert_eq!((rig.run(grip(60.0)), rig.state()), (Status::CmdFailed, GripperState::NoPart));
}

#[test]
fn grip_that_finds_no_part_says_so_until_the_next_motion() {
    let soft = |width, stiffness| Part::new(width, stiffness);
    // Start, part, nominal width, width at the end.
    for (start, part, nominal, end, why) in [
        (110.0, None, 20.0, 15.0, "no part within the clamping travel"),
        (110.0, None, 2.0, 0.0, "no part before the end stop"),
        (20.0, None, 40.0, 45.0, "no part, outward"),
        (110.0, soft(20.0, 2.0), 20.0, 20.0, "too soft for the force"),
        // 40 N at 7 N/mm need 5.7 mm; the clamping travel counts from the part's width.
        (110.0, soft(23.0, 7.0), 20.0, 23.0, "too soft for the force, met before the nominal width"),
        (110.0, Part::of_width(40.0), 20.0, 40.0, "beyond the width tolerance"),
    ] {
        let mut rig = Rig::homed(part);
        rig.run(go_to(start));
        assert_eq!(rig.run(grip(nominal)), Status::CmdFailed, "{why}");
        rig.wait(1_000);
        assert_eq!((rig.state(), rig.force()), (GripperState::NoPart, 0.0), "{why}");
        assert!((rig.width() - end).abs() < 1e-3, "{why}: {}", rig.width());
        assert!(!rig.flags().contains(SystemFlags::MOVING), "{why}");
    }
    // 40 N at 10 N/mm need 4 mm. That suffices from 23 mm on, although it ends 1 mm before the nominal width.
    assert_eq!(Rig::homed(soft(23.0, 10.0)).run(grip(20.0)), Status::Success);
}

#[test]
fn grip_and_release_on_a_jammed_axis_time_out() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.set_fault(Fault::AxisBlocked, true);
    assert_eq!(rig.run(grip(20.0)), Status::Timeout);
    assert_eq!((rig.state(), rig.force()), (GripperState::Error, 0.0));
    rig.set_fault(Fault::AxisBlocked, false);
    rig.run(grip(20.0));
    rig.set_fault(Fault::AxisBlocked, true);
    assert_eq!(rig.run(release(50.0)), Status::Timeout);
}

#[test]
fn part_pulled_out_while_holding_is_lost() {
    for is_jammed in [false, true] {
        let mut rig = Rig::homed(Part::of_width(20.0));
        assert_eq!(rig.run(grip(20.0)), Status::Success);
        rig.set_fault(Fault::AxisBlocked, is_jammed);
        assert_eq!(rig.state(), GripperState::Holding);
        rig.set_part(None);
        assert_eq!((rig.state(), rig.force()), (GripperState::PartLost, 0.0), "jammed: {is_jammed}");
        assert_eq!(texts(&rig.wait(1_000)), Vec::<String>::new());
        assert_eq!(rig.state(), GripperState::PartLost);
        let statistics = rig.gripper.state().statistics;
        assert_eq!((statistics.total, statistics.no_part, statistics.part_lost), (1, 0, 1));
    }
}

#[test]
fn release_opens_and_drops_the_part() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.run(grip(20.0));
    assert_eq!(rig.status(release(50.0)), Status::CmdPending);
    assert_eq!(rig.state(), GripperState::Releasing);
    assert_eq!(rig.next().status(), Status::Success);
    assert_eq!((rig.state(), rig.width(), rig.force()), (GripperState::Idle, 50.0, 0.0));
    assert_eq!(rig.run(grip(20.0)), Status::Success);
}

#[test]
fn grip_again_is_allowed_in_the_same_direction_only() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    assert_eq!(rig.run(grip(40.0)), Status::CmdFailed);
    assert!((rig.width() - 35.0).abs() < 1e-3);
    assert_eq!(rig.status(grip(60.0)), Status::RangeError);
    assert_eq!(rig.state(), GripperState::NoPart);
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    // A second grip on the held part.
    rig.status(Command::SetForceLimit { force: 80.0 });
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    assert_eq!(rig.force(), 80.0);
    assert_eq!(rig.status(grip(60.0)), Status::RangeError);
    assert_eq!(rig.state(), GripperState::Holding);
    rig.run(release(50.0));
    assert_eq!(rig.status(grip(60.0)), Status::CmdPending);
}

#[test]
fn second_motion_is_refused_and_the_first_continues() {
    let mut rig = Rig::homed(None);
    assert_eq!(rig.status(go_to(30.0)), Status::CmdPending);
    rig.wait(100);
    for command in
        [go_to(50.0), grip(20.0), release(50.0), Command::Homing { direction: HomingDirection::Default }]
    {
        assert_eq!(rig.status(command), Status::AlreadyRunning, "{command}");
    }
    assert_eq!(rig.next().status(), Status::Success);
    assert_eq!(rig.width(), 30.0);
}

#[test]
fn stop_aborts_a_motion_and_needs_no_acknowledgement() {
    let mut rig = Rig::homed(None);
    rig.status(go_to(30.0));
    rig.wait(200);
    rig.send(Command::Stop);
    assert_eq!(texts(&rig.frames()), ["22h Stop E_SUCCESS", "21h Pre-position Fingers E_CMD_ABORTED"]);
    let width = rig.width();
    rig.wait(100);
    assert_eq!(rig.width(), width);
    assert_eq!(rig.state(), GripperState::Idle);
    assert!(rig.flags().contains(SystemFlags::AXIS_STOPPED));
    assert_eq!(rig.run(go_to(30.0)), Status::Success);
    assert!(!rig.flags().contains(SystemFlags::AXIS_STOPPED));
}

#[test]
fn grip_at_0_holds_any_part_if_the_travel_spans_the_stroke() {
    for (clamping_travel, result, state) in [
        (5.0, Status::CmdFailed, GripperState::NoPart),
        (110.0, Status::Success, GripperState::Holding),
        (500.0, Status::Success, GripperState::Holding),
    ] {
        for width in [5.5, 20.0, 80.0] {
            let part = Part::of_width(width);
            let mut rig = Rig::homed_with(Config { clamping_travel, part, ..Config::default() });
            assert_eq!(rig.run(grip(0.0)), result, "{clamping_travel} mm, {width} mm wide");
            assert_eq!(rig.state(), state);
        }
    }
    // Closing on nothing still finds no part.
    let mut rig = Rig::homed_with(Config { clamping_travel: 500.0, ..Config::default() });
    assert_eq!(rig.run(grip(0.0)), Status::CmdFailed);
    assert_eq!(rig.state(), GripperState::NoPart);
}

#[test]
fn part_width_tolerance_decides_which_part_is_wrong() {
    for (part_width_tolerance, result) in [(5.0, Status::CmdFailed), (10.0, Status::Success)] {
        let part = Part::of_width(28.0);
        let mut rig = Rig::homed_with(Config { part_width_tolerance, part, ..Config::default() });
        assert_eq!(rig.run(grip(20.0)), result);
    }
}

#[test]
fn motion_presets_are_clamped_to_the_model_limits() {
    let presets = |value| Config {
        force_limit: Some(value),
        acceleration: Some(value),
        homing_speed: Some(value),
        ..Config::default()
    };
    let mut rig = Rig::new(presets(1.0));
    assert_eq!(rig.ask(Command::GetForceLimit).f32(), 5.0);
    assert_eq!(rig.ask(Command::GetAcceleration).f32(), 100.0);
    // 55 mm at 5 mm/s.
    rig.home();
    assert!(rig.now.as_micros() > 11_000_000, "{}", rig.now);
    let mut rig = Rig::new(presets(100_000.0));
    assert_eq!(rig.ask(Command::GetForceLimit).f32(), 80.0);
    assert_eq!(rig.ask(Command::GetAcceleration).f32(), 5_000.0);
    rig.home();
    assert!(rig.now.as_micros() < 1_000_000, "{}", rig.now);
}

#[test]
fn force_queried_directly_after_the_motor_is_switched_off_is_0() {
    const FORCE: Command<'_> = Command::GetForce { update: AutoUpdate::once() };
    for fingers in [[Finger::None; 2], [Finger::Fmf; 2]] {
        let config = Config { part: Part::new(20.0, 10.0), fingers, ..Config::default() };
        for stop in [Command::Stop, Command::FastStop] {
            let mut rig = Rig::homed_with(config);
            assert_eq!(rig.run(grip(20.0)), Status::Success);
            assert_eq!(rig.ask(FORCE).f32(), 40.0);
            assert_eq!(rig.status(stop), Status::Success);
            assert_eq!(rig.ask(FORCE).f32(), 0.0, "{stop}");
        }
        let mut rig = Rig::homed_with(config);
        assert_eq!(rig.run(go_to_or_stop(10.0)), Status::AxisBlocked);
        assert_eq!(rig.ask(FORCE).f32(), 0.0);
    }
}

#[test]
fn stop_while_holding_releases_force() {
    for (stop, state) in [(Command::Stop, GripperState::Idle), (Command::FastStop, GripperState::Error)] {
        let mut rig = Rig::homed(Part::of_width(20.0));
        rig.run(grip(20.0));
        assert_eq!(rig.status(stop), Status::Success);
        assert_eq!(rig.state(), state, "{stop}");
        rig.wait(10);
        assert_eq!((rig.force(), rig.width()), (0.0, 20.0), "{stop}");
        // The part is no longer monitored.
        rig.set_part(None);
        rig.wait(100);
        assert_eq!(rig.state(), state, "{stop}");
        assert_eq!(rig.gripper.state().statistics.part_lost, 0, "{stop}");
    }
}

#[test]
fn fast_stop_latches_until_acknowledged() {
    let mut rig = Rig::homed(None);
    rig.status(go_to(30.0));
    rig.wait(200);
    rig.send(Command::FastStop);
    assert_eq!(
        texts(&rig.frames()),
        ["23h Issue FAST STOP E_SUCCESS", "21h Pre-position Fingers E_CMD_ABORTED"]
    );
    assert_eq!(rig.state(), GripperState::Error);
    assert!(rig.flags().contains(SystemFlags::FAST_STOP));
    let motions = [go_to(50.0), grip(20.0), release(50.0), Command::Homing { direction: Default::default() }];
    for command in motions {
        assert_eq!(rig.status(command), Status::AccessDenied, "{command}");
    }
    // Stop does not clear it.
    assert_eq!(rig.status(Command::Stop), Status::Success);
    assert_eq!((rig.state(), rig.status(go_to(50.0))), (GripperState::Error, Status::AccessDenied));
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
    assert_eq!(rig.state(), GripperState::Idle);
    assert!(!rig.flags().contains(SystemFlags::FAST_STOP));
    assert_eq!(rig.run(go_to(30.0)), Status::Success);
}

#[test]
fn fast_stop_is_executed_with_any_payload() {
    let mut rig = Rig::homed(None);
    rig.send_raw(0x23, &[1, 2, 3]);
    assert_eq!(rig.frames()[0].status(), Status::Success);
    assert!(rig.flags().contains(SystemFlags::FAST_STOP));
}

#[test]
fn acknowledge_requires_its_key_and_always_succeeds() {
    let mut rig = Rig::new(Config::default());
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
    rig.status(Command::FastStop);
    for payload in [&b""[..], b"ac", b"ACK", b"ackk"] {
        rig.send_raw(0x24, payload);
        assert_eq!(rig.frames()[0].status(), Status::CmdFormatError, "{payload:?}");
        assert!(rig.flags().contains(SystemFlags::FAST_STOP));
    }
}

#[test]
fn soft_limits_refuse_targets_outside() {
    let mut rig = Rig::homed(None);
    rig.run(go_to(50.0));
    rig.status(Command::SetSoftLimits { limits: SoftLimits { minus: 20.0, plus: 80.0 } });
    for command in [go_to(19.0), go_to(81.0), grip(10.0), release(90.0), go_by(40.0)] {
        assert_eq!(rig.status(command), Status::RangeError, "{command}");
    }
    assert_eq!(rig.run(go_to(20.0)), Status::Success);
    assert!(rig.flags().contains(SystemFlags::SOFT_LIMIT_MINUS));
    assert_eq!(rig.run(go_to(80.0)), Status::Success);
    assert!(rig.flags().contains(SystemFlags::SOFT_LIMIT_PLUS));
    assert!(!rig.flags().contains(SystemFlags::SOFT_LIMIT_MINUS));
    assert_eq!(rig.run(go_to(50.0)), Status::Success);
    let limit_flags = SystemFlags::SOFT_LIMIT_MINUS.union(SystemFlags::SOFT_LIMIT_PLUS);
    assert!(!rig.flags().intersects(limit_flags));
    rig.status(Command::ClearSoftLimits);
    assert_eq!(rig.run(go_to(100.0)), Status::Success);
}

/// Command set, 3.3.5: "an error for every motion command whose target lies outside", wherever the fingers are.
#[test]
fn fingers_outside_the_soft_limits_need_a_target_inside() {
    let cases = [
        (
            10.0,
            vec![
                go_to(15.0),
                release(18.0),
                grip(19.0),
                go_by(5.0),
                go_by(0.0),
                go_to(5.0),
                go_by(-1.0),
                grip(0.0),
            ],
            [go_to(20.0), release(25.0), go_by(10.0), go_to(80.0)],
            SystemFlags::SOFT_LIMIT_MINUS,
        ),
        (
            110.0,
            vec![go_to(95.0), go_by(1.0), go_by(0.0), release(81.0), grip(100.0), go_by(-29.0), go_to(120.0)],
            [go_to(80.0), release(75.0), go_by(-30.0), go_to(20.0)],
            SystemFlags::SOFT_LIMIT_PLUS,
        ),
    ];
    for (begin, outside, inside, flag) in cases {
        for back in inside {
            let mut rig = Rig::homed(None);
            rig.run(go_to(begin));
            rig.status(Command::SetSoftLimits { limits: SoftLimits { minus: 20.0, plus: 80.0 } });
            for command in &outside {
                assert_eq!(rig.status(*command), Status::RangeError, "from {begin} mm: {command}");
                assert_eq!((rig.width(), rig.state()), (begin, GripperState::Idle));
                assert_eq!(rig.flags() & (flag | SystemFlags::MOVING), flag);
            }
            assert_eq!(rig.run(back), Status::Success, "from {begin} mm: {back}");
            assert!((20.0..=80.0).contains(&rig.width()));
            assert_eq!(rig.status(outside[0]), Status::RangeError, "and not back");
        }
    }
    // A limit at the end of the stroke is no different: without limits, the gripper shortens these motions.
    let mut rig = Rig::homed(None);
    let beyond = [go_to(111.0), go_by(20.0), release(112.0)];
    for command in beyond {
        rig.run(go_to(100.0));
        assert_eq!(rig.run(command), Status::Success, "{command}");
    }
    rig.status(Command::SetSoftLimits { limits: SoftLimits { minus: 0.0, plus: 110.0 } });
    for command in beyond {
        assert_eq!(rig.status(command), Status::RangeError, "{command}");
    }
}

#[test]
fn part_may_be_gripped_from_outside_the_soft_limits() {
    let mut rig = Rig::homed(Part::of_width(50.0));
    rig.status(Command::SetSoftLimits { limits: SoftLimits { minus: 20.0, plus: 80.0 } });
    assert_eq!(rig.run(grip(50.0)), Status::Success);
    assert_eq!(rig.state(), GripperState::Holding);
    assert_eq!(rig.status(release(90.0)), Status::RangeError);
    assert_eq!(rig.state(), GripperState::Holding, "a refusal changes nothing");
}

#[test]
fn entering_the_restricted_area_causes_a_fast_stop_at_the_limit() {
    for (command, status) in [(go_to(10.0), Status::RangeError), (grip(10.0), Status::CmdAborted)] {
        let mut rig = Rig::homed(None);
        rig.run(go_to(60.0));
        rig.status(command);
        rig.wait(50);
        rig.status(Command::SetSoftLimits { limits: SoftLimits { minus: 40.0, plus: 80.0 } });
        assert_eq!(rig.next().status(), status, "{command}");
        assert_eq!((rig.width(), rig.state()), (40.0, GripperState::Error));
        assert!(rig.flags().contains(SystemFlags::FAST_STOP.union(SystemFlags::SOFT_LIMIT_MINUS)));
        rig.status(Command::ACKNOWLEDGE);
        assert_eq!(rig.run(go_to(60.0)), Status::Success);
    }
}

#[test]
fn clamping_travel_ends_at_a_soft_limit_without_a_fast_stop() {
    let mut rig = Rig::homed(None);
    rig.run(go_to(60.0));
    rig.status(Command::SetSoftLimits { limits: SoftLimits { minus: 18.0, plus: 80.0 } });
    assert_eq!(rig.run(grip(20.0)), Status::CmdFailed);
    assert_eq!((rig.width(), rig.state()), (18.0, GripperState::NoPart));
    assert!(!rig.flags().contains(SystemFlags::FAST_STOP));
}

#[test]
fn statistics_count_grip_outcomes_and_reset_after_reading() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.run(grip(20.0));
    rig.run(release(50.0));
    rig.run(grip(20.0));
    rig.set_part(None);
    rig.run(release(50.0));
    rig.run(grip(20.0));
    let read = |rig: &mut Rig, reset: bool| {
        let sent: Sent = rig.ask(Command::GetGrippingStatistics { reset });
        sent.text()
    };
    let full = "42h Get Gripping Statistics E_SUCCESS 3 grips, 1 without part, 1 lost";
    assert_eq!(read(&mut rig, false), full);
    assert_eq!(read(&mut rig, true), full);
    assert_eq!(
        read(&mut rig, false),
        "42h Get Gripping Statistics E_SUCCESS 0 grips, 0 without part, 0 lost"
    );
}

/// Returns the force in each millisecond while time passes.
fn forces(rig: &mut Rig, millis: u64) -> Vec<f32> {
    (0..millis)
        .map(|_| {
            rig.now = rig.now.plus_millis(1);
            rig.gripper.advance(rig.now);
            rig.force()
        })
        .collect()
}

/// Fieldbus, 6.3: "Zum Loslassen wird die Nennkraft des Greifers verwendet", reached "durch sukzessives Erhöhen der internen
/// Kraftgrenze".
#[test]
fn release_raises_its_force_in_steps_to_the_nominal_force() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.status(Command::SetForceLimit { force: 10.0 });
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    assert_eq!(rig.force(), 10.0);
    // A jam that blocks the release shows the applied force.
    rig.set_fault(Fault::AxisBlocked, true);
    assert_eq!(rig.status(release(50.0)), Status::CmdPending);
    let forces = forces(&mut rig, 100);
    assert!(forces[0] < 15.0, "{forces:?}");
    assert!(forces.windows(2).all(|pair| (0.0..5.0).contains(&(pair[1] - pair[0]))), "{forces:?}");
    assert_eq!(forces[99], 80.0);
    assert_eq!(rig.ask(Command::GetForceLimit).f32(), 10.0, "the configured limit is unchanged");
    rig.set_fault(Fault::AxisBlocked, false);
    assert_eq!(rig.next().status(), Status::Success);
    assert_eq!((rig.width(), rig.force()), (50.0, 0.0));
}

/// Fieldbus, 6.3: "Der RELEASE-Befehl quetscht das Teil nicht ein".
#[test]
fn release_does_not_squeeze_the_part_though_it_points_inward() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.status(Command::SetForceLimit { force: 30.0 });
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    assert_eq!(rig.status(release(10.0)), Status::CmdPending);
    let forces = forces(&mut rig, 500);
    assert!(forces.iter().all(|force| (force - 30.0).abs() < 1e-3), "{forces:?}");
    assert!((rig.width() - 19.7).abs() < 1e-3, "{}", rig.width());
}

/// Command set, 3.2.6: a part is gripped once the gripper "can establish the desired gripping force within the defined clamping
/// travel".
#[test]
fn holding_begins_when_the_grip_force_is_established() {
    let mut rig = Rig::homed(Part::new(20.0, 20.0));
    rig.status(Command::SetForceLimit { force: 60.0 });
    assert_eq!(rig.status(grip(20.0)), Status::CmdPending);
    let mut rising = Vec::new();
    while rig.state() == GripperState::Gripping {
        rising.extend(forces(&mut rig, 1).into_iter().filter(|force| *force > 0.0));
    }
    assert!(rising.len() > 10 && rising.windows(2).all(|pair| pair[0] <= pair[1]), "{rising:?}");
    assert_eq!((rig.state(), rig.force()), (GripperState::Holding, 60.0));
}

/// Appendix B: D2 "will be reset if either the blocking condition is resolved or a stop command is issued".
#[test]
fn blocked_flag_lasts_until_the_block_is_resolved_or_a_stop() {
    let blocked = |rig: &Rig| rig.flags().contains(SystemFlags::BLOCKED_MINUS);
    let moving = |rig: &Rig| rig.flags().contains(SystemFlags::MOVING);
    let mut rig = Rig::homed(Part::of_width(20.0));
    assert_eq!(rig.run(go_to(10.0)), Status::AxisBlocked);
    assert!(blocked(&rig));
    // Another motion in the same direction does not resolve it.
    assert_eq!(rig.status(go_to(5.0)), Status::CmdPending);
    assert!(blocked(&rig) && !moving(&rig), "fingers blocked by a part do not move");
    assert_eq!(rig.next().status(), Status::AxisBlocked);
    assert!(blocked(&rig));
    // Moving away does.
    assert_eq!(rig.status(go_to(40.0)), Status::CmdPending);
    rig.wait(20);
    assert!(!blocked(&rig) && moving(&rig));
    assert_eq!(rig.next().status(), Status::Success);
    // So does the removal of the part.
    assert_eq!(rig.run(go_to(10.0)), Status::AxisBlocked);
    assert!(blocked(&rig));
    rig.set_part(None);
    assert!(!blocked(&rig));
    // A stop resets the flag even though the part is still there.
    rig.wait(500);
    rig.run(go_to(40.0));
    rig.set_part(Some(20.0));
    for stop in [Command::Stop, Command::FastStop] {
        assert_eq!(rig.run(go_to(10.0)), Status::AxisBlocked);
        assert!(blocked(&rig));
        rig.status(stop);
        assert!(!blocked(&rig), "{stop}");
        rig.status(Command::ACKNOWLEDGE);
        rig.wait(20);
    }
}

/// Command set, 3.2.2: "If the blocking condition is removed while clamping [...], the fingers will snap to the target position",
/// and appendix B, D7: "Set if the target position was reached".
#[test]
fn fingers_that_snap_to_their_target_set_target_pos_reached() {
    let reached = |rig: &Rig| rig.flags().contains(SystemFlags::TARGET_POS_REACHED);
    let mut rig = Rig::homed(Part::of_width(20.0));
    assert_eq!(rig.run(go_to(10.0)), Status::AxisBlocked);
    rig.wait(100);
    assert!(!reached(&rig));
    rig.set_part(None);
    rig.wait(20);
    assert!(!reached(&rig), "still moving");
    rig.wait(500);
    assert!(reached(&rig) && rig.width() == 10.0);
    assert_eq!(rig.state(), GripperState::Error, "until the next command (3.4.2)");
}

/// Command set, 3.2.2: "To grip or release a part, please use the Grip Part [...] and Release Part [...] commands". GCL, 2.2.2:
/// "kann nicht zum Greifen oder Loslassen von Teilen verwendet werden".
#[test]
fn pre_position_does_not_release_a_part_that_is_held() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    let hand = |rig: &mut Rig| rig.gripper.command(&go_to(100.0), rig.now);
    for command in [go_to(100.0), go_to(10.0), go_by(1.0), go_to_or_stop(100.0)] {
        assert_eq!(rig.status(command), Status::AlreadyRunning, "{command}");
        rig.wait(100);
        assert_eq!((rig.state(), rig.force()), (GripperState::Holding, 40.0));
    }
    assert_eq!(hand(&mut rig), Status::AlreadyRunning);
    // The part is still monitored.
    rig.set_part(None);
    assert_eq!(rig.state(), GripperState::PartLost);
    assert_eq!(rig.gripper.state().statistics.part_lost, 1);
    // "This state will persist until the next [...] Pre-position Fingers command is issued" (3.4.2).
    assert_eq!(rig.run(go_to(100.0)), Status::Success);
}

/// Command set, 3.2.1: "Issue a STOP command, first"; 3.2.7: "Release a previously gripped part".
#[test]
fn release_and_stop_lead_out_of_holding_to_a_pre_position() {
    for way_out in [release(40.0), Command::Stop] {
        let mut rig = Rig::homed(Part::of_width(20.0));
        assert_eq!(rig.run(grip(20.0)), Status::Success);
        if rig.status(way_out) == Status::CmdPending {
            assert_eq!(rig.next().status(), Status::Success);
        }
        assert_eq!(rig.run(go_to(100.0)), Status::Success, "{way_out}");
        assert_eq!(rig.gripper.state().statistics.part_lost, 0, "the part was released, not lost");
    }
}

/// Fieldbus, 6.4: the web interface sets "die Richtung der Referenzierung [...] sowie das automatische Homing beim Starten".
#[test]
fn automatic_homing_uses_the_default_direction() {
    for (homing_default, reference) in [(Direction::Plus, 110.0), (Direction::Minus, 0.0)] {
        let mut rig = Rig::new(Config { homing_at_start: true, homing_default, ..Config::default() });
        assert_eq!(rig.state(), GripperState::Positioning);
        assert!(rig.flags().contains(SystemFlags::MOVING));
        assert_eq!(rig.status(go_to(50.0)), Status::AlreadyRunning);
        assert_eq!(rig.wait(4_000), [], "no client requested it");
        assert!(rig.flags().contains(SystemFlags::REFERENCED));
        assert_eq!((rig.width(), rig.state()), (reference, GripperState::Idle));
        assert_eq!(rig.run(go_to(50.0)), Status::Success);
    }
    let mut rig = Rig::new(Config::default());
    rig.wait(4_000);
    assert_eq!((rig.width(), rig.flags()), (55.0, SystemFlags::empty()), "the default is no motion");
}

/// Command set, 3.3.5: "soft limits that are loaded by default on power-up".
#[test]
fn configured_soft_limits_hold_from_power_up_until_changed() {
    let limits = SoftLimits { minus: 20.0, plus: 80.0 };
    let mut rig = Rig::homed_with(Config { soft_limits: Some(limits), ..Config::default() });
    rig.ask(Command::GetSoftLimits)
        .with(|reply| assert_eq!(reply.value(), Some(Value::GetSoftLimits(limits))));
    assert!(rig.flags().contains(SystemFlags::SOFT_LIMIT_PLUS), "homing ignores them (3.2.1)");
    assert_eq!(rig.run(go_to(50.0)), Status::Success);
    assert_eq!(rig.status(go_to(10.0)), Status::RangeError);
    assert_eq!(rig.status(Command::ClearSoftLimits), Status::Success);
    assert_eq!(rig.status(Command::GetSoftLimits), Status::NotAvailable);
    assert_eq!(rig.run(go_to(10.0)), Status::Success);
    // Limits with minus above plus are ignored.
    let limits = SoftLimits { minus: 80.0, plus: 20.0 };
    let mut rig = Rig::new(Config { soft_limits: Some(limits), ..Config::default() });
    assert_eq!(rig.status(Command::GetSoftLimits), Status::NotAvailable);
}
