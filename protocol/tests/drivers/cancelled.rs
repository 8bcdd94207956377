//! Dropped futures of the async driver, over both protocols: no command is sent late, and no answer is assigned to another
//! request.

use wsg_protocol::driver::{Grip, Mm, MmPerS, N, OnBlock};
use wsg_protocol::{GripperState, HomingDirection, SystemFlags};
use wsg_sim::{Config, Part};

use crate::client::{Asynch, Calls, Client, Error, Frames, Lines, Speech, for_all};

/// Cancels a motion while the line has no room for it, and checks that it is not sent later.
fn cancelled_motion_stays_unsent<S: Speech>(client: &mut Asynch<S>) {
    let Asynch { rig, gripper } = client;
    assert!(rig.run_for(50, gripper.move_to(Mm(10.0), MmPerS(400.0), OnBlock::Stop)).is_none());
    rig.world(|world| world.room = usize::MAX);
    assert_eq!(client.gripper_state(), Ok(GripperState::Idle));
    client.rig.pass(2_000);
    assert!(client.width().unwrap().0 > 109.0);
}

for_all! {
    over_frames Frames, over_lines Lines;
    fn dropping_a_call_at_any_moment_confuses_no_answers;
    fn cancelled_motion_that_was_not_sent_is_never_sent;
    fn cancelled_motion_queued_after_another_message_is_never_sent;
    fn motion_queued_after_a_stop_is_not_sent;
    fn partly_sent_message_is_completed;
    fn cancelled_stop_and_fast_stop_are_still_sent;
    fn motion_of_a_cancelled_call_continues_and_can_be_awaited;
    fn blocked_line_does_not_block_the_caller;
}

fn dropping_a_call_at_any_moment_confuses_no_answers<S: Speech>() {
    for polls in 0..60 {
        let mut client = Asynch::<S>::homed(Config { part: Part::of_width(105.0), ..Config::default() });
        let Asynch { rig, gripper } = &mut client;
        // A grip of about 40 ms.
        let _ = rig.run_for(polls, gripper.grip(Mm(105.0), MmPerS(400.0)));
        assert_eq!(client.force_limit(), Ok(N(40.0)), "{polls}");
        let width = client.width().unwrap().0;
        assert!((104.0..=110.0).contains(&width), "{polls}: {width}");
        client.rig.pass(3_000);
        let state = client.gripper_state().unwrap();
        assert!(matches!(state, GripperState::Idle | GripperState::Holding), "{polls}: {state}");
        assert_eq!(client.stop(), Ok(()), "{polls}");
        assert_eq!(client.home(HomingDirection::Default), Ok(()), "{polls}");
        let counters = client.counters();
        assert_eq!((counters.session.unsolicited, counters.session.refused), (0, 0), "{polls}: {counters:?}");
        assert_eq!((counters.line.dropped, counters.session.disconnects), (0, 0), "{polls}: {counters:?}");
    }
}

fn cancelled_motion_that_was_not_sent_is_never_sent<S: Speech>() {
    let mut client = Asynch::<S>::homed(Config::default());
    client.rig.world(|world| world.room = 0);
    cancelled_motion_stays_unsent(&mut client);
}

fn cancelled_motion_queued_after_another_message_is_never_sent<S: Speech>() {
    let mut client = Asynch::<S>::homed(Config::default());
    let Asynch { rig, gripper } = &mut client;
    // A query of the session itself is only partly sent.
    rig.world(|world| world.room = 3);
    rig.run_for(300, async { while gripper.next_update(1_000).await.is_ok() {} });
    assert_eq!(rig.world(|world| world.room), 0);
    cancelled_motion_stays_unsent(&mut client);
}

fn motion_queued_after_a_stop_is_not_sent<S: Speech>() {
    let mut client = Asynch::<S>::homed(Config::default());
    let Asynch { rig, gripper } = &mut client;
    rig.world(|world| world.room = 0);
    assert!(rig.run_for(10, gripper.stop()).is_none());
    assert!(rig.run_for(10, gripper.move_to(Mm(10.0), MmPerS(400.0), OnBlock::Stop)).is_none());
    rig.world(|world| world.room = usize::MAX);
    assert!(client.system_state().unwrap().contains(SystemFlags::AXIS_STOPPED));
    client.rig.pass(2_000);
    assert_eq!(client.gripper_state(), Ok(GripperState::Idle));
    assert!(client.width().unwrap().0 > 109.0);
}

fn partly_sent_message_is_completed<S: Speech>() {
    let mut client = Asynch::<S>::homed(Config::default());
    let Asynch { rig, gripper } = &mut client;
    rig.world(|world| world.room = 3);
    assert!(rig.run_for(50, gripper.move_to(Mm(50.0), MmPerS(400.0), OnBlock::Stop)).is_none());
    rig.world(|world| world.room = usize::MAX);
    // A message that was started is completed, because a partial one would damage the next.
    client.gripper_state().unwrap();
    client.rig.pass(2_000);
    assert!((client.width().unwrap().0 - 50.0).abs() < 0.1);
    assert_eq!(client.counters().session.disconnects, 0);
}

fn cancelled_stop_and_fast_stop_are_still_sent<S: Speech>() {
    for fast in [false, true] {
        let mut client = Asynch::<S>::homed(Config::default());
        let motion = client.begin_move_to(Mm(10.0), MmPerS(20.0), OnBlock::Stop).unwrap();
        let Asynch { rig, gripper } = &mut client;
        rig.world(|world| world.room = 0);
        let gave_up = if fast {
            rig.run_for(10, gripper.fast_stop()).is_none()
        } else {
            rig.run_for(10, gripper.stop()).is_none()
        };
        assert!(gave_up);
        rig.world(|world| world.room = usize::MAX);
        assert_eq!(client.wait(&motion), Err(Error::Aborted), "fast: {fast}");
    }
}

fn motion_of_a_cancelled_call_continues_and_can_be_awaited<S: Speech>() {
    let mut client = Asynch::<S>::homed(Config { part: Part::of_width(20.0), ..Config::default() });
    let grip = client.begin_grip(Mm(20.0), MmPerS(100.0)).unwrap();
    let Asynch { rig, gripper } = &mut client;
    assert!(rig.run_for(100, gripper.wait(&grip)).is_none());
    assert!(client.motion().is_some());
    assert_eq!(client.wait(&grip), Ok(Grip::Held));
}

fn blocked_line_does_not_block_the_caller<S: Speech>() {
    let mut client = Asynch::<S>::homed(Config::default());
    let Asynch { rig, gripper } = &mut client;
    rig.run(async { while let Ok(Some(_)) = gripper.next_update(0).await {} });
    rig.world(|world| (world.room, world.mute) = (0, true));
    assert!(rig.run_for(10, gripper.stop()).is_none());
    let before = rig.millis();
    assert_eq!(rig.run(gripper.next_update(50)), Ok(None));
    assert!(rig.millis() - before < 60, "an unsent STOP does not block the call");
}
