//! Waits of the blocking driver: only after sending all due data, and no longer than until the next action is due.

use super::*;

/// Returns the number of waits during a call.
fn waits(rig: &Rig, call: impl FnOnce()) -> u32 {
    let before = rig.world(|world| world.waits);
    call();
    rig.world(|world| world.waits) - before
}

#[test]
fn query_needs_a_single_wait_after_sending() {
    let (rig, mut gripper) = connected();
    assert_eq!(waits(&rig, || assert_eq!(gripper.width(), Ok(Mm(42.5)))), 1);
}

#[test]
fn stop_and_fast_stop_are_sent_before_anything_is_read() {
    for id in [CommandId::Stop, CommandId::FastStop] {
        let (rig, mut gripper) = connected();
        rig.world(|world| world.noise = true);
        let result = if id == CommandId::Stop { gripper.stop() } else { gripper.fast_stop() };
        assert_eq!(result, Err(Error::Transport(Noise)), "the first read fails");
        assert_eq!(rig.received(id), 1);
    }
}

#[test]
fn motion_is_awaited_with_few_wake_ups() {
    const SECONDS: u32 = 20;
    let (rig, mut gripper) = connected();
    let id = CommandId::PrePosition;
    let end = (SECONDS * 1_000, status(id, Status::Success));
    rig.script(id, vec![(1, status(id, Status::CmdPending)), end]);
    rig.world(|world| world.flags |= SystemFlags::MOVING);
    let waits = waits(&rig, || gripper.move_to(Mm(50.0), MmPerS(5.0), OnBlock::Stop).unwrap());
    // Each refresh costs two waits: until it is due, and for its answer.
    assert!(waits <= 12 * SECONDS, "{waits}");
}

#[test]
fn poll_and_next_update_without_a_timeout_do_not_wait() {
    let (rig, mut gripper) = connected();
    let grip = gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
    while gripper.next_update(0).unwrap().is_some() {}
    let idle = waits(&rig, || {
        assert_eq!(gripper.poll(&grip), Ok(None));
        assert_eq!(gripper.next_update(0), Ok(None));
    });
    assert_eq!(idle, 0);
}

#[test]
fn silence_of_the_gripper_is_detected_in_time() {
    let (rig, mut gripper) = connected();
    rig.world(|world| world.silent = true);
    let begun = rig.world(|world| world.now);
    assert_eq!(gripper.grip(Mm(20.0), MmPerS(50.0)), Err(Error::Unanswered));
    assert_eq!(rig.world(|world| world.now).since(begun), Config::DEFAULT.session.reply_timeout_ms);
}

#[test]
fn missing_update_is_awaited_until_the_timeout() {
    let (rig, mut gripper) = connected();
    while gripper.next_update(0).unwrap().is_some() {}
    let begun = rig.world(|world| world.now);
    assert_eq!(gripper.next_update(30), Ok(None));
    assert_eq!(rig.world(|world| world.now).since(begun), 30);
}

#[test]
fn update_is_awaited_for_as_long_as_a_program_can_ask_for() {
    for within_ms in [1 << 31, u32::MAX] {
        let (_rig, mut gripper) = connected();
        while gripper.next_update(0).unwrap().is_some() {}
        // The session polls the states.
        assert!(gripper.next_update(within_ms).unwrap().is_some());
    }
}

#[test]
fn answers_received_while_the_program_was_busy_are_in_time() {
    let (rig, mut gripper) = connected();
    let grip = gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
    rig.pass(60_000);
    assert_eq!(gripper.wait(&grip), Ok(Grip::Held));
    assert_eq!(gripper.counters().session.disconnects, 0);
}
