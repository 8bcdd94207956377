//! Stop handles in virtual time: they send once, and the driver reports the stop.

use super::*;
use std::io::ErrorKind;

/// Scripts a motion that ends only by Stop or FAST STOP.
fn script_endless(rig: &Rig, motion: CommandId) {
    rig.world(|world| world.flags |= SystemFlags::MOVING);
    rig.script_status(motion, Status::CmdPending);
    for id in [CommandId::Stop, CommandId::FastStop] {
        rig.script(id, vec![(1, status(motion, Status::CmdAborted)), (1, status(id, Status::Success))]);
    }
}

const KINDS: [(StopKind, CommandId); 2] =
    [(StopKind::Stop, CommandId::Stop), (StopKind::FastStop, CommandId::FastStop)];

fn request(handle: &StopHandle, kind: StopKind) -> std::io::Result<()> {
    match kind {
        StopKind::Stop => handle.stop(),
        StopKind::FastStop => handle.fast_stop(),
    }
}

#[test]
fn handle_ends_an_awaited_motion() {
    for (kind, id) in KINDS {
        let (rig, mut gripper) = connected();
        script_endless(&rig, CommandId::PrePosition);
        let handle = gripper.stop_handle().unwrap();
        let begun = rig.world(|world| world.now);
        rig.later(500, move || request(&handle, kind).unwrap());
        assert_eq!(gripper.move_to(Mm(50.0), MmPerS(5.0), OnBlock::Stop), Err(Error::Stopped(kind)));
        assert!(rig.world(|world| world.now).since(begun) < 510);
        assert_eq!((rig.received(id), gripper.motion()), (1, None), "the driver does not send it again");
        assert!(!gripper.fast_stop_pending());
        assert_eq!(gripper.grip(Mm(20.0), MmPerS(50.0)), Ok(Grip::Held), "the stop is reported only once");
        assert_eq!(gripper.counters().session.unsolicited, 0);
    }
}

#[test]
fn handle_of_idle_driver_sends_at_once_and_next_call_reports_it() {
    for (kind, id) in KINDS {
        let (rig, mut gripper) = connected();
        let handle = gripper.stop_handle().unwrap();
        request(&handle, kind).unwrap();
        assert_eq!(rig.received(id), 1);
        assert_eq!(gripper.grip(Mm(20.0), MmPerS(50.0)), Err(Error::Stopped(kind)));
        assert_eq!((rig.received(CommandId::GripPart), rig.received(id)), (0, 1));
        assert_eq!(gripper.counters().session.unsolicited, 0, "its confirmation was awaited");
        assert_eq!(gripper.acknowledge(), Ok(()));
    }
}

#[test]
fn fast_stop_is_reported_before_it_can_be_acknowledged() {
    let (rig, mut gripper) = connected();
    gripper.stop_handle().unwrap().fast_stop().unwrap();
    assert_eq!(gripper.acknowledge(), Err(Error::Stopped(StopKind::FastStop)));
    assert_eq!(rig.received(CommandId::Acknowledge), 0);
}

#[test]
fn fast_stop_outranks_a_stop() {
    let (rig, mut gripper) = connected();
    let handle = gripper.stop_handle().unwrap();
    handle.stop().unwrap();
    handle.fast_stop().unwrap();
    handle.clone().stop().unwrap();
    assert_eq!(gripper.width(), Err(Error::Stopped(StopKind::FastStop)));
    assert_eq!(rig.received(CommandId::FastStop), 1);
}

#[test]
fn own_stop_replaces_a_handles_stop_but_not_its_fast_stop() {
    for (by_handle, own, outcome) in [
        (StopKind::Stop, StopKind::Stop, Ok(())),
        (StopKind::Stop, StopKind::FastStop, Ok(())),
        (StopKind::FastStop, StopKind::FastStop, Ok(())),
        (StopKind::FastStop, StopKind::Stop, Err(Error::Stopped(StopKind::FastStop))),
    ] {
        let (_rig, mut gripper) = connected();
        request(&gripper.stop_handle().unwrap(), by_handle).unwrap();
        let result = if own == StopKind::Stop { gripper.stop() } else { gripper.fast_stop() };
        assert_eq!(result, outcome, "{by_handle} and {own}");
        assert_eq!(gripper.width(), Ok(Mm(42.5)));
    }
}

