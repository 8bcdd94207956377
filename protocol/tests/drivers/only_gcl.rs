//! The differences of the GCL drivers from the binary protocol's drivers.

use std::future::poll_fn;
use std::pin::pin;

use wsg_protocol::driver::{Cause, Finger, Grip, Mm, MmPerS, N, OnBlock, asynch, blocking};
use wsg_protocol::{HomingDirection, SoftLimits, Status, SystemLimits};
use wsg_sim::{Config, Model, Part, PortKind};

use crate::client::{Asynch, Blocking, Calls, Client, Error, Lines};
use crate::rig::TestRig;

fn homed(part: f32) -> Blocking<Lines> {
    Blocking::homed(Config { part: Part::of_width(part), ..Config::default() })
}

/// Returns the lines sent since the last call, without the session's own queries.
fn sent(rig: &TestRig) -> Vec<String> {
    let writes = rig.world(|world| std::mem::take(&mut world.writes));
    let lines = writes.into_iter().map(|bytes| String::from_utf8(bytes).unwrap().trim_end().to_owned());
    lines
        .filter(|line| !["AUTOSEND", "GRIPSTATE", "SYSFLAGS"].iter().any(|own| line.starts_with(own)))
        .collect()
}

/// Lets the driver process all available input.
fn receive(client: &mut Blocking<Lines>) {
    while client.next_update(0).unwrap().is_some() {}
}

#[test]
fn requests_without_a_gcl_equivalent_are_refused_and_not_sent() {
    let mut client = homed(20.0);
    let rig = client.rig();
    sent(&rig);
    let gripper = &mut client.gripper;
    let no = Err(Error::NotInGcl);
    assert_eq!(gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Clamp), no);
    assert_eq!(gripper.move_by(Mm(5.0), MmPerS(100.0), OnBlock::Clamp), no);
    assert_eq!(gripper.statistics(true).map(drop), no);
    assert_eq!(gripper.limits().map(drop), no);
    assert_eq!(gripper.set_acceleration(500.0), no);
    assert_eq!(gripper.acceleration().map(drop), no);
    assert_eq!(gripper.set_soft_limits(SoftLimits { minus: 10.0, plus: 90.0 }), no);
    assert_eq!(gripper.soft_limits().map(drop), no);
    assert_eq!(gripper.clear_soft_limits(), no);
    assert_eq!(gripper.set_overdrive(true), no);
    assert_eq!(gripper.set_tag("left"), no);
    assert_eq!(gripper.set_finger_power(Finger::One, true), no);
    assert_eq!(gripper.loop_back(&[1, 2, 3]), no);
    assert_eq!(gripper.raw(0xB0, &[1], &mut []).map(drop), no);
    assert_eq!(sent(&rig), Vec::<String>::new());
    assert_eq!(Error::NotInGcl.cause(), Cause::Caller);
    assert_eq!(
        gripper.move_to(Mm(50.0), MmPerS(100.0), OnBlock::Stop),
        Ok(()),
        "the connection is unaffected"
    );
}

#[test]
fn grip_states_the_force_limit_and_without_one_it_is_not_sent() {
    let mut client = Blocking::<Lines>::connected(Config { part: Part::of_width(20.0), ..Config::default() });
    let rig = client.rig();
    client.home(HomingDirection::Default).unwrap();
    sent(&rig);
    client.fast_stop().unwrap();
    let denied = Err(Error::Refused(Status::AccessDenied));
    assert_eq!(client.grip_with_force(Mm(20.0), MmPerS(100.0), N(30.0)), denied);
    client.acknowledge().unwrap();
    sent(&rig);
    assert_eq!(client.force_limit(), Err(Error::NoForceLimit), "as before the refused grip");
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Err(Error::NoForceLimit));
    assert_eq!(sent(&rig), Vec::<String>::new());
    client.set_force_limit(N(33.5)).unwrap();
    assert_eq!(sent(&rig), Vec::<String>::new(), "GCL has no request for this");
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Ok(Grip::Held));
    assert_eq!(sent(&rig), ["POS?", "GRIP(33.5,20.0,100.0)"]);
    // The driver keeps it.
    client.take_new_line();
    client.connect().unwrap();
    assert_eq!(client.force_limit(), Ok(N(33.5)));
}

