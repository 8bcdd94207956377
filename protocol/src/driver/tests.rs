//! Both drivers in virtual time. Each test plays the gripper.

mod cancelled;
mod framing;
#[cfg(feature = "log")]
pub(super) mod recorded;
pub(super) mod rig;
#[cfg(feature = "std")]
mod stopped;
mod updates;
mod waiting;
mod waking;

use super::*;
use crate::session::{FastStopPattern, Topic};
use crate::{AutoUpdate, CommandId, DecodeError, GripperState, HomingDirection, Reply, Status, SystemFlags};
use rig::{Noise, Rig, Segment, Watch, frame, status};
use std::vec;
use std::vec::Vec;

pub(super) type Blocking = blocking::Gripper<Rig, Watch>;
type Asynch = asynch::Gripper<Rig, Watch>;

pub(super) fn connect(rig: &Rig) -> Blocking {
    let mut gripper = Blocking::new(rig.clone(), Watch(rig.clone()));
    gripper.connect().unwrap();
    gripper
}

fn connect_async(rig: &Rig) -> Asynch {
    let mut gripper = Asynch::new(rig.clone(), Watch(rig.clone()));
    rig.run(gripper.connect()).unwrap();
    gripper
}

/// Returns a healthy gripper and a connected driver.
fn connected() -> (Rig, Blocking) {
    let rig = Rig::new();
    let gripper = connect(&rig);
    (rig, gripper)
}

fn connected_async() -> (Rig, Asynch) {
    let rig = Rig::new();
    let gripper = connect_async(&rig);
    (rig, gripper)
}

#[test]
fn grip_distinguishes_held_no_part_and_every_failure() {
    let (rig, mut gripper) = connected();
    let mut other = connect_async(&rig);
    let outcomes = [
        (Status::Success, Ok(Grip::Held)),
        (Status::CmdFailed, Ok(Grip::NoPart)),
        (Status::CmdAborted, Err(Error::Aborted)),
        (Status::AxisBlocked, Err(Error::Blocked)),
        (Status::Timeout, Err(Error::Failed(Status::Timeout))),
    ];
    for (status, outcome) in outcomes {
        rig.script_motion(CommandId::GripPart, status);
        assert_eq!(gripper.grip(Mm(20.0), MmPerS(50.0)), outcome);
        rig.script_motion(CommandId::GripPart, status);
        assert_eq!(rig.run(other.grip(Mm(20.0), MmPerS(50.0))), outcome);
    }
}

#[test]
fn immediate_refusal_returns_its_status() {
    let (rig, mut gripper) = connected();
    rig.script_status(CommandId::Homing, Status::AccessDenied);
    assert_eq!(gripper.home(HomingDirection::Default), Err(Error::Refused(Status::AccessDenied)));
    rig.script_status(CommandId::TareForceSensor, Status::NotAvailable);
    assert_eq!(gripper.tare(), Err(Error::Refused(Status::NotAvailable)));
}

