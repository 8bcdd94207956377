//! `doctor` identifies each connection fault within a bounded time and leaves the gripper unchanged.

use std::io::Write;
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use wsg_protocol::SystemFlags;
use wsg_sim::Config;

use crate::rig::{Ended, Program, TestRig, quick};

/// Exceeds the sum of all time-outs, even on a busy machine.
const LIMIT: Duration = Duration::from_secs(20);

/// Starts a gripper that homes at start-up, and waits until it is referenced.
fn homed(config: Config) -> TestRig {
    let mut rig = TestRig::new(Config { homing_at_start: true, ..config });
    rig.until(|flags| flags.contains(SystemFlags::REFERENCED) && !flags.contains(SystemFlags::MOVING));
    rig
}

fn doctor(address: &str) -> Ended {
    Program::run(&[address, "doctor"])
}

/// Returns the verdict of a check and the rest of its line.
fn line_of<'a>(ended: &'a Ended, check: &str) -> (&'a str, &'a str) {
    let lines = ended.stdout.lines().filter_map(|line| line.split_once(' '));
    let mut lines = lines.map(|(verdict, rest)| (verdict, rest.trim_start()));
    let found = lines.find(|(_, rest)| rest.starts_with(check));
    let (verdict, rest) = found.unwrap_or_else(|| panic!("no line of `{check}`: {ended:?}"));
    (verdict, rest[check.len()..].trim_start())
}

#[track_caller]
fn assert_check(ended: &Ended, check: &str, verdict: &str, text: &str) {
    let line = line_of(ended, check);
    assert!(line.0 == verdict && line.1.contains(text), "{check}: {line:?}, {ended:?}");
}

#[test]
fn healthy_gripper_passes_all_checks_on_each_line_unchanged() {
    let mut rig = homed(quick());
    let before = rig.flags();
    for address in [rig.tcp(), rig.gcl(), rig.serial(), rig.slcan(), rig.gcl_udp()] {
        let ended = doctor(&address);
        assert_eq!(ended.status, 0, "{address}: {ended:?}");
        // On a busy machine these two may end with a warning.
        let of_load = |line: &&str| line.contains("round trip ") || line.contains("update rate ");
        let (timed, others): (Vec<_>, Vec<_>) = ended.stdout.lines().partition(of_load);
        assert_eq!(timed.len(), 2, "{ended:?}");
        assert_eq!(others.iter().filter(|line| line.starts_with("ok ")).count(), 10, "{ended:?}");
        assert!(ended.stdout.ends_with("the gripper is usable\n"), "{ended:?}");
        assert_eq!(rig.flags() - SystemFlags::CMD_FAILURE, before, "{address}");
    }
}

#[test]
fn json_is_one_object_with_every_check_and_the_figures() {
    let rig = homed(quick());
    let ended = Program::run(&[&rig.tcp(), "doctor", "--json"]);
    assert_eq!((ended.status, ended.stdout.lines().count()), (0, 1), "{ended:?}");
    let report: Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!((&report["command"], &report["result"]), (&"doctor".into(), &"done".into()));
    let checks = report["checks"].as_array().unwrap();
    assert_eq!(checks.len(), 13);
    let of = |name: &str| checks.iter().find(|check| check["check"] == name).unwrap();
    assert_eq!((&of("protocol")["verdict"], &of("protocol")["remedy"]), (&"ok".into(), &Value::Null));
    let (median, p99) = (of("round trip")["median_ms"].as_f64(), of("round trip")["p99_ms"].as_f64());
    assert!(median > Some(0.0) && p99 >= median, "{ended:?}");
    assert!(of("update rate")["updates_per_s"].as_f64() > Some(0.0), "{ended:?}");
}

#[test]
fn closed_port_is_reported_on_a_reachable_host() {
    let ended = doctor("tcp://127.0.0.1:1");
    assert_eq!(ended.status, 6, "{ended:?}");
    assert_check(&ended, "reachability", "ok", "the host responds");
    assert_check(&ended, "port", "failed", "Settings -> Command Interface");
    assert_check(&ended, "update rate", "skipped", "");
}

#[test]
fn missing_device_and_unknown_host_are_unreachable() {
    for address in ["serial:/dev/no-such-port", "tcp://no-such-host.invalid"] {
        let ended = doctor(address);
        assert_eq!(ended.status, 6, "{ended:?}");
        assert_check(&ended, "reachability", "failed", "check power, cable and address");
    }
}

#[test]
fn wrong_protocol_is_recognized_and_leaves_no_fast_stop() {
    let mut rig = homed(quick());
    for (address, found) in [
        (rig.gcl().replace("gcl:", "tcp:"), "the text protocol (GCL), which is not"),
        (rig.tcp().replace("tcp:", "gcl:"), "the binary protocol, which is not"),
    ] {
        let ended = doctor(&address);
        assert_eq!(ended.status, 6, "{ended:?}");
        assert_check(&ended, "protocol", "failed", found);
        assert!(line_of(&ended, "update rate").1.contains("updates/s"), "{ended:?}");
        assert!(!rig.flags().contains(SystemFlags::FAST_STOP), "{address}");
    }
}

#[test]
fn checksum_setting_is_found_either_way() {
    for (config, verdict, text) in [
        (quick(), "ok", "evaluated"),
        (Config { answer_bad_checksum: true, ..quick() }, "ok", "evaluated"),
        (Config { check_checksum: false, ..quick() }, "warning", "not evaluated"),
    ] {
        let rig = homed(config);
        let ended = doctor(&rig.tcp());
        assert_eq!(ended.status, 0, "{ended:?}");
        assert_check(&ended, "checksum", verdict, text);
    }
}