/// Checks a driver without stated limits at a gripper of this model.
fn knows_only_the_stroke<C: Client>(mut client: C, model: Model, stroke: f32) {
    let rig = client.rig();
    client.connect().unwrap();
    client.home(HomingDirection::Default).unwrap();
    client.move_to(Mm(stroke), MmPerS(100.0), OnBlock::Stop).unwrap();
    client.move_by(Mm(-30.0), MmPerS(100.0), OnBlock::Stop).unwrap();
    client.set_force_limit(N(500.0)).unwrap();
    sent(&rig);
    let (beyond, mm) = (Mm(stroke + 0.5), format!("0 to {stroke} mm"));
    for (refused, limits) in [
        (client.move_to(beyond, MmPerS(100.0), OnBlock::Stop), &*mm),
        (client.move_to(Mm(-1.0), MmPerS(100.0), OnBlock::Stop), &*mm),
        (client.grip(beyond, MmPerS(100.0)).map(drop), &*mm),
        (client.release(beyond, MmPerS(100.0)), &*mm),
        (client.move_by(Mm(30.5), MmPerS(100.0), OnBlock::Stop), " to 30 mm"),
        (client.move_to(Mm(50.0), MmPerS(-100.0), OnBlock::Stop), "at least 0 mm/s"),
        (client.set_force_limit(N(-1.0)), "at least 0 N"),
    ] {
        let refused = refused.unwrap_err().to_string();
        assert!(
            refused.contains("outside the gripper's limits") && refused.contains(limits),
            "{model}: {refused}"
        );
    }
    assert!(sent(&rig).iter().all(|line| line == "POS?"), "{model}");
}

#[test]
fn stroke_follows_from_the_model_and_no_other_limit_is_known() {
    for model in [Model::Wsg50Stroke110, Model::Wsg50Stroke210, Model::Wsg32, Model::Wsg25, Model::Wsg70] {
        let rig = || TestRig::new(PortKind::GclTcp, Config { model, ..Config::default() });
        let (one, other) = (rig(), rig());
        let stroke = one.limits().stroke;
        let gripper = blocking::GclGripper::new(one.clone(), one.clone());
        knows_only_the_stroke(Blocking::<Lines> { rig: one, gripper }, model, stroke);
        let gripper = asynch::GclGripper::new(other.clone(), other.clone());
        knows_only_the_stroke(Asynch::<Lines> { rig: other, gripper }, model, stroke);
    }
}

#[test]
fn stated_limits_apply_and_do_not_widen_the_stroke() {
    let mut client = homed(20.0);
    let (rig, gripper) = (client.rig(), &mut client.gripper);
    let stated =
        SystemLimits { stroke: 210.0, max_speed: 300.0, nominal_force: 60.0, ..SystemLimits::UNKNOWN };
    gripper.assume_limits(stated);
    assert_eq!(gripper.known().limits, Some(stated));
    sent(&rig);
    for (refused, limits) in [
        (gripper.move_to(Mm(111.0), MmPerS(100.0), OnBlock::Stop), "0 to 110 mm"),
        (gripper.move_to(Mm(50.0), MmPerS(301.0), OnBlock::Stop), "0 to 300 mm/s"),
        (gripper.set_force_limit(N(61.0)), "0 to 60 N"),
    ] {
        let refused = refused.unwrap_err().to_string();
        assert!(refused.contains(limits), "{refused}");
    }
    assert_eq!(sent(&rig), Vec::<String>::new());
    // A smaller stroke than that of the model is the exact one of Get System Limits.
    gripper.assume_limits(SystemLimits { stroke: 100.0, ..stated });
    assert!(gripper.move_to(Mm(101.0), MmPerS(100.0), OnBlock::Stop).is_err());
}

#[test]
fn release_is_a_distance_from_the_last_requested_width() {
    let mut client = homed(20.0);
    let rig = client.rig();
    client.grip(Mm(20.0), MmPerS(100.0)).unwrap();
    let held = client.width().unwrap().0;
    sent(&rig);
    client.release(Mm(60.0), MmPerS(150.0)).unwrap();
    assert_eq!(sent(&rig), ["POS?".to_owned(), format!("RELEASE({:?},150.0)", 60.0 - held)]);
}