#[test]
fn pre_position_flags_stand_as_in_the_manual() {
    let (rig, mut gripper) = connected();
    gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Clamp).unwrap();
    gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    gripper.move_by(Mm(-5.0), MmPerS(100.0), OnBlock::Clamp).unwrap();
    gripper.move_by(Mm(-5.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    let id = CommandId::PrePosition.code();
    let received = rig.world(|world| core::mem::take(&mut world.received));
    let flags: Vec<u8> =
        received.iter().filter(|(received, _)| *received == id).map(|(_, payload)| payload[0]).collect();
    assert_eq!(flags, [0b00, 0b10, 0b01, 0b11]);
}

#[test]
fn setting_is_read_back_and_another_value_is_a_mismatch() {
    let (rig, mut gripper) = connected();
    assert_eq!(gripper.set_force_limit(N(40.0)), Ok(()));
    assert_eq!(rig.received(CommandId::GetForceLimit), 1);
    let other = frame(Reply::success(Value::GetForceLimit(8.0)));
    rig.script(CommandId::GetForceLimit, vec![(1, other)]);
    assert_eq!(gripper.set_force_limit(N(40.0)), Err(Error::Mismatch));
}

#[test]
fn refused_grip_restores_the_force_limit_or_reports_failure() {
    let force_limit = |force| vec![(1, frame(Reply::success(Value::GetForceLimit(force))))];
    let set = CommandId::SetForceLimit;
    let read = CommandId::GetForceLimit;
    for (is_set_back, is_read_as, error) in [
        (true, 30.0, Error::Refused(Status::RangeError)),
        (false, 30.0, Error::NotSetBack(Status::RangeError)),
        (true, 25.0, Error::Mismatch),
        (false, 25.0, Error::NotSetBack(crate::session::MISMATCH)),
    ] {
        let (rig, mut gripper) = connected();
        rig.script(read, force_limit(40.0));
        rig.script_status(set, Status::Success);
        rig.script(read, force_limit(is_read_as));
        rig.script_status(CommandId::GripPart, Status::RangeError);
        if is_set_back {
            rig.script_status(set, Status::Success);
            rig.script(read, force_limit(40.0));
        } else {
            rig.script_status(set, Status::CmdFormatError);
        }
        assert_eq!(gripper.grip_with_force(Mm(20.0), MmPerS(50.0), N(30.0)), Err(error));
        let received = rig.world(|world| core::mem::take(&mut world.received));
        let limits: Vec<_> =
            received.iter().filter(|(id, _)| *id == set.code()).map(|(_, limit)| limit.clone()).collect();
        assert_eq!(limits, [30.0_f32, 40.0].map(|limit| limit.to_le_bytes().to_vec()));
    }
}

#[test]
fn mismatch_status_counts_only_for_a_setting() {
    let (rig, mut gripper) = connected();
    let id = CommandId::GetOpeningWidth;
    rig.script_status(id, crate::session::MISMATCH);
    assert_eq!(gripper.width(), Err(Error::Refused(crate::session::MISMATCH)));
}

#[test]
fn invalid_number_is_refused_before_it_is_sent() {
    let (rig, mut gripper) = connected();
    assert_eq!(gripper.grip(Mm(f32::NAN), MmPerS(50.0)), Err(Error::Invalid(DecodeError::NotFinite)));
    assert_eq!(gripper.set_tag("tab\t"), Err(Error::Invalid(DecodeError::Character)));
    assert_eq!(gripper.raw(0x24, b"nak", &mut []), Err(Error::Invalid(DecodeError::AckKey)));
    assert_eq!(rig.world(|world| world.received.len()), 0);
}

#[test]
fn borrowed_payload_is_sent_again_if_its_answer_is_lost() {
    let (rig, mut gripper) = connected();
    rig.script(CommandId::SetDeviceTag, vec![]);
    assert_eq!(gripper.set_tag("left hand"), Ok(()));
    let tags: Vec<_> = rig.world(|world| core::mem::take(&mut world.received));
    assert_eq!(tags, [(0x51, b"left hand".to_vec()), (0x51, b"left hand".to_vec())]);
    let tag = crate::DeviceTag::new("left hand").unwrap();
    rig.script(CommandId::GetDeviceTag, vec![(1, frame(Reply::success(Value::GetDeviceTag(tag))))]);
    assert_eq!(gripper.tag(&mut [0; 64]), Ok("left hand"));
}

#[test]
fn script_command_is_sent_once_and_its_answer_is_unchanged() {
    let (rig, mut gripper) = connected();
    let id = CommandId::Unknown(0xB0);
    let value = Value::Unknown { id: 0xB0, parameters: &[1, 2, 3] };
    rig.script(id, vec![(1, status(id, Status::CmdPending)), (50, frame(Reply::success(value)))]);
    assert_eq!(gripper.raw(0xB0, &[7; 100], &mut [0; 8]), Ok(&[1, 2, 3][..]));
    assert_eq!(rig.world(|world| world.received.last().cloned()), Some((0xB0, vec![7; 100])));
    rig.script_status(id, Status::CmdUnknown);
    assert_eq!(gripper.raw(0xB0, &[], &mut []), Err(Error::Refused(Status::CmdUnknown)));
    rig.script(id, vec![(1, frame(Reply::success(value)))]);
    assert_eq!(gripper.raw(0xB0, &[], &mut [0; 2]), Err(Error::TooLong { needed: 3 }));
    rig.script(id, vec![]);
    assert_eq!(gripper.raw(0xB0, &[], &mut []), Err(Error::Unanswered));
    assert_eq!(rig.received(id), 4);
}

#[test]
fn frame_that_does_not_fit_is_not_sent() {
    let rig = Rig::new();
    let mut gripper =
        blocking::Gripper::<_, _, 66, 17>::with_config(rig.clone(), Watch(rig.clone()), Config::DEFAULT);
    gripper.connect().unwrap();
    assert_eq!(gripper.loop_back(&[1; 9]), Ok(()));
    assert_eq!(gripper.loop_back(&[1; 10]), Err(Error::TooLong { needed: 18 }));
    assert_eq!(rig.received(CommandId::Loop), 1);
    assert_eq!(
        gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop),
        Ok(()),
        "the longest of fixed length"
    );
}