#[test]
fn unconfirmed_fast_stop_ends_a_call_in_time_and_stays_pending() {
    let (rig, mut gripper) = connected();
    script_endless(&rig, CommandId::GripPart);
    let handle = gripper.stop_handle().unwrap();
    let silent = rig.clone();
    let begun = rig.world(|world| world.now);
    rig.later(50, move || {
        silent.world(|world| world.silent = true);
        handle.fast_stop().unwrap();
    });
    let result = gripper.grip(Mm(20.0), MmPerS(50.0));
    assert_eq!(result, Err(Error::Stopped(StopKind::FastStop)));
    assert!(gripper.fast_stop_pending());
    assert!(rig.world(|world| world.now).since(begun) <= 51 + Config::DEFAULT.confirmation_ms());
    rig.world(|world| world.silent = false);
    gripper.connect().unwrap();
    assert!(!gripper.fast_stop_pending());
}

#[test]
fn handle_writes_nothing_into_a_partly_sent_message() {
    for (room, is_early) in (1..16).flat_map(|room| [(room, true), (room, false)]) {
        let (rig, mut gripper) = connected_async();
        let early = is_early.then(|| gripper.stop_handle().unwrap());
        rig.world(|world| world.room = room);
        assert_eq!(rig.run_for(5, gripper.grip(Mm(20.0), MmPerS(50.0))), None);
        let handle = early.unwrap_or_else(|| gripper.stop_handle().unwrap());
        assert_eq!(handle.stop().unwrap_err().kind(), ErrorKind::WouldBlock);
        assert_eq!(rig.received(CommandId::Stop), 0);
        rig.world(|world| world.room = usize::MAX);
        assert_eq!(rig.run(gripper.width()), Err(Error::Stopped(StopKind::Stop)));
        assert_eq!((rig.received(CommandId::GripPart), rig.received(CommandId::Stop)), (1, 1));
        assert_eq!(rig.world(|world| world.stray()), 0);
    }
}

#[test]
fn motion_waiting_for_the_line_is_not_sent_after_a_stop() {
    let (rig, mut gripper) = connected_async();
    let handle = gripper.stop_handle().unwrap();
    rig.world(|world| world.room = 0);
    {
        let mut grip = core::pin::pin!(gripper.grip(Mm(20.0), MmPerS(50.0)));
        let mut context = core::task::Context::from_waker(core::task::Waker::noop());
        assert!(grip.as_mut().poll(&mut context).is_pending());
        handle.stop().unwrap();
        rig.world(|world| world.room = usize::MAX);
        assert_eq!(rig.run(grip), Err(Error::Stopped(StopKind::Stop)));
    }
    assert_eq!((rig.received(CommandId::GripPart), rig.received(CommandId::Stop)), (0, 1));
    assert_eq!(rig.run(gripper.grip(Mm(20.0), MmPerS(50.0))), Ok(Grip::Held));
}

#[test]
fn stop_rejected_by_a_full_line_is_sent_by_the_driver() {
    for (kind, id) in KINDS {
        let (rig, mut gripper) = connected();
        let handle = gripper.stop_handle().unwrap();
        rig.world(|world| world.direct.lock().unwrap().is_full = true);
        assert_eq!(request(&handle, kind).unwrap_err().kind(), ErrorKind::WouldBlock);
        assert_eq!(rig.received(id), 0);
        assert_eq!(gripper.width(), Err(Error::Stopped(kind)));
        assert_eq!(rig.received(id), 1);
    }
}

