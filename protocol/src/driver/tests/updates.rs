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
fn async_driver_returns_queued_updates_before_it_reads() {
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
fn cancelled_stop_or_fast_stop_is_sent_before_queued_updates() {
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
        assert_eq!(rig.received(id), 1);
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

#[test]
fn age_of_a_value_counts_from_its_last_report() {
    let (rig, mut gripper) = connected();
    assert_eq!(gripper.age_ms(Topic::Width), None, "never reported");
    assert_eq!(gripper.width(), Ok(Mm(42.5)));
    assert_eq!(gripper.age_ms(Topic::Width), Some(0));
    rig.pass(40);
    assert_eq!(gripper.acknowledge(), Ok(()));
    assert_eq!(gripper.age_ms(Topic::Width), Some(41), "another request does not report it");
    assert_eq!(gripper.age_ms(Topic::Force), None);

    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while gripper.next_update(50).unwrap().is_some() {}
    rig.inject(&force(7));
    assert_eq!(gripper.next_update(0), Ok(Some(Update::Force(7.0))));
    assert_eq!(gripper.age_ms(Topic::Force), Some(0));
    rig.pass(300_000);
    assert_eq!((gripper.known().force, gripper.age_ms(Topic::Force)), (Some(7.0), Some(300_000)));

    rig.world(|world| world.silent = true);
    while gripper.is_connected() {
        gripper.next_update(50).unwrap();
    }
    for topic in Topic::ALL {
        assert_eq!(gripper.age_ms(topic), None, "{topic:?} of a lost connection");
    }
}

#[test]
fn age_of_a_state_counts_from_its_report_not_from_connecting() {
    let rig = Rig::new();
    // Each is an answer in time.
    for value in [Value::GetSystemInfo(rig::INFO), Value::GetSystemLimits(rig::LIMITS)] {
        rig.script(value.id(), vec![(150, frame(Reply::success(value)))]);
    }
    let mut gripper = connect(&rig);
    for topic in [Topic::SystemState, Topic::GripperState] {
        assert!((300..400).contains(&gripper.age_ms(topic).unwrap()), "{topic:?}");
    }
    let mut gripper = connect_async(&Rig::new());
    assert!(gripper.age_ms(Topic::GripperState).unwrap() < 10);
}

#[test]
fn update_from_before_a_disconnect_is_not_returned_after_it() {
    let (rig, mut gripper) = connected();
    gripper.subscribe(Topic::Force, AutoUpdate::every(10));
    while gripper.next_update(50).unwrap().is_some() {}
    let lost_before = gripper.counters().updates_lost;
    inject_three(&rig);
    assert_eq!(gripper.width(), Ok(Mm(42.5)));
    rig.world(|world| world.silent = true);
    while gripper.is_connected() {
        assert!(gripper.width().is_err());
    }
    assert_eq!(gripper.next_update(0), Ok(None));
    assert_eq!(gripper.counters().updates_lost - lost_before, 3);
    rig.world(|world| world.silent = false);
    gripper.connect().unwrap();
    while let Some(update) = gripper.next_update(50).unwrap() {
        assert_ne!(update, Update::Force(3.0));
    }
}
