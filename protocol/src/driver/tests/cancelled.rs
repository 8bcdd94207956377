//! Dropped futures: no byte is lost, no command is sent late, and no answer is assigned to another request.

use super::*;
use crate::Command;

#[test]
fn partly_sent_frame_is_completed() {
    for room in 1..16 {
        let (rig, mut gripper) = connected_async();
        rig.world(|world| world.room = room);
        assert_eq!(rig.run_for(5, gripper.grip(Mm(20.0), MmPerS(50.0))), None);
        rig.world(|world| world.room = usize::MAX);
        assert_eq!(rig.run(gripper.width()), Ok(Mm(42.5)), "{room}");
        assert_eq!(rig.received(CommandId::GripPart), 1, "{room}");
        assert_eq!(gripper.motion(), Some(CommandId::GripPart), "{room}");
        assert_eq!(rig.run(gripper.stop()), Ok(()), "{room}");
    }
}

#[test]
fn answer_to_a_cancelled_setting_does_not_answer_the_next() {
    let (rig, mut gripper) = connected_async();
    let id = CommandId::SetForceLimit;
    rig.script(id, vec![(50, status(id, Status::Success))]);
    assert_eq!(rig.run_for(5, gripper.set_force_limit(N(40.0))), None);
    rig.script_status(id, Status::CmdFormatError);
    assert_eq!(rig.run(gripper.set_force_limit(N(60.0))), Err(Error::Refused(Status::CmdFormatError)));
    assert_eq!(rig.run(gripper.set_force_limit(N(60.0))), Ok(()));
    assert_eq!(rig.world(|world| world.force_limit), 60.0);
}

#[test]
fn dropped_payload_is_not_repeated_and_the_connection_stays() {
    let (rig, mut gripper) = connected_async();
    rig.script(CommandId::SetDeviceTag, vec![]);
    assert_eq!(rig.run_for(5, gripper.set_tag("left")), None);
    assert_eq!(rig.run(gripper.set_tag("right")), Ok(()));
    let tags: Vec<_> = rig.world(|world| world.received.clone());
    assert_eq!(tags, [(0x51, b"left".to_vec()), (0x51, b"right".to_vec())]);
    assert_eq!(gripper.counters().session.disconnects, 0);
}

#[test]
fn cancelled_stop_is_still_sent() {
    let (rig, mut gripper) = connected_async();
    rig.world(|world| world.room = 0);
    assert_eq!(rig.run_for(2, gripper.stop()), None);
    assert_eq!(rig.run_for(2, gripper.fast_stop()), None);
    rig.world(|world| world.room = usize::MAX);
    assert_eq!(rig.run(gripper.width()), Ok(Mm(42.5)));
    assert!(!gripper.fast_stop_pending());
    let first: Vec<u8> = rig.world(|world| world.received.iter().map(|(id, _)| *id).take(2).collect());
    assert_eq!(first, [0x22, 0x23]);
}

#[test]
fn futures_are_send() {
    fn is_send<T: Send>(_: &T) {}
    struct Nothing;
    impl embedded_io::ErrorType for Nothing {
        type Error = core::convert::Infallible;
    }
    impl embedded_io_async::Read for Nothing {
        async fn read(&mut self, _: &mut [u8]) -> Result<usize, Self::Error> {
            Ok(0)
        }
    }
    impl embedded_io_async::Write for Nothing {
        async fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
            Ok(bytes.len())
        }
        async fn flush(&mut self) -> Result<(), Self::Error> {
            Ok(())
        }
    }
    struct Midnight;
    impl Clock for Midnight {
        fn now(&mut self) -> Instant {
            Instant::from_millis(0)
        }
    }
    impl Timer for Midnight {
        async fn wait_until(&mut self, _: Instant) {}
    }
    let mut gripper = asynch::Gripper::new(Nothing, Midnight);
    is_send(&gripper.grip(Mm(20.0), MmPerS(50.0)));
    is_send(&gripper.set_tag("x"));
    let program = async |gripper: &mut asynch::Gripper<_, _>| gripper.grip(Mm(20.0), MmPerS(50.0)).await;
    is_send(&gripper.with_connection(program));
}

