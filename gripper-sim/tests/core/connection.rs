//! Connections: behaviour that clients in the field rely on, and limits for misbehaving clients.

use crate::common::{Rig, go_to, parse, texts};
use wsg_protocol::{AutoUpdate, Command, FrameEncoder, LoopData, Status, SystemFlags};
use wsg_sim::{Config, DEFAULT_PORTS, MAX_FRAME_LEN, Part, PortKind, Time, VirtualGripper};

fn frame(command: Command<'_>) -> Vec<u8> {
    FrameEncoder::new(command.id().code(), command).collect()
}

#[test]
fn tcp_connection_that_ends_unannounced_latches_a_fast_stop() {
    let mut rig = Rig::on(PortKind::Tcp, Config::default());
    rig.gripper.disconnect(rig.port, rig.now);
    assert!(rig.flags().contains(SystemFlags::FAST_STOP));
    rig.port = rig.gripper.connect(PortKind::Tcp).unwrap();
    assert_eq!(rig.status(Command::Homing { direction: Default::default() }), Status::AccessDenied);
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
    assert_eq!(rig.status(Command::Homing { direction: Default::default() }), Status::CmdPending);
}

#[test]
fn disconnect_error_is_for_tcp_and_can_be_turned_off() {
    for (kind, disconnect_error) in
        [(PortKind::Tcp, false), (PortKind::Udp, true), (PortKind::Serial, true), (PortKind::Can, true)]
    {
        let mut rig = Rig::on(kind, Config { disconnect_error, ..Config::default() });
        rig.gripper.disconnect(rig.port, rig.now);
        assert!(!rig.flags().contains(SystemFlags::FAST_STOP), "{kind}");
    }
}

#[test]
fn announced_disconnection_refuses_further_commands() {
    let mut rig = Rig::on(PortKind::Tcp, Config::default());
    rig.ask(Command::GetGripperState { update: AutoUpdate::every(10) });
    assert_eq!(rig.status(Command::DisconnectAnnouncement), Status::Success);
    for command in [
        Command::GetSystemState { update: Default::default() },
        Command::FastStop,
        Command::ACKNOWLEDGE,
        Command::DisconnectAnnouncement,
        Command::Unknown { id: 0xA5, payload: &[] },
    ] {
        assert_eq!(rig.status(command), Status::AccessDenied, "{command}");
    }
    assert!(rig.wait(100).is_empty(), "updates have ended");
    rig.gripper.disconnect(rig.port, rig.now);
    assert!(!rig.flags().contains(SystemFlags::FAST_STOP));
    rig.port = rig.gripper.connect(PortKind::Tcp).unwrap();
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
}

#[test]
fn announced_disconnection_aborts_a_motion() {
    let mut rig = Rig::on(PortKind::Tcp, Config::default());
    rig.home();
    rig.status(go_to(30.0));
    rig.wait(50);
    rig.send(Command::DisconnectAnnouncement);
    assert_eq!(
        texts(&rig.frames()),
        ["07h Disconnect Announcement E_SUCCESS", "21h Pre-position Fingers E_CMD_ABORTED"]
    );
    assert!(!rig.flags().intersects(SystemFlags::MOVING | SystemFlags::FAST_STOP));
}

/// Command set, 3.1.2: the announcement stops any finger movement.
#[test]
fn announced_disconnection_stops_snapping_fingers() {
    let mut rig = Rig::on(PortKind::Tcp, Config { part: Part::of_width(60.0), ..Config::default() });
    rig.home();
    assert_eq!(rig.run(go_to(10.0)), Status::AxisBlocked);
    rig.set_part(None);
    rig.wait(20);
    rig.send(Command::DisconnectAnnouncement);
    let width = rig.gripper.state().width;
    rig.wait(500);
    assert!(rig.gripper.state().width == width && width > 10.0, "{width}");
}

#[test]
fn disconnect_announcement_is_for_tcp_only() {
    for kind in [PortKind::Udp, PortKind::Serial, PortKind::Can] {
        let mut rig = Rig::on(kind, Config::default());
        assert_eq!(rig.status(Command::DisconnectAnnouncement), Status::NotAvailable, "{kind}");
        assert_eq!(rig.status(Command::Stop), Status::Success);
    }
}