#[test]
fn loop_back_detects_different_bytes() {
    let (rig, mut gripper) = connected();
    assert_eq!(gripper.loop_back(&[0xFF; 256]), Ok(()));
    let other = crate::LoopData::new(&[0xFE; 8]).unwrap();
    rig.script(CommandId::Loop, vec![(1, frame(Reply::success(Value::Loop(other))))]);
    assert_eq!(gripper.loop_back(&[0xFF; 8]), Err(Error::Mismatch));
}

#[test]
fn transport_error_is_returned_and_motion_can_be_awaited_again() {
    let (rig, mut gripper) = connected();
    let grip = gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
    rig.world(|world| world.noise = true);
    assert_eq!(gripper.wait(&grip), Err(Error::Transport(Noise)));
    assert_eq!(gripper.wait(&grip), Ok(Grip::Held));
}

#[test]
fn motion_of_a_line_that_was_replaced_is_unanswered() {
    let (rig, mut gripper) = connected();
    let grip = gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
    rig.world(|world| world.drop_received());
    gripper.replace_io(rig.clone());
    assert_eq!(gripper.wait(&grip), Err(Error::Unanswered));
    gripper.connect().unwrap();
    assert_eq!(gripper.grip(Mm(20.0), MmPerS(50.0)), Ok(Grip::Held));
}

#[test]
fn finger_supply_takes_its_time() {
    let (rig, mut gripper) = connected();
    let id = CommandId::Finger1Power;
    let answers: Vec<Segment> = vec![(1, status(id, Status::CmdPending)), (500, status(id, Status::Success))];
    rig.script(id, answers);
    let before = rig.world(|world| world.now);
    assert_eq!(gripper.set_finger_power(Finger::One, true), Ok(()));
    assert!(rig.world(|world| world.now).since(before) >= 500);
    rig.script_status(id, Status::CmdPending);
    assert_eq!(gripper.set_finger_power(Finger::One, true), Err(Error::Unanswered));
    assert!(gripper.is_connected());
}

#[test]
fn fast_stop_is_repeated_while_its_confirmation_is_awaited() {
    let (rig, mut gripper) = connected();
    rig.script(CommandId::FastStop, vec![]);
    assert_eq!(gripper.fast_stop(), Ok(()));
    let burst = usize::from(FastStopPattern::DEFAULT.burst_frames);
    assert!((2..=1 + burst).contains(&rig.received(CommandId::FastStop)));
    assert!(!gripper.fast_stop_pending());
}

#[test]
fn every_kind_of_update_is_returned() {
    let (rig, mut gripper) = connected();
    for topic in [Topic::Width, Topic::Speed, Topic::Force] {
        gripper.subscribe(topic, AutoUpdate::every(10));
    }
    while gripper.next_update(50).unwrap().is_some() {}
    for (value, update) in [
        (Value::GetSystemState(SystemFlags::FAST_STOP), Update::SystemState(SystemFlags::FAST_STOP)),
        (Value::GetGripperState(GripperState::Holding), Update::GripperState(GripperState::Holding)),
        (Value::GetOpeningWidth(41.0), Update::Width(41.0)),
        (Value::GetSpeed(7.0), Update::Speed(7.0)),
        (Value::GetForce(3.0), Update::Force(3.0)),
    ] {
        rig.inject(&frame(Reply::success(value)));
        assert_eq!(gripper.next_update(0), Ok(Some(update)));
    }
}

#[test]
fn transport_that_buffers_until_flushed_is_flushed() {
    let rig = Rig::new();
    rig.world(|world| world.holds_back = true);
    let mut gripper = connect(&rig);
    assert_eq!(gripper.grip(Mm(20.0), MmPerS(50.0)), Ok(Grip::Held));
    let mut other = connect_async(&rig);
    assert_eq!(rig.run(other.grip(Mm(20.0), MmPerS(50.0))), Ok(Grip::Held));

    rig.world(|world| world.width_update = None);
    other.subscribe(Topic::Width, AutoUpdate::every(10));
    rig.run(other.next_update(0)).unwrap();
    assert!(rig.world(|world| world.width_update.is_some()), "sent within a single call that does not wait");
}

