//! Values that are kept until they are fetched: they come first, cost no time, and hold up no FAST STOP.

use super::*;

fn force(newtons: u8) -> Vec<u8> {
    frame(Reply::success(Value::GetForce(newtons.into())))
}

/// Three forces that come while something else is asked for, so that they are kept.
fn inject_three(rig: &Rig) {
    (1..=3).for_each(|newtons| rig.inject(&force(newtons)));
}

#[test]
fn kept_values_come_before_a_look_at_the_transport() {
    let rig = Rig::new();
    let mut gripper = connected(&rig);
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
fn kept_values_come_before_a_look_at_the_transport_in_the_async_driver() {
    let rig = Rig::new();
    let mut gripper = connected_async(&rig);
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
fn stop_and_fast_stop_that_were_given_up_leave_before_kept_values_come() {
    for fast in [false, true] {
        let rig = Rig::new();
        let mut gripper = connected_async(&rig);
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
fn what_is_due_is_sent_while_values_keep_coming() {
    let rig = Rig::new();
    let mut gripper = connected_async(&rig);
    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while rig.run(gripper.next_update(50)).unwrap().is_some() {}
    gripper.subscribe(Topic::Width, AutoUpdate::every(10));
    rig.inject(&force(1));
    assert_eq!(rig.run(gripper.next_update(50)), Ok(Some(Update::Force(1.0))));
    assert_eq!(rig.world(|world| world.width_update.take()), Some(vec![0b01, 10, 0]));
}

#[test]
fn count_of_lost_values_stops_at_its_end() {
    let rig = Rig::new();
    let mut gripper = connected(&rig);
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