#[test]
fn unreferenced_gripper_is_usable_with_warning_and_not_homed() {
    let mut rig = TestRig::new(quick());
    let ended = doctor(&rig.tcp());
    assert_eq!(ended.status, 0, "{ended:?}");
    assert_check(&ended, "referenced", "warning", "run `home`");
    let flags = rig.flags();
    assert!(!flags.intersects(SystemFlags::REFERENCED | SystemFlags::MOVING), "{flags}");
}

#[test]
fn latched_fast_stop_is_reported_and_not_acknowledged() {
    let mut rig = homed(quick());
    assert_eq!(Program::run(&[&rig.serial(), "fast-stop"]).status, 0);
    for address in [rig.tcp(), rig.gcl()] {
        let ended = doctor(&address);
        assert_eq!(ended.status, 4, "{ended:?}");
        assert_check(&ended, "FAST STOP", "failed", "run `ack`");
        assert!(ended.stdout.ends_with("refuses motions\n"), "{ended:?}");
        assert!(rig.flags().contains(SystemFlags::FAST_STOP), "{address}");
    }
}

#[test]
fn lost_connection_is_tried_only_on_request_and_at_rest() {
    for (disconnect_error, verdict, text) in
        [(true, "ok", "run `ack`"), (false, "warning", "switch on the error state on TCP disconnect")]
    {
        let mut rig = homed(Config { disconnect_error, ..quick() });
        assert_check(&doctor(&rig.tcp()), "TCP disconnect", "skipped", "`doctor --try-disconnect`");
        assert_check(&doctor(&rig.serial()), "TCP disconnect", "skipped", "not applicable");
        for address in [rig.tcp(), rig.gcl()] {
            let ended = Program::run(&[&address, "doctor", "--try-disconnect"]);
            assert_eq!(ended.status, 0, "{ended:?}");
            assert_check(&ended, "TCP disconnect", verdict, text);
            assert_eq!(rig.flags().contains(SystemFlags::FAST_STOP), disconnect_error, "{address}");
            assert_eq!(Program::run(&[&rig.serial(), "ack"]).status, 0);
        }
        assert_eq!(Program::run(&[&rig.serial(), "grip", "20", "100"]).status, 0);
        let ended = Program::run(&[&rig.tcp(), "doctor", "--try-disconnect"]);
        assert_check(&ended, "TCP disconnect", "skipped", "without a held part");
        assert!(!rig.flags().contains(SystemFlags::FAST_STOP));
    }
}

/// Listens on a free port and passes each connection to `serve`. Returns the address.
fn listen(serve: impl FnMut(TcpStream) + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || listener.incoming().map_while(Result::ok).for_each(serve));
    format!("127.0.0.1:{port}")
}

#[test]
fn silent_peer_is_abandoned_in_time() {
    let mut kept = Vec::new();
    let place = listen(move |stream| kept.push(stream));
    for scheme in ["tcp", "gcl"] {
        let begin = Instant::now();
        let ended = doctor(&format!("{scheme}://{place}"));
        assert!(begin.elapsed() < LIMIT, "{:?}", begin.elapsed());
        assert_eq!(ended.status, 6, "{ended:?}");
        assert_check(&ended, "protocol", "failed", "no answer");
        assert_check(&ended, "other clients", "failed", "close other connected programs");
    }
}

#[test]
fn peer_that_never_stops_sending_is_abandoned_in_time() {
    let place = listen(|mut stream| while stream.write_all(&[b'x'; 4096]).is_ok() {});
    let begin = Instant::now();
    let ended = doctor(&format!("tcp://{place}"));
    assert!(begin.elapsed() < LIMIT, "{:?}", begin.elapsed());
    assert_eq!(ended.status, 6, "{ended:?}");
    assert_check(&ended, "protocol", "failed", "");
}

#[test]
fn unanswered_datagrams_are_not_mistaken_for_a_connection() {
    // A bound socket that never answers, so that the host does not reject the datagrams.
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let ended = doctor(&format!("gcl+udp://{}", socket.local_addr().unwrap()));
    assert_eq!(ended.status, 6, "{ended:?}");
    assert_check(&ended, "reachability", "failed", "no answer");
    assert_check(&ended, "port", "skipped", "");
}

#[test]
fn peer_that_closes_at_once_is_reported_as_busy() {
    let place = listen(drop);
    let ended = doctor(&format!("tcp://{place}"));
    assert_eq!(ended.status, 6, "{ended:?}");
    assert_check(&ended, "protocol", "failed", "closed the connection");
    assert_check(&ended, "other clients", "failed", "close other connected programs");
}

#[test]
fn motion_of_another_client_is_reported_and_continues() {
    let mut rig = homed(Config { time_scale: 1.0, ..quick() });
    let mut mover = Program::start(&[&rig.gcl()]);
    mover.enter("move 60 30\nwidth\n");
    rig.until_moving();
    let ended = doctor(&rig.tcp());
    assert_eq!(ended.status, 0, "{ended:?}");
    assert_check(&ended, "other clients", "warning", "the fingers are moving");
    assert_eq!((mover.line(), mover.line()), ("done\n".to_owned(), "width 60.00 mm\n".to_owned()));
}