#[test]
fn dropped_motion_and_a_new_one_are_not_confused() {
    let (rig, mut gripper) = connected_async();
    rig.script_motion(CommandId::GripPart, Status::CmdFailed);
    assert_eq!(rig.run_for(10, gripper.grip(Mm(20.0), MmPerS(50.0))), None);
    rig.pass(150); // its result is ready to be received
    assert_eq!(rig.run(gripper.grip(Mm(30.0), MmPerS(50.0))), Ok(Grip::Held));
    let widths: Vec<_> =
        rig.world(|world| world.received.iter().map(|(_, payload)| payload.clone()).collect());
    let grip = |width| rig::payload(&Command::GripPart { width, speed: 50.0 });
    assert_eq!(widths, [grip(20.0), grip(30.0)]);
}

#[test]
fn frame_cut_off_by_a_transport_error_is_not_completed() {
    let (rig, mut gripper) = connected_async();
    rig.world(|world| world.room = 7);
    assert_eq!(rig.run_for(5, gripper.grip(Mm(20.0), MmPerS(50.0))), None);
    rig.world(|world| (world.room, world.refuses) = (usize::MAX, true));
    assert_eq!(rig.run(gripper.width()), Err(Error::Transport(Noise)));
    assert_eq!(rig.run(gripper.width()), Err(Error::NotConnected), "the motion was not answered");
    rig.run(gripper.connect()).unwrap();
    assert_eq!(rig.run(gripper.width()), Ok(Mm(42.5)));
    assert_eq!((rig.received(CommandId::GripPart), rig.world(|world| world.stray())), (0, 0));
}

#[test]
fn partly_sent_frame_is_completed_after_a_motion_timeout() {
    /// Starts a motion that never ends.
    fn endless(rig: &Rig) -> (Asynch, Pending<Grip>) {
        let mut gripper = connect_async(rig);
        rig.script_status(CommandId::GripPart, Status::CmdPending);
        let grip = rig.run(gripper.begin_grip(Mm(20.0), MmPerS(50.0))).unwrap();
        (gripper, grip)
    }
    let rig = Rig::new();
    let (mut gripper, grip) = endless(&rig);
    let begun = rig.world(|world| world.now);
    assert_eq!(rig.run(gripper.wait(&grip)), Err(Error::Unanswered));
    let given_up_ms = rig.world(|world| world.now.since(begun));

    let rig = Rig::new();
    let (mut gripper, grip) = endless(&rig);
    assert_eq!(rig.run_for(given_up_ms - 3, gripper.wait(&grip)), None);
    rig.world(|world| world.room = 3);
    assert_eq!(rig.run_for(8, gripper.width()), None);
    rig.world(|world| world.room = usize::MAX);
    assert_eq!(rig.run(gripper.wait(&grip)), Err(Error::Unanswered));
    assert_eq!(rig.run(gripper.width()), Ok(Mm(42.5)));
    assert_eq!((gripper.counters().session.disconnects, rig.world(|world| world.stray())), (0, 0));
}

#[test]
fn only_a_cut_query_frame_is_completed_after_a_disconnect() {
    for is_query in [true, false] {
        let (rig, mut gripper) = connected_async();
        rig.world(|world| world.room = 7);
        if !is_query {
            assert_eq!(rig.run_for(5, gripper.grip(Mm(20.0), MmPerS(50.0))), None);
        }
        for _ in 0..20 {
            let _ = rig.run_for(100, gripper.next_update(50));
        }
        assert!(!gripper.is_connected());
        rig.world(|world| {
            world.room = usize::MAX;
            if !is_query {
                world.restart();
            }
        });
        rig.run(gripper.connect()).unwrap();
        assert_eq!(rig.run(gripper.width()), Ok(Mm(42.5)));
        // The rest of the motion would be stray bytes, and a query without its rest a broken frame.
        assert_eq!((rig.received(CommandId::GripPart), rig.world(|world| world.stray())), (0, 0));
    }
}
