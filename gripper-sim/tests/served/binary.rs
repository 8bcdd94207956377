//! The servers on real sockets and terminals, and the binary. Every wait is bounded by a socket time-out.

use crate::common::{grip, parse};
use crate::rig::{
    BOUND, Client, HOMING, Logged, QUICK, READABLE, await_true, frame, recv_datagram, scratch, serve,
    tcp_lines, udp_socket,
};
use std::io::{self, Write};
use std::net::UdpSocket;
use std::process::Command as Process;
use std::sync::mpsc;
use std::time::{Duration, Instant};
use wsg_protocol::{AutoUpdate, Command, Status};
use wsg_sim::server::{Lines, Log, Profile, ServerThread, UdpLine};
use wsg_sim::{Config, MAX_FRAME_LEN, Part};

fn serve_tcp(config: Config) -> ServerThread {
    serve(config, tcp_lines())
}

#[test]
fn tcp_pending_and_result_are_separate_segments() {
    let part = Part::of_width(20.0);
    let served = serve_tcp(Config { time_scale: READABLE, part, ..Config::default() });
    let mut client = Client::of(&served);
    assert_eq!(client.ask(Command::ACKNOWLEDGE), Status::Success);
    assert_eq!(client.run_in_segments(HOMING), Status::Success);
    assert_eq!(client.run_in_segments(grip(20.0)), Status::Success);
    assert_eq!(client.ask(Command::DisconnectAnnouncement), Status::Success);
}

#[test]
fn real_profile_limits_three_requests_to_15_times_a_second() {
    let lines = Lines { profile: Profile::Real, ..tcp_lines() };
    let served = serve(Config::default(), lines);
    let mut client = Client::of(&served);
    let start = Instant::now();
    for _ in 0..5 {
        for query in [Command::GetForceLimit, Command::GetSystemLimits, Command::GetTemperature] {
            assert_eq!(client.ask(query), Status::Success);
        }
    }
    assert!(start.elapsed() >= Duration::from_millis(5 * 66), "{:?}", start.elapsed());
}

#[test]
fn flooding_tcp_client_does_not_delay_the_others() {
    let served = serve_tcp(Config { disconnect_error: false, ..Config::default() });
    let flood = Client::of(&served);
    flood.0.set_nonblocking(true).unwrap();
    let requests = frame(Command::GetSystemLimits).repeat(1_000);
    let mut stuck = 0;
    let mut client = Client::of(&served);
    let start = Instant::now();
    while stuck < 20 {
        match uninterrupted::write(&flood.0, &requests) {
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => stuck += 1,
            Err(error) => panic!("{error}"),
        }
        assert_eq!(client.ask(Command::GetForceLimit), Status::Success);
        assert!(start.elapsed() < BOUND, "the server does not throttle the flood");
    }
}

#[test]
fn stalled_tcp_clients_do_not_delay_the_others() {
    let served = serve_tcp(Config::default());
    let mut held = Vec::new();
    for _ in 0..20 {
        let mut half = Client::of(&served);
        half.0.write_all(&frame(Command::GetSystemLimits)[..5]).unwrap();
        let mut unread = Client::of(&served);
        unread.send(Command::GetForce { update: AutoUpdate::every(10) });
        held.push((half, unread));
    }
    let mut client = Client::of(&served);
    for _ in 0..200 {
        assert_eq!(client.ask(Command::GetForceLimit), Status::Success);
    }
}

#[test]
fn excess_tcp_connection_is_closed_and_a_free_place_reused() {
    let served = serve_tcp(Config { disconnect_error: false, ..Config::default() });
    let mut clients: Vec<_> = (0..128).map(|_| Client::of(&served)).collect();
    for client in &mut clients {
        assert_eq!(client.ask(Command::GetForceLimit), Status::Success);
    }
    assert_eq!(uninterrupted::read(Client::of(&served).0, &mut [0]).unwrap(), 0);
    drop(clients.pop());
    await_true("the place was not released", || {
        let mut next = Client::of(&served);
        next.send(Command::GetForceLimit);
        // The attempt may precede the release of the place; the server then closes it, too.
        matches!(uninterrupted::read(&next.0, &mut [0; MAX_FRAME_LEN]), Ok(1..))
    });
}

