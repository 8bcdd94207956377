//! The text protocol on real sockets, and the binary. Every wait is bounded by a socket time-out.

use crate::rig::{BOUND, Logged, READABLE, any_port, connect, recv_datagram, serve, udp_socket};
use std::io::Write;
use std::net::{Shutdown, TcpStream, ToSocketAddrs, UdpSocket};
use std::time::{Duration, Instant};
use wsg_sim::server::Lines;
use wsg_sim::{Config, Part};

fn lines() -> Lines {
    Lines { gcl: any_port(), gcl_udp: any_port(), ..Lines::default() }
}

/// A client that treats the result of one read as one line.
struct GclClient(TcpStream);

impl GclClient {
    fn new(address: impl ToSocketAddrs) -> Self {
        Self(connect(address))
    }

    fn send(&mut self, line: &str) {
        self.0.write_all(format!("{line}\n").as_bytes()).unwrap();
    }

    /// Returns the only line in one read.
    fn recv(&mut self) -> String {
        let mut buffer = [0; 1_024];
        let len = uninterrupted::read(&self.0, &mut buffer).expect("an answer in time");
        let text = str::from_utf8(&buffer[..len]).unwrap();
        let line = text.strip_suffix('\n').expect("a read returns a complete line");
        assert!(!line.contains('\n'), "one read must return exactly one line: {text:?}");
        line.to_owned()
    }

    fn ask(&mut self, line: &str) -> String {
        self.send(line);
        self.recv()
    }

    /// Returns the end of a motion; skips unsolicited lines before it.
    fn run(&mut self, line: &str) -> String {
        assert!(self.ask(line).starts_with("ACK "), "{line}");
        self.recv()
    }
}

#[test]
fn ack_and_fin_are_separate_segments() {
    let served =
        serve(Config { time_scale: READABLE, part: Part::of_width(20.0), ..Config::default() }, lines());
    let mut client = GclClient::new(served.gcl_address().unwrap());
    assert_eq!(client.run("home()"), "FIN HOME");
    assert_eq!(client.run("grip(40, 20)"), "FIN GRIP");
    assert_eq!(client.ask("gripstate?"), "GRIPSTATE=4");
    assert_eq!(client.run("release(30, 40)"), "FIN RELEASE");
    assert_eq!(client.ask("bye()"), "ACK BYE");
}

#[test]
fn connection_closed_without_bye_is_a_fast_stop() {
    let served = serve(Config::default(), lines());
    let address = served.gcl_address().unwrap();
    let mut first = GclClient::new(address);
    let mut watcher = GclClient::new(address);
    assert_eq!(first.ask("bye()"), "ACK BYE");
    // The server closes its end after noticing ours.
    first.0.shutdown(Shutdown::Write).unwrap();
    assert_eq!(uninterrupted::read(&first.0, &mut [0]).unwrap(), 0);
    assert_eq!(watcher.ask("sysflags[12]?"), "SYSFLAGS[12]=0");
    let second = GclClient::new(address);
    second.0.shutdown(Shutdown::Write).unwrap();
    assert_eq!(uninterrupted::read(&second.0, &mut [0]).unwrap(), 0);
    assert_eq!(watcher.ask("sysflags[12]?"), "SYSFLAGS[12]=1");
    assert_eq!(watcher.ask("fsack()"), "ACK FSACK");
    assert_eq!(watcher.ask("sysflags[12]?"), "SYSFLAGS[12]=0");
}

#[test]
fn datagrams_are_answered_to_their_source_port() {
    let served = serve(Config::default(), lines());
    let socket = udp_socket();
    // With and without a line end.
    for line in ["devtype?\r\n", "devtype?"] {
        uninterrupted::send_to(&socket, line.as_bytes(), served.gcl_udp_address().unwrap()).unwrap();
        let (answer, from) = recv_datagram(&socket);
        assert_eq!(answer, b"DEVTYPE=\"WSG 50-110\"\n");
        assert_eq!(Some(from), served.gcl_udp_address());
    }
}

#[test]
fn datagram_from_another_peer_ends_earlier_updates() {
    let served = serve(Config::default(), lines());
    let gripper = served.gcl_udp_address().unwrap();
    let [first, second] = [udp_socket(), udp_socket()];
    uninterrupted::send_to(&first, b"AUTOSEND(\"FORCE\",10)", gripper).unwrap();
    // The acknowledgement and some updates.
    for _ in 0..3 {
        recv_datagram(&first);
    }
    let start = Instant::now();
    while start.elapsed() < Duration::from_millis(100) {
        uninterrupted::send_to(&second, b"SN?", gripper).unwrap();
        assert_eq!(recv_datagram(&second).0, b"SN=1\n");
    }
}

#[test]
fn log_shows_lines_as_they_are() {
    let logged = Logged::new("gcl", Config::default(), &lines());
    let mut client = GclClient::new(logged.served.gcl_address().unwrap());
    client.ask("pos?");
    client.ask("d\u{fc}nn");
    client.ask("bye()");
    drop(client);
    let log = logged.stop();
    for line in ["-> pos?", "<- POS=0.0", "-> d\\xc3\\xbcnn", "<- ERR D 14", "<- ACK BYE"] {
        assert!(log.contains(line), "{line} in {log}");
    }
}

#[test]
fn peer_that_echoes_answers_is_not_answered_forever() {
    let served = serve(Config::default(), lines());
    let gripper = served.gcl_udp_address().unwrap();
    let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
    peer.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let mut datagram = b"debris\n".to_vec();
    let mut answers = 0;
    loop {
        uninterrupted::send_to(&peer, &datagram, gripper).unwrap();
        let mut buffer = [0; 1_024];
        let Ok((len, _)) = uninterrupted::recv_from(&peer, &mut buffer) else { break };
        datagram = buffer[..len].to_vec();
        answers += 1;
        assert!(answers < 100, "the answers must end: {:?}", str::from_utf8(&datagram));
    }
    assert!(answers > 1, "an invalid line is answered");
    uninterrupted::send_to(&peer, b"SN?\n", gripper).unwrap();
    peer.set_read_timeout(Some(BOUND)).unwrap();
    assert_eq!(recv_datagram(&peer).0, b"SN=1\n", "a query is answered");
}