#[test]
fn started_motion_names_its_command() {
    let (_rig, mut gripper) = connected();
    let grip = gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
    assert_eq!(grip.id(), CommandId::GripPart);
    assert_eq!(std::format!("{grip:?}"), "Pending(GripPart)");
}

#[test]
fn event_of_another_request_does_not_end_this_one() {
    use crate::session::Event;
    use motion::Verdict;
    let (this, other) = (CommandId::Homing, CommandId::GripPart);
    let success = |id| Event::Answered(Reply::status_only(id, Status::Success));
    for (about, verdict) in [
        (success as fn(CommandId) -> Event<'static>, Verdict::Answered(Status::Success)),
        (Event::Unanswered, Verdict::Unanswered),
        (Event::Withdrawn, Verdict::Withdrawn),
    ] {
        assert_eq!(Verdict::of(&about(this), this), Some(verdict));
        assert_eq!(Verdict::of(&about(other), this), None);
    }
    assert_eq!(Verdict::of(&Event::Pending(this), this), None, "it is not a final outcome");
}

#[test]
fn closure_is_a_clock() {
    let mut clock = || crate::Instant::from_millis(7);
    assert_eq!(Clock::now(&mut clock), crate::Instant::from_millis(7));
}

#[test]
fn every_error_names_its_cause() {
    let limits = crate::session::tests::LIMITS;
    let out_of_limits =
        limits.check(crate::limits::Quantity::Force, 500.0, SystemFlags::empty()).unwrap_err();
    for (error, cause, text) in [
        (Error::NotConnected, Cause::Caller, "no connection"),
        (Error::MotionRunning, Cause::Caller, "motion is running"),
        (Error::FastStopRunning, Cause::Caller, "FAST STOP"),
        (Error::Invalid(DecodeError::NotFinite), Cause::Caller, "invalid parameter: "),
        (
            Error::OutOfLimits(out_of_limits),
            Cause::Caller,
            "force 500 N is outside the gripper's limits, 5 to 80 N",
        ),
        (Error::Superseded, Cause::Caller, "a later motion"),
        (Error::NotInGcl, Cause::Caller, "GCL"),
        (Error::NoForceLimit, Cause::Caller, "force limit"),
        (Error::Stopped(StopKind::Stop), Cause::Caller, "stop handle"),
        (Error::Stopped(StopKind::FastStop), Cause::Caller, "FAST STOP"),
        (Error::TooLong { needed: 18 }, Cause::Capacity, "18 bytes"),
        (Error::Refused(Status::RangeError), Cause::Peer, "refused: E_RANGE_ERROR"),
        (Error::Refused(Status::AccessDenied), Cause::Peer, "refused: E_ACCESS_DENIED"),
        (Error::Refused(Status::AccessDenied), Cause::Peer, "FAST STOP"),
        (Error::Refused(Status::AccessDenied), Cause::Peer, "`acknowledge`"),
        (Error::NotSetBack(Status::RangeError), Cause::Peer, "E_RANGE_ERROR; the force limit"),
        (Error::Blocked, Cause::Peer, "blocked"),
        (Error::Aborted, Cause::Peer, "aborted"),
        (Error::Failed(Status::Timeout), Cause::Peer, "failed: "),
        (Error::Mismatch, Cause::Peer, "read back"),
        (Error::Unanswered, Cause::Peer, "no answer"),
        (Error::Transport(Noise), Cause::Transport, "transport: noise"),
        (Error::Closed, Cause::Transport, "closed"),
    ] {
        assert_eq!(error.cause(), cause, "{error:?}");
        let text_of_error = std::format!("{error}");
        assert!(text_of_error.contains(text), "{text_of_error}");
    }
}

#[test]
fn source_of_an_error_is_that_of_the_transport() {
    use core::error::Error as _;
    let error = Error::Transport(Noise);
    assert_eq!(error.source().and_then(|source| source.downcast_ref()), Some(&Noise));
    assert!(Error::<Noise>::Closed.source().is_none());
}
