//! The behaviour common to both protocols and both drivers.

use wsg_protocol::driver::{
    Cause, DriverCounters, Finger, Grip, Mm, MmPerS, N, OnBlock, UPDATES_LEN, Update,
};
use wsg_protocol::session::{Known, Topic};
use wsg_protocol::{
    AutoUpdate, CommandId, DecodeError, DeviceType, FingerFlags, FingerType, FirmwareVersion, GripperState,
    HomingDirection, Status, SystemFlags,
};
use wsg_sim::{Config, Part, Tag};

use crate::client::{Asynch, Blocking, Calls, Client, Error, Frames, Lines, ProgramError, Speech, for_all};
use crate::rig::TestRig;

for_all! {
    blocking_over_frames Blocking<Frames>, blocking_over_lines Blocking<Lines>, async_over_frames Asynch<Frames>,
    async_over_lines Asynch<Lines>;
    fn device_information_is_returned;
    fn gripper_that_is_silent_is_not_connected_and_time_is_bounded;
    fn motion_before_homing_is_refused;
    fn fingers_move_to_the_requested_width;
    fn relative_moves_add_up;
    fn part_is_held_with_the_force_limit;
    fn grip_without_a_part_finds_none;
    fn part_in_the_way_blocks;
    fn release_opens_to_the_requested_width;
    fn release_after_an_outward_grip_goes_inward;
    fn stop_aborts_a_motion_and_lets_a_part_go;
    fn fast_stop_aborts_and_locks_until_it_is_acknowledged;
    fn unconfirmed_fast_stop_is_pending_until_it_is_confirmed;
    fn state_is_reported_while_a_motion_runs;
    fn one_motion_at_a_time;
    fn result_received_meanwhile_is_kept;
    fn query_whose_answer_is_lost_is_repeated;
    fn motion_whose_answer_is_lost_is_unanswered_and_was_sent_once;
    fn silence_during_a_motion_is_unanswered;
    fn closed_connection_is_reported_and_can_be_replaced;
    fn announced_end_causes_no_fast_stop;
    fn end_without_announcement_is_reported_to_the_next_program;
    fn program_may_leave_early_without_causing_a_fast_stop;
    fn program_without_a_connection_is_not_run;
    fn unanswered_announcement_is_reported_after_success;
    fn closed_line_is_reported_to_the_program;
    fn garbage_is_only_counted;
    fn invalid_number_is_refused_before_anything_is_sent;
    fn value_outside_the_limits_is_refused_before_anything_is_sent;
    fn offset_beyond_the_stroke_is_refused_and_nothing_moves;
    fn refused_motion_leaves_the_force_limit_as_it_was;
    fn updates_are_received_while_the_fingers_travel;
    fn every_value_is_returned_or_counted_as_lost;
    fn latest_speed_is_known_while_it_is_subscribed_to;
    fn finger_types_are_returned;
    fn message_is_one_write;
    fn nothing_is_sent_without_a_connection;
    fn motion_of_a_closed_connection_is_never_sent_later;
}

fn with_part(width: f32) -> Config {
    Config { part: Part::of_width(width), ..Config::default() }
}

#[track_caller]
fn assert_near(value: f32, expected: f32) {
    assert!((value - expected).abs() < 0.1, "{value} is not {expected}");
}

fn device_information_is_returned<C: Client>() {
    let tag = Tag::new("left hand").unwrap();
    let mut client = C::connected(Config { serial_number: 77, tag, ..Config::default() });
    let info = client.system_info().unwrap();
    assert_eq!((info.device, info.serial_number), (DeviceType::Wsg50, 77));
    assert_eq!(info.firmware, FirmwareVersion::new(4, 0, 0, 0));
    assert_eq!(client.tag(), Ok("left hand".into()));
    assert_eq!(client.gripper_state(), Ok(GripperState::Idle));
    assert_eq!(client.statistics(false).unwrap().total, 0);
    assert_eq!(client.temperature().unwrap().0, 320);
    let known = client.known();
    assert_eq!(known.info.unwrap().serial_number, 77);
    assert_eq!(known.state, Some(GripperState::Idle));
    assert_eq!(known.flags, Some(client.system_state().unwrap()));

    let mut client = C::connected(Config::default());
    assert_eq!(client.tag(), Err(Error::Refused(Status::NotAvailable)));
}