#[test]
fn result_of_a_motion_goes_to_the_client_that_requested_it() {
    let mut rig = Rig::homed(None);
    let other = rig.gripper.connect(PortKind::Serial).unwrap();
    rig.status(go_to(30.0));
    rig.wait(50);
    rig.gripper.receive(other, rig.now, &frame(Command::Stop));
    assert_eq!(texts(&rig.frames_of(other)), ["22h Stop E_SUCCESS"]);
    assert_eq!(texts(&rig.frames()), ["21h Pre-position Fingers E_CMD_ABORTED"]);
}

#[test]
fn queries_are_answered_while_a_motion_runs() {
    let mut rig = Rig::homed(None);
    rig.status(go_to(30.0));
    rig.wait(100);
    assert!(rig.ask(Command::GetOpeningWidth { update: Default::default() }).f32() < 110.0);
    assert_eq!(rig.status(Command::GetForceLimit), Status::Success);
    assert_eq!(rig.next().status(), Status::Success);
}

#[test]
fn wrong_checksum_is_ignored_or_answered_as_configured() {
    let mut bad = frame(Command::FastStop);
    *bad.last_mut().unwrap() ^= 1;
    let mut rig = Rig::new(Config::default());
    rig.send_bytes(&bad);
    assert!(rig.frames().is_empty());
    assert!(!rig.flags().contains(SystemFlags::FAST_STOP));
    assert_eq!(rig.gripper.counters(rig.port).unwrap().parser.bad_checksum, 1);

    let mut rig = Rig::new(Config { answer_bad_checksum: true, ..Config::default() });
    rig.send_bytes(&bad);
    assert_eq!(texts(&rig.frames()), ["23h Issue FAST STOP E_CHECKSUM_ERROR"]);
    assert_eq!(rig.status(Command::Stop), Status::Success);
}

#[test]
fn zero_checksum_is_accepted_when_checking_is_off() {
    let mut rig = Rig::new(Config { check_checksum: false, ..Config::default() });
    let mut bytes = frame(Command::GetForceLimit);
    let checksum_at = bytes.len() - 2;
    bytes[checksum_at..].fill(0);
    rig.send_bytes(&bytes);
    let answer = rig.frames().remove(0);
    assert_eq!(parse(&answer.frame).len(), 1, "the answer has a correct checksum");
}

#[test]
fn frames_without_a_checksum_are_recovered_from() {
    let mut rig = Rig::new(Config { check_checksum: false, ..Config::default() });
    let bytes = frame(Command::Stop);
    for lacking in [2, 1] {
        rig.send_bytes(&bytes[..bytes.len() - lacking]);
        assert!(rig.wait(600).is_empty(), "an incomplete frame is discarded");
        assert_eq!(rig.status(Command::GetForceLimit), Status::Success);
    }
}

#[test]
fn missing_checksum_consumes_two_bytes_of_the_next_frame() {
    let mut rig = Rig::new(Config { check_checksum: false, ..Config::default() });
    let without = |command| {
        let mut bytes = frame(command);
        bytes.truncate(bytes.len() - 2);
        bytes
    };
    rig.send_bytes(&without(Command::Stop));
    rig.send_bytes(&without(Command::GetForceLimit));
    assert_eq!(texts(&rig.wait(600)), ["22h Stop E_SUCCESS"], "the rest of the second frame is discarded");
}

#[test]
fn half_frame_is_dropped_after_its_time() {
    let request = frame(Command::GetForceLimit);
    let mut rig = Rig::new(Config { frame_timeout_ms: 200, ..Config::default() });
    rig.send_bytes(&request[..5]);
    rig.wait(199);
    rig.send_bytes(&request[5..]);
    assert_eq!(rig.frames().len(), 1, "in time");
    rig.send_bytes(&request[..5]);
    rig.wait(200);
    rig.send_bytes(&request[5..]);
    assert!(rig.frames().is_empty(), "too late");
    assert_eq!(rig.status(Command::GetForceLimit), Status::Success);
}