#[test]
fn tcp_pipelined_requests_are_all_answered_in_order() {
    let served = serve_tcp(Config::default());
    let mut client = Client::of(&served);
    let one = [frame(Command::GetSystemLimits), frame(Command::Stop)].concat();
    client.0.write_all(&one.repeat(500)).unwrap();
    let mut bytes = Vec::new();
    let mut buffer = [0; 4_096];
    let expected = 500 * (42 + 10);
    while bytes.len() < expected {
        let len = uninterrupted::read(&client.0, &mut buffer).expect("all answers in time");
        bytes.extend_from_slice(&buffer[..len]);
    }
    let ids: Vec<u8> = parse(&bytes).into_iter().map(|(id, _)| id).collect();
    assert_eq!(ids, [0x53, 0x22].repeat(500));
}

#[test]
fn udp_answers_go_to_the_fixed_remote_port_for_any_source_port() {
    let listener = udp_socket();
    let udp = UdpLine {
        address: "127.0.0.1:0".parse().unwrap(),
        remote_port: listener.local_addr().unwrap().port(),
    };
    let served = serve(
        Config { time_scale: QUICK, ..Config::default() },
        Lines { udp: Some(udp), ..Lines::default() },
    );
    let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
    for (command, answers) in [(Command::GetForceLimit, 1), (HOMING, 2), (Command::DisconnectAnnouncement, 1)]
    {
        uninterrupted::send_to(&sender, &frame(command), served.udp_address().unwrap()).unwrap();
        for _ in 0..answers {
            let frames = parse(&recv_datagram(&listener).0);
            assert_eq!(frames.len(), 1, "one frame per datagram");
            assert_eq!(frames[0].0, command.id().code());
        }
    }
}

/// The sender of a datagram can be forged. Updates would then go to an uninvolved host, here at 400 a second, without an end.
#[test]
fn silent_udp_peer_receives_a_bounded_number_of_datagrams() {
    let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
    let udp =
        UdpLine { address: "127.0.0.1:0".parse().unwrap(), remote_port: peer.local_addr().unwrap().port() };
    let lines = Lines { udp: Some(udp), udp_unanswered: Some(100), ..Lines::default() };
    let served = serve(Config::default(), lines);
    let gripper = served.udp_address().unwrap();
    let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
    let update = AutoUpdate::every(10);
    // In one datagram, because updates that are sent between two of them do not count.
    let subscriptions = [
        Command::GetSystemState { update },
        Command::GetGripperState { update },
        Command::GetOpeningWidth { update },
        Command::GetSpeed { update },
        Command::GetForce { update },
    ];
    let subscriptions = subscriptions.map(frame).concat();
    let subscribe = || uninterrupted::send_to(&sender, &subscriptions, gripper).unwrap();
    let count = || {
        // Updates are sent every 10 ms while they last.
        peer.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
        let mut datagrams = 0;
        while uninterrupted::recv_from(&peer, &mut [0; 2_048]).is_ok() {
            datagrams += 1;
            assert!(datagrams <= 105, "the updates must end");
        }
        datagrams
    };
    subscribe();
    assert!((100..=105).contains(&count()));
    // A client that sends again is answered again.
    subscribe();
    assert!((100..=105).contains(&count()));
}

#[test]
fn log_shows_time_direction_line_bytes_and_meaning() {
    let logged = Logged::new("tcp", Config::default(), &tcp_lines());
    let mut client = Client::of(&logged.served);
    assert_eq!(client.ask(Command::Stop), Status::Success);
    let mut bad = frame(Command::Stop);
    bad[6] ^= 1;
    client.0.write_all(&bad).unwrap();
    assert_eq!(client.ask(Command::GetForceLimit), Status::Success);
    drop(client);
    let log = logged.stop();
    let lines: Vec<&str> = log.lines().collect();
    assert_eq!(lines.len(), 5, "{log}");
    assert!(lines[0].contains(" s tcp 127.0.0.1:"), "{log}");
    assert!(lines[0].contains(" -> AA AA AA 22 00 00 ") && lines[0].ends_with(" 22h Stop"), "{log}");
    assert!(
        lines[1].contains(" <- AA AA AA 22 02 00 00 00 ") && lines[1].ends_with("22h Stop E_SUCCESS"),
        "{log}"
    );
    assert!(lines[2].ends_with("-> wrong checksum: 22h Stop with 0 bytes of payload"), "{log}");
    assert!(lines[4].ends_with("33h Get Force Limit E_SUCCESS 40.0 N"), "{log}");
}

