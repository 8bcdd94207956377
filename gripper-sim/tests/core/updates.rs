//! Automatic updates (command set, 3.4.1 to 3.4.6).

use crate::common::{Rig, Sent, go_to, grip};
use wsg_protocol::{AutoUpdate, Command, GripperState, HomingDirection, Status, UpdateFlags};
use wsg_sim::{Config, Part, PortKind, Time};

const WIDTH: u8 = 0x43;

fn width(update: AutoUpdate) -> Command<'static> {
    Command::GetOpeningWidth { update }
}

fn times(frames: &[Sent], id: u8) -> Vec<u64> {
    frames.iter().filter(|sent| sent.id() == id).map(|sent| sent.at.as_micros() / 1_000).collect()
}

#[test]
fn request_is_answered_at_once_and_updates_follow_in_its_period() {
    let mut rig = Rig::homed(None);
    let start = rig.now.as_micros() / 1_000;
    assert_eq!(rig.ask(width(AutoUpdate::every(20))).f32(), 110.0);
    let frames = rig.wait(100);
    assert_eq!(times(&frames, WIDTH), [20, 40, 60, 80, 100].map(|ms| start + ms));
    assert!(frames.iter().all(|sent| sent.status() == Status::Success));
}

#[test]
fn period_below_ten_milliseconds_counts_as_ten() {
    for period in [0, 1, 9, 10] {
        let mut rig = Rig::homed(None);
        rig.ask(width(AutoUpdate::every(period)));
        assert_eq!(rig.wait(100).len(), 10, "period {period}");
    }
}

#[test]
fn request_without_automatic_update_ends_them() {
    let mut rig = Rig::homed(None);
    rig.ask(width(AutoUpdate::every(10)));
    rig.ask(Command::GetForce { update: AutoUpdate::every(10) });
    assert_eq!(rig.wait(20).len(), 4);
    rig.ask(width(AutoUpdate::once()));
    let frames = rig.wait(20);
    assert_eq!(frames.len(), 2, "the other subscription continues");
    assert!(times(&frames, WIDTH).is_empty());
    // The change bit alone does not subscribe.
    rig.ask(Command::GetForce { update: AutoUpdate { flags: UpdateFlags::ON_CHANGE, period_ms: 10 } });
    assert!(rig.wait(50).is_empty());
}

#[test]
fn update_on_change_is_sent_at_a_change_and_keeps_the_period() {
    let mut rig = Rig::homed(None);
    rig.ask(width(AutoUpdate::on_change(50)));
    assert!(rig.wait(1_000).is_empty(), "nothing changes");
    rig.send(go_to(60.0));
    let mut frames = rig.frames();
    frames.extend(rig.wait(2_000));
    let times = times(&frames, WIDTH);
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] >= 50), "{times:?}");
    let widths: Vec<f32> = frames.iter().filter(|sent| sent.id() == WIDTH).map(Sent::f32).collect();
    assert!(widths.windows(2).all(|pair| pair[0] - pair[1] >= 0.01), "{widths:?}");
    assert_eq!(widths.last(), Some(&60.0));
    // 600 ms of travel, with the first update right at the start.
    assert!((11..=13).contains(&widths.len()), "{}", widths.len());
}

#[test]
fn width_is_not_sent_while_not_referenced() {
    let mut rig = Rig::new(Config::default());
    for update in [AutoUpdate::every(10), AutoUpdate::on_change(10)] {
        assert_eq!(rig.ask(width(update)).f32(), 0.0);
        assert!(rig.wait(100).is_empty());
    }
    rig.ask(width(AutoUpdate::every(10)));
    assert_eq!(rig.status(Command::Homing { direction: HomingDirection::Positive }), Status::CmdPending);
    let homed = rig.next();
    assert_eq!(homed.id(), 0x20, "no width is sent before the end of homing");
    assert_eq!(rig.wait(10).iter().map(Sent::f32).collect::<Vec<_>>(), [110.0]);
}

#[test]
fn state_changes_of_a_grip_arrive_in_order() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.ask(Command::GetGripperState { update: AutoUpdate::on_change(10) });
    rig.wait(10);
    rig.send(grip(20.0));
    let mut frames = rig.frames();
    frames.extend(rig.wait(2_000));
    let story: Vec<String> = frames.iter().map(Sent::text).collect();
    assert_eq!(
        story,
        [
            "25h Grip Part E_CMD_PENDING",
            "41h Get Gripper State E_SUCCESS GRIPPING",
            "25h Grip Part E_SUCCESS",
            "41h Get Gripper State E_SUCCESS HOLDING",
        ]
    );
    rig.set_part(None);
    assert_eq!(rig.frames()[0].text(), "41h Get Gripper State E_SUCCESS PART LOST");
    assert_eq!(rig.state(), GripperState::PartLost);
}