#[test]
fn frame_held_inside_a_false_one_is_obeyed_when_that_times_out() {
    let mut rig = Rig::new(Config::default());
    // A false header that announces 512 bytes, followed by a frame.
    let mut bytes = vec![0xAA, 0xAA, 0xAA, 0x06, 0x00, 0x02];
    bytes.extend(frame(Command::FastStop));
    rig.send_bytes(&bytes);
    assert!(rig.frames().is_empty());
    assert_eq!(texts(&rig.wait(500)), ["23h Issue FAST STOP E_SUCCESS"]);
}

#[test]
fn datagram_that_ends_inside_a_frame_spoils_none_that_follows() {
    let request = frame(Command::GetForceLimit);
    // The header announces more bytes than the next frame has.
    let longer = frame(Command::Loop { data: LoopData::new(&[7; 40]).unwrap() });
    for check_checksum in [true, false] {
        let mut rig = Rig::on(PortKind::Udp, Config { check_checksum, ..Config::default() });
        // Without its checksum, half of it, the end of its header, or its payload.
        for part in
            [&request[..request.len() - 2], &request[..request.len() - 1], &request[..5], &longer[..7]]
        {
            rig.send_bytes(part);
            assert_eq!(rig.status(Command::GetForceLimit), Status::Success, "{check_checksum}, {part:02x?}");
        }
    }
}

#[test]
fn client_that_does_not_read_loses_updates_first() {
    let mut rig = Rig::homed(None);
    let other = rig.gripper.connect(PortKind::Tcp).unwrap();
    rig.send(Command::GetForce { update: AutoUpdate::every(10) });
    rig.gripper.receive(other, rig.now, &frame(Command::GetForce { update: AutoUpdate::every(10) }));
    rig.now = rig.now.plus_millis(5_000);
    rig.gripper.advance(rig.now);
    let counters = rig.gripper.counters(rig.port).unwrap();
    assert!(counters.updates_lost > 0);
    // There is still room for an answer.
    let data = [7; 256];
    rig.send(Command::Loop { data: LoopData::new(&data).unwrap() });
    assert_eq!(rig.gripper.counters(rig.port).unwrap().replies_lost, 0);
    let frames = rig.frames();
    assert_eq!(frames.last().unwrap().id(), 0x06);
    assert_eq!(
        frames.iter().filter(|sent| sent.id() == 0x45).count(),
        1 + 500 - counters.updates_lost as usize
    );
    // A flood of requests does not grow any buffer; excess answers are counted.
    for _ in 0..1_000 {
        rig.send(Command::Loop { data: LoopData::new(&data).unwrap() });
    }
    assert!(rig.gripper.counters(rig.port).unwrap().replies_lost > 900);
    rig.frames();
    assert_eq!(rig.status(Command::Stop), Status::Success);
}

#[test]
fn clients_are_bounded_and_places_are_used_again() {
    let mut gripper = VirtualGripper::new(Config::default());
    let ports: Vec<_> = (0..DEFAULT_PORTS).map(|_| gripper.connect(PortKind::Serial).unwrap()).collect();
    assert_eq!(gripper.connect(PortKind::Serial), None);
    gripper.disconnect(ports[3], Time::ZERO);
    let again = gripper.connect(PortKind::Serial).unwrap();
    // Answers for the disconnected client do not reach the new one.
    gripper.receive(ports[3], Time::ZERO, &frame(Command::Stop));
    assert!(!gripper.has_frame(again));
    let mut buffer = [0; MAX_FRAME_LEN];
    gripper.receive(again, Time::ZERO, &frame(Command::Stop));
    assert_eq!(gripper.transmit(ports[3], &mut buffer), None);
    assert!(gripper.transmit(again, &mut buffer).is_some());
    assert_eq!(gripper.transmit(again, &mut buffer), None);
}

#[test]
fn nothing_is_sent_without_a_request() {
    let mut rig = Rig::new(Config::default());
    assert!(rig.wait(1_000).is_empty());
    rig.home();
    rig.set_part(Some(20.0));
    rig.status(Command::FastStop);
    assert!(rig.wait(1_000).is_empty());
}