#[test]
fn log_shows_the_checksum_that_was_sent_and_no_other() {
    let config = Config { check_checksum: false, ..Config::default() };
    let logged = Logged::new("unchecked", config, &tcp_lines());
    let mut client = Client::of(&logged.served);
    // One frame without a checksum, then one with a checksum of zeros. Two preamble bytes of the second become the
    // checksum of the first.
    let mut stop = frame(Command::Stop);
    stop.truncate(6);
    for request in [[&stop[..], &stop, &[0, 0]].concat(), [&stop[..], &[0x12, 0x34]].concat()] {
        client.0.write_all(&request).unwrap();
        assert_eq!(client.recv(), (0x22, vec![0, 0]));
    }
    drop(client);
    let log = logged.stop();
    let sent: Vec<&str> =
        log.lines().filter_map(|line| line.split_once(" -> ")).map(|(_, sent)| sent).collect();
    assert_eq!(sent, ["AA AA AA 22 00 00 AA AA  22h Stop", "AA AA AA 22 00 00 12 34  22h Stop"], "{log}");
}

/// Runs the binary to its end and returns its exit status, standard output and standard error.
fn sim(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Process::new(env!("CARGO_BIN_EXE_wsg-sim")).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn binary_refuses_what_cannot_be_served_in_one_line() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap().to_string();
    let no_device = scratch("no-device");
    let no_device = no_device.to_str().unwrap();
    for (arguments, status, named) in [
        (&["--tcp", &taken][..], 1, taken.as_str()),
        (&["--serial", no_device], 1, no_device),
        (&["--serial", "/dev/null"], 1, "/dev/null"),
        (&["--model", "wsg1"], 2, "wsg50-110"),
        (&["--nonsense"], 2, "--nonsense"),
    ] {
        let (code, stdout, stderr) = sim(arguments);
        assert_eq!((code, stdout.as_str()), (Some(status), ""), "{arguments:?}: {stderr}");
        assert!(stderr.starts_with("wsg-sim: ") && stderr.contains(named), "{stderr}");
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
    }
    let (code, stdout, _) = sim(&["--help"]);
    assert!(code == Some(0) && stdout.contains("--time-scale"));
}

/// A log output that blocks until released.
struct Stuck {
    gate: mpsc::Receiver<()>,
    taken: mpsc::Sender<Vec<u8>>,
}

impl Write for Stuck {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let _ = self.gate.recv();
        let _ = self.taken.send(bytes.to_vec());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn unread_log_does_not_delay_the_gripper_and_reports_lost_lines() {
    let (open, gate) = mpsc::channel();
    let (taken, log) = mpsc::channel();
    let stuck = Log::to(Stuck { gate, taken });
    let served = ServerThread::start(Config::default(), &tcp_lines(), Some(stuck)).unwrap();
    let mut client = Client::of(&served);
    for _ in 0..6_000 {
        assert_eq!(client.ask(Command::Stop), Status::Success);
    }
    drop(open);
    let mut lines = String::new();
    while !lines.contains(" lines are lost here") {
        lines += str::from_utf8(&log.recv_timeout(BOUND).expect("the log continues")).unwrap();
        // The next line is logged together with the number of lost lines.
        assert_eq!(client.ask(Command::Stop), Status::Success);
    }
    served.stop().unwrap();
}

#[test]
fn unread_log_does_not_delay_the_shutdown() {
    let (_open, gate) = mpsc::channel();
    let (taken, _log) = mpsc::channel();
    let stuck = Log::to(Stuck { gate, taken });
    let served = ServerThread::start(Config::default(), &tcp_lines(), Some(stuck)).unwrap();
    assert_eq!(Client::of(&served).ask(Command::Stop), Status::Success);
    let start = Instant::now();
    served.stop().unwrap();
    assert!(start.elapsed() < BOUND);
}