fn gripper_that_is_silent_is_not_connected_and_time_is_bounded<C: Client>() {
    let mut client = C::new(Config::default());
    client.rig().world(|world| world.mute = true);
    assert_eq!(client.connect(), Err(Error::NotConnected));
    let took = client.rig().millis();
    assert!((3_000..3_010).contains(&took), "{took} ms");
    assert_eq!(client.home(HomingDirection::Default), Err(Error::NotConnected));
    assert_eq!(client.width(), Err(Error::NotConnected));
    assert_eq!(client.known(), Known::NOTHING);
}

fn motion_before_homing_is_refused<C: Client>() {
    let mut client = C::connected(Config::default());
    client.set_force_limit(N(40.0)).unwrap();
    let refused = Error::Refused(Status::NotInitialized);
    assert_eq!(client.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop), Err(refused));
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Err(refused));
    assert_eq!(client.home(HomingDirection::Negative), Ok(()));
    assert!(client.system_state().unwrap().contains(SystemFlags::REFERENCED));
    assert_near(client.width().unwrap().0, 0.0);
}

fn fingers_move_to_the_requested_width<C: Client>() {
    let mut client = C::homed(Config::default());
    assert_eq!(client.move_to(Mm(42.5), MmPerS(200.0), OnBlock::Stop), Ok(()));
    assert_near(client.width().unwrap().0, 42.5);
    assert_eq!(client.speed(), Ok(MmPerS(0.0)));
    assert_eq!(client.gripper_state(), Ok(GripperState::Idle));
}

