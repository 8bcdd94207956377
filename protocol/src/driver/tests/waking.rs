//! Futures polled only on wake-ups: they request each wake-up in time, and none without need.

use super::*;

fn asleep(rig: &Rig) -> Asynch {
    Asynch::new(rig.clone(), Watch(rig.clone()))
}

#[test]
fn motion_runs_to_its_end() {
    let rig = Rig::new();
    let mut gripper = asleep(&rig);
    assert_eq!(rig.run_woken(gripper.connect()), Ok(()));
    assert_eq!(rig.run_woken(gripper.grip(Mm(20.0), MmPerS(50.0))), Ok(Grip::Held));
    assert_eq!(rig.run_woken(gripper.width()), Ok(Mm(42.5)));
}

#[test]
fn gripper_that_is_off_is_given_up_in_time() {
    let rig = Rig::new();
    rig.world(|world| world.silent = true);
    let begun = rig.world(|world| world.now);
    let mut gripper = asleep(&rig);
    assert_eq!(rig.run_woken(gripper.connect()), Err(Error::NotConnected));
    assert_eq!(rig.world(|world| world.now).since(begun), Config::DEFAULT.connect_timeout_ms);
}

#[test]
fn silence_of_the_gripper_is_detected() {
    let rig = Rig::new();
    let mut gripper = asleep(&rig);
    rig.run_woken(gripper.connect()).unwrap();
    rig.world(|world| world.silent = true);
    let begun = rig.world(|world| world.now);
    assert_eq!(rig.run_woken(gripper.grip(Mm(20.0), MmPerS(50.0))), Err(Error::Unanswered));
    assert_eq!(rig.world(|world| world.now).since(begun), Config::DEFAULT.session.reply_timeout_ms);
}

#[test]
fn incomplete_frame_is_discarded_after_its_timeout() {
    let rig = Rig::new();
    let mut gripper = asleep(&rig);
    rig.run_woken(gripper.connect()).unwrap();
    while rig.run_woken(gripper.next_update(0)).unwrap().is_some() {}
    rig.inject(&[0xAA, 0xAA, 0xAA, 0x43, 0xFF]);
    assert_eq!(rig.run_woken(gripper.next_update(30)), Ok(None));
    assert_eq!(gripper.counters().line.dropped, 5);
}
