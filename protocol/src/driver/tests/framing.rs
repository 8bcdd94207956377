//! Conditions under which public drivers lose synchronization: unsolicited frames, two frames in one segment, and AA AA AA in
//! a payload.

use super::*;
use crate::LoopData;

/// Returns frames that a gripper may send unsolicited: an update subscribed to by an earlier client, a late result, an unknown
/// ID.
fn unsolicited() -> Vec<u8> {
    [
        frame(Reply::success(Value::GetForce(12.5))),
        status(CommandId::Homing, Status::Success),
        status(CommandId::Unknown(0xB7), Status::CmdFailed),
        status(CommandId::GetSystemInfo, Status::CmdFailed),
    ]
    .concat()
}

#[test]
fn unsolicited_frames_before_answers_keep_the_driver_in_sync() {
    let (rig, mut gripper) = connected();
    for force in [10.0, 20.0, 30.0] {
        rig.inject(&unsolicited());
        assert_eq!(gripper.set_force_limit(N(force)), Ok(()));
        rig.inject(&unsolicited());
        assert_eq!(gripper.force_limit(), Ok(N(force)));
        rig.inject(&unsolicited());
        assert_eq!(gripper.width(), Ok(Mm(42.5)));
        let grip = gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
        rig.inject(&unsolicited());
        assert_eq!(gripper.wait(&grip), Ok(Grip::Held));
    }
    assert_eq!(gripper.counters().line.dropped, 0);
    assert!(gripper.counters().session.unsolicited >= 36);
}

#[test]
fn two_frames_in_one_segment_are_both_processed() {
    let (rig, mut gripper) = connected();
    let mut other = connect_async(&rig);
    let id = CommandId::GripPart;
    let both = [status(id, Status::CmdPending), status(id, Status::CmdFailed)].concat();
    rig.script(id, vec![(1, both.clone())]);
    assert_eq!(gripper.grip(Mm(20.0), MmPerS(50.0)), Ok(Grip::NoPart));
    rig.script(id, vec![(1, both)]);
    assert_eq!(rig.run(other.grip(Mm(20.0), MmPerS(50.0))), Ok(Grip::NoPart));

    let width = frame(Reply::success(Value::GetOpeningWidth(7.0)));
    let segment = [unsolicited(), width, unsolicited()].concat();
    assert!(segment.len() > 64, "needs more than one read");
    rig.script(CommandId::GetOpeningWidth, vec![(1, segment)]);
    assert_eq!(gripper.width(), Ok(Mm(7.0)));
    assert_eq!(gripper.home(HomingDirection::Default), Ok(()));
}

#[test]
fn frame_is_reassembled_from_any_two_pieces() {
    let (rig, mut gripper) = connected();
    let width = frame(Reply::success(Value::GetOpeningWidth(7.0)));
    for cut in 1..width.len() {
        let (head, tail) = width.split_at(cut);
        rig.script(CommandId::GetOpeningWidth, vec![(1, head.to_vec()), (9, tail.to_vec())]);
        assert_eq!(gripper.width(), Ok(Mm(7.0)), "cut at {cut}");
    }
    assert_eq!(gripper.counters().line.dropped, 0);
    assert_eq!(gripper.counters().session.repeated, 0);
}

#[test]
fn preambles_in_a_payload_are_data() {
    let (rig, mut gripper) = connected();
    let mut other = connect_async(&rig);
    for len in [3, 4, 5, 6, 64, 255, 256] {
        assert_eq!(gripper.loop_back(&vec![0xAA; len]), Ok(()), "{len}");
        assert_eq!(rig.run(other.loop_back(&vec![0xAA; len])), Ok(()), "{len}");
    }
    // A complete frame inside a payload is data, too.
    let inner = status(CommandId::Homing, Status::Success);
    assert_eq!(gripper.loop_back(&inner), Ok(()));
    assert_eq!(gripper.counters().session.unsolicited, 0);
}

#[test]
fn truncated_frame_is_discarded_and_the_next_one_is_processed() {
    let (rig, mut gripper) = connected();
    let echo = frame(Reply::success(Value::Loop(LoopData::new(&[0xAA; 100]).unwrap())));
    rig.script(CommandId::GetOpeningWidth, vec![(1, echo[..40].to_vec())]);
    assert_eq!(gripper.width(), Ok(Mm(42.5)), "after a repetition of the query");
    assert_eq!(gripper.counters().session.repeated, 1);
    assert_eq!(gripper.counters().line.dropped, 40);
}

#[test]
fn noise_around_frames_costs_nothing() {
    let (rig, mut gripper) = connected();
    let noise = [0x00, 0xAA, 0xAA, 0x43, 0xFF, 0xAA];
    let width = frame(Reply::success(Value::GetOpeningWidth(7.0)));
    rig.script(CommandId::GetOpeningWidth, vec![(1, [&noise[..5], &width, &noise].concat())]);
    assert_eq!(gripper.width(), Ok(Mm(7.0)));
    assert_eq!(gripper.width(), Ok(Mm(42.5)));
    assert_eq!(gripper.counters().session.repeated, 0);
}

#[test]
fn every_frame_is_sent_in_one_write() {
    let (rig, mut gripper) = connected();
    let mut other = connect_async(&rig);
    rig.world(|world| world.writes.clear());
    gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    gripper.loop_back(&[1; 256]).unwrap();
    rig.run(other.grip(Mm(20.0), MmPerS(50.0))).unwrap();
    rig.run(other.set_tag(&"x".repeat(64))).unwrap();
    let writes = rig.world(|world| world.writes.clone());
    for len in [17, 264, 16, 72] {
        assert!(writes.contains(&len), "{len} in {writes:?}");
    }
    assert!(writes.iter().all(|len| *len >= 8), "{writes:?}");
}