fn relative_moves_add_up<C: Client>() {
    let mut client = C::homed(Config::default());
    client.move_by(Mm(-30.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    client.move_by(Mm(10.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    assert_near(client.width().unwrap().0, 90.0);
}

fn part_is_held_with_the_force_limit<C: Client>() {
    let mut client = C::homed(with_part(20.0));
    client.set_force_limit(N(30.0)).unwrap();
    assert_eq!(client.force_limit(), Ok(N(30.0)));
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Ok(Grip::Held));
    assert_eq!(client.gripper_state(), Ok(GripperState::Holding));
    assert_near(client.force().unwrap().0, 30.0);
    assert_near(client.width().unwrap().0, 20.0 - 0.3);
}

fn grip_without_a_part_finds_none<C: Client>() {
    let mut client = C::homed(Config::default());
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Ok(Grip::NoPart));
    assert_eq!(client.gripper_state(), Ok(GripperState::NoPart));
    let statistics = client.statistics(false).unwrap();
    assert_eq!((statistics.total, statistics.no_part), (1, 1));
}

fn part_in_the_way_blocks<C: Client>() {
    let mut client = C::homed(with_part(60.0));
    assert_eq!(client.move_to(Mm(20.0), MmPerS(100.0), OnBlock::Stop), Err(Error::Blocked));
    assert_eq!(client.gripper_state(), Ok(GripperState::Error));
}

fn release_opens_to_the_requested_width<C: Client>() {
    let mut client = C::homed(with_part(20.0));
    client.move_to(Mm(40.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Ok(Grip::Held));
    assert_eq!(client.release(Mm(55.0), MmPerS(200.0)), Ok(()));
    assert_near(client.width().unwrap().0, 55.0);
    assert_eq!(client.gripper_state(), Ok(GripperState::Idle));
}

fn release_after_an_outward_grip_goes_inward<C: Client>() {
    let mut client = C::homed(Config::default());
    client.move_to(Mm(30.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    assert_eq!(client.grip(Mm(60.0), MmPerS(100.0)), Ok(Grip::NoPart));
    assert_near(client.width().unwrap().0, 65.0);
    assert_eq!(client.release(Mm(45.0), MmPerS(200.0)), Ok(()));
    assert_near(client.width().unwrap().0, 45.0);
}

fn stop_aborts_a_motion_and_lets_a_part_go<C: Client>() {
    let mut client = C::homed(with_part(20.0));
    let motion = client.begin_move_to(Mm(50.0), MmPerS(20.0), OnBlock::Stop).unwrap();
    assert_eq!(client.stop(), Ok(()));
    assert_eq!(client.wait(&motion), Err(Error::Aborted));
    assert!(client.width().unwrap().0 > 100.0);
    assert!(client.system_state().unwrap().contains(SystemFlags::AXIS_STOPPED));

    assert_eq!(client.grip(Mm(20.0), MmPerS(200.0)), Ok(Grip::Held));
    client.stop().unwrap();
    client.rig().pass(10);
    assert_eq!(client.gripper_state(), Ok(GripperState::Idle));
    assert_eq!(client.force(), Ok(N(0.0)));
}

fn fast_stop_aborts_and_locks_until_it_is_acknowledged<C: Client>() {
    let mut client = C::homed(Config::default());
    let motion = client.begin_grip(Mm(20.0), MmPerS(20.0)).unwrap();
    assert_eq!(client.fast_stop(), Ok(()));
    assert!(!client.fast_stop_pending());
    assert_eq!(client.wait(&motion), Err(Error::Aborted));
    assert!(client.system_state().unwrap().contains(SystemFlags::FAST_STOP));
    let denied = Error::Refused(Status::AccessDenied);
    assert_eq!(client.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop), Err(denied));
    assert_eq!(client.home(HomingDirection::Default), Err(denied));
    assert_eq!(client.acknowledge(), Ok(()));
    assert!(!client.system_state().unwrap().contains(SystemFlags::FAST_STOP));
    assert_eq!(client.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop), Ok(()));
}

fn unconfirmed_fast_stop_is_pending_until_it_is_confirmed<C: Client>() {
    let mut client = C::homed(Config::default());
    let rig = client.rig();
    rig.world(|world| (world.mute, world.deaf) = (true, true));
    assert_eq!(client.fast_stop(), Err(Error::Unanswered));
    assert!(client.fast_stop_pending());
    assert_eq!(client.acknowledge(), Err(Error::NotConnected));
    rig.world(|world| (world.mute, world.deaf) = (false, false));
    let locked = |client: &C| {
        let flags = client.rig().world(|world| world.gripper.state().flags);
        flags.contains(SystemFlags::FAST_STOP)
    };
    assert!(!locked(&client));
    client.connect().unwrap();
    assert!(!client.fast_stop_pending());
    assert!(locked(&client), "the FAST STOP was received and not acknowledged");
    assert_eq!(client.acknowledge(), Ok(()));
    assert!(!locked(&client));
}

fn state_is_reported_while_a_motion_runs<C: Client>() {
    let mut client = C::homed(Config::default());
    let motion = client.begin_move_to(Mm(10.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    assert_eq!(client.motion(), Some(CommandId::PrePosition));
    assert_eq!(client.gripper_state(), Ok(GripperState::Positioning));
    assert!(client.system_state().unwrap().contains(SystemFlags::MOVING));
    let mut widths = vec![];
    while client.poll(&motion).unwrap().is_none() {
        client.rig().pass(5);
        widths.push(client.width().unwrap().0);
    }
    assert!(widths.len() > 100, "{}", widths.len());
    assert!(widths.is_sorted_by(|one, other| one >= other));
    assert_eq!(client.motion(), None);
    assert_eq!(client.wait(&motion), Ok(()), "repeatable");
}

fn one_motion_at_a_time<C: Client>() {
    let mut client = C::homed(Config::default());
    let first = client.begin_move_to(Mm(10.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    assert_eq!(client.home(HomingDirection::Default), Err(Error::MotionRunning));
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Err(Error::MotionRunning));
    assert_eq!(client.wait(&first), Ok(()));
    let second = client.begin_move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    assert_eq!(client.wait(&first), Err(Error::Superseded));
    assert_eq!(client.wait(&second), Ok(()));
}

fn result_received_meanwhile_is_kept<C: Client>() {
    let mut client = C::homed(Config::default());
    let grip = client.begin_grip(Mm(100.0), MmPerS(200.0)).unwrap();
    client.rig().pass(5_000);
    assert_near(client.width().unwrap().0, 95.0);
    assert_eq!(client.wait(&grip), Ok(Grip::NoPart));
}

fn query_whose_answer_is_lost_is_repeated<C: Client>() {
    let mut client = C::homed(Config::default());
    client.rig().world(|world| world.lose = 1);
    assert_near(client.width().unwrap().0, 110.0);
    assert_eq!(client.counters().session.repeated, 1);
    assert!(client.is_connected());
}

fn motion_whose_answer_is_lost_is_unanswered_and_was_sent_once<C: Client>() {
    let mut client = C::homed(Config::default());
    let rig = client.rig();
    rig.world(|world| (world.mute, world.writes) = (true, vec![]));
    assert_eq!(client.home(HomingDirection::Default), Err(Error::Unanswered));
    assert!(!client.is_connected());
    rig.pass(5_000);
    rig.world(|world| world.mute = false);
    client.connect().unwrap();
    let homing = |bytes: &Vec<u8>| bytes.starts_with(b"HOME") || bytes.get(3) == Some(&0x20);
    assert_eq!(rig.world(|world| world.writes.iter().filter(|bytes| homing(bytes)).count()), 1);
    assert_eq!(client.move_to(Mm(50.0), MmPerS(200.0), OnBlock::Stop), Ok(()));
}

fn silence_during_a_motion_is_unanswered<C: Client>() {
    let mut client = C::homed(Config::default());
    let rig = client.rig();
    let motion = client.begin_move_to(Mm(10.0), MmPerS(20.0), OnBlock::Stop).unwrap();
    rig.world(|world| (world.mute, world.deaf) = (true, true));
    let begun = rig.millis();
    assert_eq!(client.wait(&motion), Err(Error::Unanswered));
    let took = rig.millis() - begun;
    assert!(took < 1_500, "{took} ms");
    assert_eq!(client.known(), Known::NOTHING);
    assert_eq!(client.width(), Err(Error::NotConnected));
    rig.world(|world| (world.mute, world.deaf) = (false, false));
    client.connect().unwrap();
    assert_eq!(client.stop(), Ok(()));
}

fn closed_connection_is_reported_and_can_be_replaced<C: Client>() {
    let mut client = C::homed(Config::default());
    let motion = client.begin_move_to(Mm(10.0), MmPerS(20.0), OnBlock::Stop).unwrap();
    client.rig().world(|world| world.closed = true);
    assert_eq!(client.wait(&motion), Err(Error::Closed));
    assert!(!client.is_connected());
    assert_eq!(client.known(), Known::NOTHING);
    client.take_new_line();
    assert_eq!(client.wait(&motion), Err(Error::Unanswered));
    client.connect().unwrap();
    // The gripper treats the end as an error.
    assert!(client.system_state().unwrap().contains(SystemFlags::FAST_STOP));
    client.acknowledge().unwrap();
    assert_eq!(client.move_to(Mm(50.0), MmPerS(200.0), OnBlock::Stop), Ok(()));
}

fn announced_end_causes_no_fast_stop<C: Client>() {
    let mut client = C::homed(Config::default());
    assert_eq!(client.announce_disconnect(), Ok(()));
    assert!(client.move_to(Mm(50.0), MmPerS(200.0), OnBlock::Stop).is_err());
    client.take_new_line();
    client.connect().unwrap();
    assert!(!client.system_state().unwrap().contains(SystemFlags::FAST_STOP));
    assert_eq!(client.move_to(Mm(50.0), MmPerS(200.0), OnBlock::Stop), Ok(()));
}

fn end_without_announcement_is_reported_to_the_next_program<C: Client>() {
    let mut client = C::homed(Config::default());
    client.take_new_line();
    client.connect().unwrap();
    let error = client.move_to(Mm(50.0), MmPerS(200.0), OnBlock::Stop).unwrap_err();
    assert_eq!(error, Error::Refused(Status::AccessDenied));
    let text = error.to_string();
    for words in ["FAST STOP", "ended without Disconnect Announcement", "`acknowledge`"] {
        assert!(text.contains(words), "{text}");
    }
}

fn program_may_leave_early_without_causing_a_fast_stop<C: Client>() {
    for end in [|| Ok(7), || Err(ProgramError::Own), || Err(Error::Blocked.into())] {
        let mut client = C::new(Config::default());
        let rig = client.rig();
        assert_eq!(client.with_connection(end), end());
        rig.reconnect();
        rig.pass(1_000);
        let state = rig.world(|world| world.gripper.state());
        assert!(!state.flags.contains(SystemFlags::FAST_STOP));
        assert!(state.speed == 0.0 && state.width > 100.0, "the motion has ended: {state:?}");
    }
}

fn program_without_a_connection_is_not_run<C: Client>() {
    let mut client = C::new(Config::default());
    client.rig().world(|world| world.mute = true);
    let outcome = client.with_connection(|| panic!("the program must not run without a gripper"));
    assert_eq!(outcome, Err(Error::NotConnected.into()));
}

fn unanswered_announcement_is_reported_after_success<C: Client>() {
    for (end, expected) in [(Ok(7), Error::Unanswered.into()), (Err(ProgramError::Own), ProgramError::Own)] {
        let mut client = C::new(Config::default());
        let rig = client.rig();
        let outcome = client.with_connection(|| {
            rig.world(|world| world.mute = true);
            end
        });
        assert_eq!(outcome, Err(expected));
    }
}

fn closed_line_is_reported_to_the_program<C: Client>() {
    let mut client = C::new(Config::default());
    let rig = client.rig();
    let outcome = client.with_connection(|| {
        rig.world(|world| world.closed = true);
        Ok(7)
    });
    assert_eq!(outcome, Err(Error::Closed.into()));
}

fn garbage_is_only_counted<C: Client>() {
    let mut client = C::homed(Config::default());
    let motion = client.begin_move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    let (before, known) = (client.counters(), client.known());
    client.rig().inject(C::Speech::GARBAGE);
    assert_eq!(client.poll(&motion), Ok(None));
    let after = client.counters();
    let sum = |counters: DriverCounters| {
        counters.line.dropped
            + counters.line.bad_checksum
            + counters.session.refused
            + counters.session.unsolicited
    };
    assert!(sum(after) > sum(before), "{after:?}");
    assert_eq!(client.known().info, known.info);
    assert_eq!(client.wait(&motion), Ok(()));
    assert_near(client.width().unwrap().0, 50.0);
}

fn invalid_number_is_refused_before_anything_is_sent<C: Client>() {
    let mut client = C::homed(Config::default());
    let rig = client.rig();
    rig.world(|world| world.writes.clear());
    let invalid = Error::Invalid(DecodeError::NotFinite);
    assert_eq!(client.grip(Mm(f32::NAN), MmPerS(50.0)), Err(invalid));
    assert_eq!(client.move_to(Mm(50.0), MmPerS(f32::INFINITY), OnBlock::Stop), Err(invalid));
    assert_eq!(client.move_by(Mm(f32::NAN), MmPerS(50.0), OnBlock::Stop), Err(invalid));
    assert_eq!(client.release(Mm(f32::NEG_INFINITY), MmPerS(50.0)), Err(invalid));
    assert_eq!(client.set_force_limit(N(f32::NAN)), Err(invalid));
    assert_eq!(rig.world(|world| world.writes.len()), 0);
    assert_eq!(client.force_limit(), Ok(N(40.0)));
}

fn value_outside_the_limits_is_refused_before_anything_is_sent<C: Client>() {
    let mut client = C::homed(with_part(20.0));
    let rig = client.rig();
    rig.world(|world| world.writes.clear());
    let (width, speed, force, stop) = (Mm(20.0), MmPerS(50.0), N(30.0), OnBlock::Stop);
    let (force_text, speed_text, width_text) =
        ("force {} N", "speed {} mm/s", "width {} mm is outside the gripper's limits, 0 to 110 mm");
    let refusals = [
        (client.move_to(Mm(-1.0), MmPerS(100.0), stop), width_text, "-1"),
        (client.move_to(Mm(110.5), speed, stop), width_text, "110.5"),
        (client.move_to(width, MmPerS(4.0), stop), speed_text, "4"),
        (client.begin_move_to_with_force(width, speed, stop, N(4.0)).map(drop), force_text, "4"),
        (client.begin_move_to_with_force(width, MmPerS(421.0), stop, force).map(drop), speed_text, "421"),
        (client.move_by(Mm(-111.0), speed, stop), "offset {} mm", "-111"),
        (client.move_by(Mm(-5.0), MmPerS(500.0), stop), speed_text, "500"),
        (client.grip(Mm(120.0), speed).map(drop), width_text, "120"),
        (client.grip_with_force(width, speed, N(500.0)).map(drop), force_text, "500"),
        (client.grip_with_force(width, speed, N(-1.0)).map(drop), force_text, "-1"),
        (client.grip_with_force(Mm(-5.0), speed, force).map(drop), width_text, "-5"),
        (client.grip_with_force(width, MmPerS(0.0), force).map(drop), speed_text, "0"),
        (client.release(Mm(111.0), speed), width_text, "111"),
        (client.release(width, MmPerS(-50.0)), speed_text, "-50"),
        (client.set_force_limit(N(130.5)), "force {} N is outside the gripper's limits, 5 to 80 N", "130.5"),
    ];
    assert_eq!(rig.world(|world| world.writes.clone()), Vec::<Vec<u8>>::new());
    for (refusal, text, value) in refusals {
        let refused = refusal.unwrap_err();
        assert_eq!(refused.cause(), Cause::Caller);
        let (text, refused) = (text.replace("{}", value), refused.to_string());
        assert!(refused.starts_with(&text), "{refused}, not {text}");
    }
    assert_eq!(client.force_limit(), Ok(N(40.0)));
    assert_near(client.width().unwrap().0, 110.0);
}

fn offset_beyond_the_stroke_is_refused_and_nothing_moves<C: Client>() {
    let mut client = C::homed(Config::default());
    client.move_by(Mm(-20.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    for offset in [20.5, -90.5] {
        let refused = client.move_by(Mm(offset), MmPerS(200.0), OnBlock::Stop).unwrap_err();
        assert!(matches!(refused, Error::OutOfLimits(_)), "{refused}");
        assert_near(client.width().unwrap().0, 90.0);
    }
    let motion = client.begin_move_to(Mm(50.0), MmPerS(50.0), OnBlock::Stop).unwrap();
    client.rig().world(|world| world.writes.clear());
    assert_eq!(client.move_by(Mm(5.0), MmPerS(50.0), OnBlock::Stop), Err(Error::MotionRunning));
    assert_eq!(client.grip_with_force(Mm(20.0), MmPerS(50.0), N(30.0)), Err(Error::MotionRunning));
    assert_eq!(
        client.rig().world(|world| world.writes.len()),
        0,
        "nothing is queried for a motion that cannot begin"
    );
    client.wait(&motion).unwrap();
    client.move_by(Mm(60.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    assert_near(client.width().unwrap().0, 110.0);
}

fn refused_motion_leaves_the_force_limit_as_it_was<C: Client>() {
    let mut client = C::homed(with_part(20.0));
    client.fast_stop().unwrap();
    let denied = Error::Refused(Status::AccessDenied);
    assert_eq!(client.grip_with_force(Mm(20.0), MmPerS(100.0), N(30.0)), Err(denied));
    assert_eq!(client.force_limit(), Ok(N(40.0)));
    let moved = client.begin_move_to_with_force(Mm(50.0), MmPerS(100.0), OnBlock::Stop, N(30.0));
    assert_eq!(moved.map(drop), Err(denied));
    assert_eq!(client.force_limit(), Ok(N(40.0)));
    client.acknowledge().unwrap();
    assert_eq!(client.grip_with_force(Mm(20.0), MmPerS(100.0), N(30.0)), Ok(Grip::Held));
    assert_eq!(client.force_limit(), Ok(N(30.0)), "the limit of a grip remains");
    assert_near(client.force().unwrap().0, 30.0);
}

fn updates_are_received_while_the_fingers_travel<C: Client>() {
    let mut client = C::homed(Config::default());
    client.subscribe(Topic::Width, AutoUpdate::every(10));
    let motion = client.begin_move_to(Mm(10.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    let mut widths = vec![];
    while client.poll(&motion).unwrap().is_none() {
        if let Some(Update::Width(width)) = client.next_update(100).unwrap() {
            widths.push(width);
        }
    }
    assert!(widths.len() > 80, "{}", widths.len());
    assert!(widths.is_sorted_by(|one, other| one >= other));
    assert_near(client.known().width.unwrap(), 10.0);

    client.subscribe(Topic::Width, AutoUpdate::once());
    while client.next_update(0).unwrap().is_some() {}
    client.rig().pass(100);
    while client.next_update(0).unwrap().is_some() {}
    client.rig().pass(500);
    let mut came = vec![];
    while let Some(update) = client.next_update(0).unwrap() {
        came.push(update);
    }
    assert!(!came.iter().any(|update| matches!(update, Update::Width(_))), "{came:?}");
}

fn every_value_is_returned_or_counted_as_lost<C: Client>() {
    let mut client = C::homed(Config::default());
    client.subscribe(Topic::Width, AutoUpdate::every(10));
    while !matches!(client.next_update(50), Ok(Some(Update::Width(_)))) {}
    while client.next_update(0).unwrap().is_some() {}
    let lost_before = client.counters().updates_lost;
    client.rig().pass(1_000);
    client.tare().unwrap_err();

    let begun = client.rig().millis();
    for _ in 0..UPDATES_LEN {
        assert!(client.next_update(50).unwrap().is_some());
    }
    assert_eq!(client.rig().millis(), begun, "queued updates are returned without delay");
    let lost = usize::from(client.counters().updates_lost - lost_before);
    let returned = UPDATES_LEN;
    assert!(
        (100..=110).contains(&(returned + lost)),
        "expected one every 10 ms and some states; {lost} lost"
    );
}

fn latest_speed_is_known_while_it_is_subscribed_to<C: Client>() {
    let mut client = C::homed(Config::default());
    assert_eq!(client.known().speed, None, "no query or subscription");
    client.subscribe(Topic::Speed, AutoUpdate::every(10));
    let motion = client.begin_move_to(Mm(10.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    let mut fastest: f32 = 0.0;
    while client.poll(&motion).unwrap().is_none() {
        client.rig().pass(10);
        fastest = fastest.max(client.known().speed.map_or(0.0, f32::abs));
    }
    assert_near(fastest, 100.0);
    client.rig().pass(50);
    while client.next_update(0).unwrap().is_some() {}
    assert_eq!(client.known().speed, Some(0.0));
}

fn finger_types_are_returned<C: Client>() {
    let fingers = [wsg_sim::Finger::Fmf, wsg_sim::Finger::None];
    let mut client = C::homed(Config { fingers, ..with_part(20.0) });
    let one = client.finger_info(Finger::One).unwrap();
    assert_eq!((one.finger, one.data_len), (FingerType::Fmf, 4));
    let two = client.finger_info(Finger::Two).unwrap();
    assert_eq!((two.finger, two.data_len), (FingerType::Generic, 0));
    let connected = FingerFlags::CONFIG_AVAIL | FingerFlags::COMM_OPEN;
    assert!(client.finger_flags(Finger::One).unwrap().contains(connected));
    assert!(!client.finger_flags(Finger::Two).unwrap().intersects(connected));
    assert_eq!(client.tare(), Ok(()));
    client.grip(Mm(20.0), MmPerS(100.0)).unwrap();
    assert_eq!(client.finger_data(Finger::One), Ok(20.0_f32.to_le_bytes().to_vec()));
    assert_eq!(client.finger_data(Finger::Two), Err(Error::Refused(Status::NotAvailable)));
    for finger in [Finger::One, Finger::Two] {
        for question in 0..3 {
            client.rig().world(|world| world.mute = true);
            let unanswered = match question {
                0 => client.finger_info(finger).map(drop),
                1 => client.finger_flags(finger).map(drop),
                _ => client.finger_data(finger).map(drop),
            };
            assert_eq!(unanswered, Err(Error::Unanswered), "{finger:?} {question}");
            client.rig().world(|world| world.mute = false);
            client.connect().unwrap();
        }
    }
    assert_eq!(client.tare(), Err(Error::Refused(Status::AccessDenied)));
}

fn message_is_one_write<C: Client>() {
    let mut client = C::homed(with_part(20.0));
    client.grip(Mm(20.0), MmPerS(100.0)).unwrap();
    client.release(Mm(60.0), MmPerS(100.0)).unwrap();
    let writes = client.rig().world(|world| world.writes.clone());
    for bytes in writes {
        let is_line = bytes.iter().filter(|byte| **byte == b'\n').count() == 1 && bytes.ends_with(b"\n");
        let is_frame = bytes.starts_with(&[0xAA; 3]) && bytes.len() == 8 + usize::from(bytes[4]);
        assert!(is_line || is_frame, "{bytes:?}");
    }
}

fn nothing_is_sent_without_a_connection<C: Client>() {
    let mut client = C::homed(Config::default());
    let rig = client.rig();
    rig.world(|world| (world.mute, world.deaf) = (true, true));
    while client.is_connected() {
        client.next_update(50).unwrap();
    }
    assert_eq!(client.move_to(Mm(10.0), MmPerS(100.0), OnBlock::Stop), Err(Error::NotConnected));
    assert_eq!(client.set_force_limit(N(20.0)), Err(Error::NotConnected));
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Err(Error::NotConnected));
    rig.world(|world| (world.mute, world.deaf) = (false, false));
    client.connect().unwrap();
    rig.pass(2_000);
    assert_near(client.width().unwrap().0, 110.0);
}

fn motion_of_a_closed_connection_is_never_sent_later<C: Client>() {
    // The message is unsent or partly sent.
    for room in [0, 3, 5] {
        let mut client = C::homed(Config::default());
        client.rig().world(|world| world.room = room);
        assert!(client.move_to(Mm(10.0), MmPerS(400.0), OnBlock::Stop).is_err());
        client.rig().pass(1_000);
        while let Ok(Some(_)) = client.next_update(0) {}
        assert!(!client.is_connected(), "{room}");
        client.rig().world(|world| world.room = usize::MAX);
        client.connect().unwrap();
        client.rig().pass(2_000);
        assert_near(client.width().unwrap().0, 110.0);
    }
}

for_all! {
    over_frames Frames, over_lines Lines;
    fn program_may_announce_its_end_itself;
    fn line_without_an_announcement_is_left_as_it_is;
}

fn program_may_announce_its_end_itself<S: Speech>() {
    let mut client = Blocking::<S>::new(Config::default());
    let outcome: Result<(), Error> = client.gripper.with_connection(|gripper| gripper.announce_disconnect());
    assert_eq!(outcome, Ok(()));
}

fn line_without_an_announcement_is_left_as_it_is<S: Speech>() {
    let mut client = Blocking::<S>::at(TestRig::new(S::ANONYMOUS_PORT, Config::default()));
    let outcome: Result<GripperState, Error> =
        client.gripper.with_connection(|gripper| gripper.gripper_state());
    assert_eq!(outcome, Ok(GripperState::Idle));
    assert!(client.is_connected());
}
