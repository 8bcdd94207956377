//! Queued updates: they are returned first, without delay, and do not delay a FAST STOP.

use super::*;

fn force(newtons: u8) -> Vec<u8> {
    frame(Reply::success(Value::GetForce(newtons.into())))
}

/// Injects three forces that are received during a query and therefore queued.
fn inject_three(rig: &Rig) {
    (1..=3).for_each(|newtons| rig.inject(&force(newtons)));
}

#[test]
fn queued_updates_are_returned_before_reading_the_transport() {
    let (rig, mut gripper) = connected();
    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while gripper.next_update(50).unwrap().is_some() {}
    inject_three(&rig);
    assert_eq!(gripper.width(), Ok(Mm(42.5)));
    rig.world(|world| world.noise = true);
    let now = rig.world(|world| world.now);
    for newtons in 1..=3u8 {
        assert_eq!(gripper.next_update(50), Ok(Some(Update::Force(newtons.into()))));
    }
    assert_eq!(rig.world(|world| world.now), now, "no time has passed");
    assert_eq!(gripper.next_update(50), Err(Error::Transport(Noise)));
}

#[test]
fn async_driver_returns_queued_updates_before_reading_the_transport() {
    let (rig, mut gripper) = connected_async();
    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while rig.run(gripper.next_update(50)).unwrap().is_some() {}
    inject_three(&rig);
    assert_eq!(rig.run(gripper.width()), Ok(Mm(42.5)));
    rig.world(|world| world.noise = true);
    for newtons in 1..=3u8 {
        assert_eq!(rig.run(gripper.next_update(50)), Ok(Some(Update::Force(newtons.into()))));
    }
    assert_eq!(rig.run(gripper.next_update(50)), Err(Error::Transport(Noise)));
}

#[test]
fn cancelled_stop_and_fast_stop_are_sent_before_queued_updates_are_returned() {
    for fast in [false, true] {
        let (rig, mut gripper) = connected_async();
        gripper.subscribe(Topic::Force, AutoUpdate::every(10));
        while rig.run(gripper.next_update(50)).unwrap().is_some() {}
        rig.world(|world| world.room = 0);
        inject_three(&rig);
        let id = if fast {
            assert_eq!(rig.run_for(2, gripper.fast_stop()), None);
            CommandId::FastStop
        } else {
            assert_eq!(rig.run_for(2, gripper.stop()), None);
            CommandId::Stop
        };
        rig.world(|world| world.room = usize::MAX);
        assert_eq!(rig.run(gripper.next_update(0)), Ok(Some(Update::Force(1.0))));
        assert_eq!(rig.heard(id), 1);
    }
}

#[test]
fn due_requests_are_sent_while_updates_are_received() {
    let (rig, mut gripper) = connected_async();
    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while rig.run(gripper.next_update(50)).unwrap().is_some() {}
    gripper.subscribe(Topic::Width, AutoUpdate::every(10));
    rig.inject(&force(1));
    assert_eq!(rig.run(gripper.next_update(50)), Ok(Some(Update::Force(1.0))));
    assert_eq!(rig.world(|world| world.width_update.take()), Some(vec![0b01, 10, 0]));
}

#[test]
fn count_of_lost_updates_saturates() {
    let (rig, mut gripper) = connected();
    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while gripper.next_update(50).unwrap().is_some() {}
    for _ in 0..=u16::MAX.into() {
        rig.inject(&force(1));
    }
    (0..UPDATES_LEN).for_each(|_| rig.inject(&force(2)));
    while gripper.width().is_err() || rig.world(|world| world.is_due()) {}
    assert_eq!(gripper.counters().updates_lost, u16::MAX);
    assert_eq!(gripper.next_update(0), Ok(Some(Update::Force(2.0))), "the newest are kept");
}

#[test]
fn motion_refused_after_an_update_has_not_begun() {
    let (rig, mut gripper) = connected();
    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while gripper.next_update(50).unwrap().is_some() {}
    let id = CommandId::GripPart;
    rig.script(id, vec![(1, force(1)), (1, status(id, Status::AccessDenied))]);
    let begun = gripper.begin_grip(Mm(20.0), MmPerS(50.0));
    assert_eq!(begun.map(drop), Err(Error::Refused(Status::AccessDenied)));
}