#[test]
fn release_or_grip_at_the_current_width_makes_no_reverse_step() {
    let mut client = homed(20.0);
    let rig = client.rig();
    client.grip(Mm(20.0), MmPerS(100.0)).unwrap();
    let held = client.width().unwrap().0;
    sent(&rig);
    let _ = client.release(Mm(held), MmPerS(100.0));
    assert_eq!(sent(&rig), ["POS?", "RELEASE(0.0,100.0)"]);

    let mut client = Blocking::<Lines>::homed(Config::default());
    let rig = client.rig();
    client.move_to(Mm(50.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    let width = client.width().unwrap().0;
    let _ = client.grip(Mm(width), MmPerS(100.0));
    let now = client.width().unwrap().0;
    sent(&rig);
    let _ = client.release(Mm(width + 10.0), MmPerS(100.0));
    assert_eq!(sent(&rig), ["POS?".to_owned(), format!("RELEASE({:?},100.0)", width + 10.0 - now)]);
}

#[test]
fn release_towards_the_part_is_refused_and_not_sent() {
    let mut client = homed(20.0);
    let rig = client.rig();
    client.grip(Mm(20.0), MmPerS(100.0)).unwrap();
    sent(&rig);
    assert_eq!(client.release(Mm(10.0), MmPerS(100.0)), Err(Error::NotInGcl));
    assert_eq!(sent(&rig), ["POS?"]);
    assert_eq!(client.release(Mm(60.0), MmPerS(100.0)), Ok(()));
}

#[test]
fn release_without_a_grip_is_refused_by_the_gripper() {
    let mut client = homed(20.0);
    client.move_to(Mm(60.0), MmPerS(200.0), OnBlock::Stop).unwrap();
    assert_eq!(client.release(Mm(80.0), MmPerS(100.0)), Err(Error::Refused(Status::NotAvailable)));
}

#[test]
fn part_outside_the_tolerance_blocks_a_grip() {
    let mut client = homed(60.0);
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Err(Error::Blocked));
}

#[test]
fn tolerance_and_clamping_travel_are_read_and_set() {
    let mut client = homed(26.0);
    assert_eq!(client.gripper.part_width_tolerance(), Ok(Mm(5.0)));
    assert_eq!(client.gripper.set_part_width_tolerance(Mm(7.5)), Ok(Mm(7.5)));
    assert_eq!(client.gripper.part_width_tolerance(), Ok(Mm(7.5)));
    assert_eq!(client.gripper.clamping_travel(), Ok(Mm(5.0)));
    assert_eq!(client.gripper.set_clamping_travel(Mm(2.0)), Ok(Mm(2.0)));
    assert_eq!(client.grip(Mm(20.0), MmPerS(100.0)), Ok(Grip::Held), "6 mm before the nominal width");
    let refused = Err(Error::Refused(Status::RangeError));
    assert_eq!(client.gripper.set_clamping_travel(Mm(-1.0)), refused);
    assert_eq!(client.gripper.clamping_travel(), Ok(Mm(2.0)));
    client.take_new_line();
    assert_eq!(client.gripper.clamping_travel(), Err(Error::NotConnected));
    client.connect().unwrap();
    assert_eq!(client.gripper.part_width_tolerance(), Ok(Mm(5.0)), "the settings end with the connection");
    client.rig().world(|world| world.mute = true);
    assert_eq!(client.gripper.clamping_travel(), Err(Error::Unanswered));

    let mut client = Asynch::<Lines>::connected(Config::default());
    let Asynch { rig, gripper } = &mut client;
    assert_eq!(rig.run(gripper.set_part_width_tolerance(Mm(1.5))), Ok(Mm(1.5)));
    assert_eq!(rig.run(gripper.part_width_tolerance()), Ok(Mm(1.5)));
    assert_eq!(rig.run(gripper.set_clamping_travel(Mm(0.5))), Ok(Mm(0.5)));
    assert_eq!(rig.run(gripper.clamping_travel()), Ok(Mm(0.5)));
}

/// Returns the outcome of a call that is answered by these bytes after its request was sent.
fn answered<T>(rig: &TestRig, call: impl Future<Output = T>, answer: &[u8]) -> T {
    rig.world(|world| world.mute = true);
    let mut call = pin!(call);
    let mut is_requested = false;
    rig.run(poll_fn(|context| {
        let polled = call.as_mut().poll(context);
        if polled.is_pending() && !std::mem::replace(&mut is_requested, true) {
            rig.inject(answer);
        }
        polled
    }))
}

#[test]
fn motion_end_after_a_settings_answer_does_not_replace_it() {
    let mut client = Asynch::<Lines>::homed(Config::default());
    let motion = client.begin_move_to(Mm(10.0), MmPerS(20.0), OnBlock::Stop).unwrap();
    let Asynch { rig, gripper } = &mut client;
    assert_eq!(answered(rig, gripper.part_width_tolerance(), b"PWT=2.5\nERR MOVE 19\n"), Ok(Mm(2.5)));
    assert_eq!(rig.run(gripper.wait(&motion)), Err(Error::Aborted));
}

#[test]
fn setting_queued_after_a_stop_is_withdrawn_with_the_connection() {
    let mut client = Asynch::<Lines>::homed(Config::default());
    let Asynch { rig, gripper } = &mut client;
    rig.world(|world| world.mute = true);
    assert!(rig.run_for(5, gripper.stop()).is_none());
    assert_eq!(rig.run(gripper.part_width_tolerance()), Err(Error::NotConnected));
}

#[test]
fn lines_that_are_too_long_and_stray_bytes_are_counted() {
    let mut client = homed(20.0);
    client.rig().inject(&[b'x'; 300]);
    client.rig().inject(b"\n");
    receive(&mut client);
    let line = client.counters().line;
    assert_eq!((line.oversize, line.bad_checksum), (1, 0));
    assert!(line.dropped > 0, "{line:?}");
}

#[test]
fn line_received_in_pieces_is_awaited() {
    let mut client = homed(20.0);
    let rig = client.rig();
    rig.inject(b"@PO");
    rig.world(|world| world.mute = true);
    rig.pass(1_000);
    receive(&mut client);
    assert_eq!(client.known().width, None);
    rig.inject(b"S=31.5\n");
    receive(&mut client);
    assert_eq!(client.known().width, Some(31.5));
}

#[test]
fn incomplete_line_of_a_broken_connection_is_discarded() {
    let mut client = homed(20.0);
    client.rig().inject(b"@PO");
    receive(&mut client);
    client.take_new_line();
    client.connect().unwrap();
    let counters = client.counters();
    assert_eq!((counters.session.refused, counters.session.repeated), (0, 0), "{counters:?}");
}

#[test]
fn end_over_datagrams_cannot_be_announced() {
    let mut client = Blocking::<Lines>::at(TestRig::new(PortKind::GclUdp, Config::default()));
    client.connect().unwrap();
    assert_eq!(client.announce_disconnect(), Err(Error::Refused(Status::NotAvailable)));
    assert_eq!(client.home(HomingDirection::Default), Ok(()));
}

#[test]
fn only_a_cut_query_line_is_completed_after_a_disconnect() {
    for is_query in [true, false] {
        let mut client = Asynch::<Lines>::homed(Config::default());
        let rig = client.rig();
        let text = || String::from_utf8(rig.world(|world| world.writes.concat())).unwrap();
        rig.pass(500);
        rig.run(client.gripper.next_update(500)).unwrap();
        let before = text();
        rig.world(|world| world.room = 3);
        if !is_query {
            assert_eq!(rig.run_for(5, client.gripper.home(HomingDirection::Default)), None);
        }
        for _ in 0..40 {
            let _ = rig.run_for(100, client.gripper.next_update(50));
        }
        assert!(!client.gripper.is_connected());
        rig.world(|world| world.room = usize::MAX);
        let _ = rig.run_for(200, client.gripper.next_update(100));
        let after = text().split_off(before.len());
        let cut = after.lines().next().unwrap();
        assert_eq!(before.lines().any(|line| line == cut), is_query, "{cut}");
        assert_eq!(after.starts_with("HOM"), !is_query, "{after}");
    }
}