#[test]
fn driver_sends_only_the_stop_that_no_handle_has_sent() {
    use StopKind::{FastStop, Stop};
    // Kinds, and whether the line accepts each; numbers of Stop and FAST STOP that the gripper receives.
    for (requests, received) in [
        ([(Stop, true), (Stop, false)], (1, 0)),
        ([(Stop, false), (Stop, true)], (1, 0)),
        ([(Stop, false), (Stop, false)], (1, 0)),
        ([(Stop, true), (FastStop, false)], (1, 1)),
        ([(FastStop, false), (Stop, true)], (1, 1)),
        ([(FastStop, true), (Stop, false)], (0, 1)),
    ] {
        let (rig, mut gripper) = connected();
        let handle = gripper.stop_handle().unwrap();
        for (kind, is_accepted) in requests {
            rig.world(|world| world.direct.lock().unwrap().is_full = !is_accepted);
            assert_eq!(request(&handle, kind).is_ok(), is_accepted);
        }
        let strongest = requests.map(|(kind, _)| kind).into_iter().max().unwrap();
        assert_eq!(gripper.width(), Err(Error::Stopped(strongest)), "{requests:?}");
        assert_eq!(
            (rig.received(CommandId::Stop), rig.received(CommandId::FastStop)),
            received,
            "{requests:?}"
        );
    }
}

#[test]
fn handle_wakes_the_task_of_the_async_driver() {
    struct Woken(core::sync::atomic::AtomicBool);
    impl std::task::Wake for Woken {
        fn wake(self: std::sync::Arc<Self>) {
            self.0.store(true, core::sync::atomic::Ordering::Relaxed);
        }
    }
    let (rig, mut gripper) = connected_async();
    script_endless(&rig, CommandId::GripPart);
    let handle = gripper.stop_handle().unwrap();
    let woken = std::sync::Arc::new(Woken(false.into()));
    let waker = std::sync::Arc::clone(&woken).into();
    let mut context = core::task::Context::from_waker(&waker);
    let mut grip = core::pin::pin!(gripper.grip(Mm(20.0), MmPerS(50.0)));
    for _ in 0..10 {
        assert!(grip.as_mut().poll(&mut context).is_pending());
        rig.pass(1);
    }
    assert!(!woken.0.load(core::sync::atomic::Ordering::Relaxed));
    handle.fast_stop().unwrap();
    assert!(woken.0.load(core::sync::atomic::Ordering::Relaxed));
    assert_eq!(rig.run(grip), Err(Error::Stopped(StopKind::FastStop)));
}

#[test]
fn handle_of_a_dropped_driver_fails_and_sends_nothing() {
    let (rig, mut gripper) = connected();
    let first = gripper.stop_handle().unwrap();
    gripper.replace_io(rig.clone());
    assert_eq!(first.stop().unwrap_err().kind(), ErrorKind::NotConnected, "its line was replaced");
    let second = gripper.stop_handle().unwrap();
    drop(gripper);
    for handle in [first, second] {
        assert_eq!(handle.stop().unwrap_err().kind(), ErrorKind::NotConnected);
    }
    assert_eq!(rig.received(CommandId::Stop), 0);
}

#[test]
fn handles_may_be_sent_and_shared() {
    fn is_sync<T: Send + Sync + Clone + 'static>() {}
    is_sync::<StopHandle>();
}

#[cfg(feature = "gcl")]
#[test]
fn gcl_has_a_line_for_each_stop_which_is_urgent_once_requested() {
    use crate::driver::link::Link;
    type Gcl = super::gcl::Gcl<76>;
    for (kind, line) in [(StopKind::Stop, "STOP()\n"), (StopKind::FastStop, "FASTSTOP()\n")] {
        let mut message = [0; MAX_STOP_LEN];
        let len = Gcl::stop_message(kind, &mut message);
        assert_eq!(core::str::from_utf8(&message[..len]), Ok(line));
    }
    let mut link = Gcl::new(crate::session::Config::DEFAULT);
    assert!(!link.is_urgent());
    link.request::<()>(Command::FastStop, None).unwrap();
    assert!(link.is_urgent());
}