#[test]
fn speed_and_force_and_flags_are_sent_on_change_too() {
    let mut rig = Rig::homed(Part::new(20.0, 20.0));
    let on_change = AutoUpdate::on_change(10);
    rig.ask(Command::GetSpeed { update: on_change });
    rig.ask(Command::GetForce { update: on_change });
    rig.ask(Command::GetSystemState { update: on_change });
    rig.wait(10);
    rig.send(grip(20.0));
    let mut frames = rig.frames();
    frames.extend(rig.wait(2_000));
    let of = |id: u8| frames.iter().filter(|sent| sent.id() == id).collect::<Vec<_>>();
    assert!(of(0x44).iter().any(|sent| sent.f32() == -100.0), "closing counts as negative");
    assert_eq!(of(0x44).last().unwrap().f32(), 0.0);
    assert_eq!(of(0x45).last().unwrap().f32(), 40.0);
    assert!(of(0x45).len() >= 2, "the force builds up");
    assert!(of(0x40).iter().any(|sent| sent.text().contains("MOVING")));
}

#[test]
fn updates_belong_to_their_connection_and_end_with_it() {
    let mut rig = Rig::homed(None);
    let other = rig.gripper.connect(PortKind::Serial).unwrap();
    rig.ask(width(AutoUpdate::every(10)));
    rig.wait(20);
    assert!(rig.frames_of(other).is_empty());
    let now = rig.now;
    rig.gripper.disconnect(rig.port, now);
    rig.port = rig.gripper.connect(PortKind::Serial).unwrap();
    assert!(rig.wait(100).is_empty());
}

#[test]
fn updates_end_after_the_configured_silence() {
    const PERIOD_MS: u16 = 100;
    for (kind, ends) in
        [(PortKind::Udp, true), (PortKind::Serial, true), (PortKind::Can, true), (PortKind::Tcp, false)]
    {
        let mut rig = Rig::on(kind, Config { updates_idle_s: 2, ..Config::default() });
        let force = Command::GetForce { update: AutoUpdate::every(PERIOD_MS) };
        rig.ask(force);
        assert_eq!(rig.wait(1_500).len(), 15);
        // Any request restarts the time-out, and its answer is sent first.
        rig.ask(Command::GetForceLimit);
        assert!(rig.wait(1_950).len() >= 19, "{kind}");
        rig.wait(100);
        assert_eq!(rig.wait(1_000).is_empty(), ends, "{kind}");
        // The client can subscribe again.
        rig.ask(force);
        assert!(rig.wait(1_000).len() >= 9, "{kind}");
    }
}

#[test]
fn text_updates_end_after_the_configured_silence() {
    let mut rig = Rig::on(PortKind::GclUdp, Config { updates_idle_s: 2, ..Config::default() });
    rig.send_bytes(b"AUTOSEND(\"FORCE\",100)\n");
    rig.frames();
    assert_eq!(rig.wait(1_950).len(), 19);
    rig.wait(100);
    assert!(rig.wait(1_000).is_empty());
}

#[test]
fn updates_go_on_for_ever_as_delivered() {
    let mut rig = Rig::on(PortKind::Udp, Config::default());
    rig.ask(Command::GetForce { update: AutoUpdate::every(60_000) });
    assert_eq!(rig.wait(600_000).len(), 10);
}

#[test]
fn updates_happen_at_their_own_time_however_late_the_caller_is() {
    let config = Config { part: Part::of_width(20.0), ..Config::default() };
    let script = |step_ms: u64| {
        let mut rig = Rig::homed_with(config);
        rig.ask(width(AutoUpdate::every(13)));
        rig.ask(Command::GetForce { update: AutoUpdate::on_change(10) });
        rig.ask(Command::GetGripperState { update: AutoUpdate::on_change(11) });
        rig.send(grip(20.0));
        let mut bytes = Vec::new();
        let end = rig.now.plus_millis(1_200);
        while rig.now < end {
            rig.now = rig.now.plus_millis(step_ms);
            rig.gripper.advance(rig.now);
            bytes.extend(rig.frames().into_iter().flat_map(|sent| sent.frame));
        }
        bytes
    };
    let every_millisecond = script(1);
    assert!(every_millisecond.len() > 1_000);
    for step_ms in [3, 40, 300, 1_200] {
        assert_eq!(script(step_ms), every_millisecond, "{step_ms} ms at a time");
    }
}

#[test]
fn next_wake_is_when_something_is_sent() {
    let mut rig = Rig::homed(None);
    assert_eq!(rig.gripper.next_wake(), None);
    rig.ask(width(AutoUpdate::every(20)));
    assert_eq!(rig.gripper.next_wake(), Some(rig.now.plus_millis(20)));
    rig.gripper.advance(rig.now.plus_millis(20));
    assert_eq!(rig.frames().len(), 1);
    rig.now = Time::from_micros(rig.gripper.now().as_micros());
    rig.ask(width(AutoUpdate::once()));
    assert_eq!(rig.gripper.next_wake(), None);
}
