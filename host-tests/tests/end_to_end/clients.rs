//! Models of public drivers of these grippers: their requests and their assumptions. Each connects to the servers of the
//! virtual gripper as to a real one and sends the same bytes as the original. Every wait is bounded by a time-out of the
//! socket.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream, UdpSocket};
use std::time::{Duration, Instant};
use wsg_protocol::{AutoUpdate, Command, FrameEncoder, HomingDirection, Status, SystemFlags};
use wsg_sim::server::{Lines, ServerThread, UdpLine};
use wsg_sim::{Config, Finger, MAX_FRAME_LEN, Part, PortKind, Time, VirtualGripper};

/// Time limit of every wait.
pub(crate) const BOUND: Duration = Duration::from_secs(60);

/// Requests and answers, copied from the drivers' sources or calculated by their checksum routines.
pub(crate) const ACK: &[u8] = &[0xAA, 0xAA, 0xAA, 0x24, 0x03, 0x00, 0x61, 0x63, 0x6B, 0xDC, 0xB9];
pub(crate) const ACK_DONE: &[u8] = &[0xAA, 0xAA, 0xAA, 0x24, 0x02, 0x00, 0x00, 0x00, 0xB9, 0x7E];
pub(crate) const HOME: &[u8] = &[0xAA, 0xAA, 0xAA, 0x20, 0x01, 0x00, 0x01, 0xAE, 0x93];
const HOME_DONE: &[u8] = &[0xAA, 0xAA, 0xAA, 0x20, 0x02, 0x00, 0x00, 0x00, 0xB3, 0xFD];
const GRIP_PENDING: &[u8] = &[0xAA, 0xAA, 0xAA, 0x25, 0x02, 0x00, 0x1A, 0x00, 0x6D, 0x48];
const GRIP_DONE: &[u8] = &[0xAA, 0xAA, 0xAA, 0x25, 0x02, 0x00, 0x00, 0x00, 0x22, 0x87];

/// Length of the checksum in bytes.
const CHECKSUM_LEN: usize = 2;

pub(crate) fn frame(id: u8, payload: &[u8]) -> Vec<u8> {
    FrameEncoder::new(id, payload).collect()
}

fn without_checksum(id: u8, payload: &[u8]) -> Vec<u8> {
    let mut frame = frame(id, payload);
    frame.truncate(frame.len() - CHECKSUM_LEN);
    frame
}

fn with_checksum_zero(id: u8, payload: &[u8]) -> Vec<u8> {
    [without_checksum(id, payload), vec![0; CHECKSUM_LEN]].concat()
}

fn status(id: u8, status: Status) -> Vec<u8> {
    frame(id, &status.code().to_le_bytes())
}

fn system_state(flags: SystemFlags) -> Vec<u8> {
    frame(0x40, &[&[0, 0][..], &flags.bits().to_le_bytes()].concat())
}

pub(crate) fn floats(values: [f32; 2]) -> Vec<u8> {
    values.map(f32::to_le_bytes).concat()
}

/// Fast fingers, for short tests.
fn config() -> Config {
    Config { time_scale: 4.0, part: Part::of_width(20.0), ..Config::default() }
}

fn serve(config: Config) -> ServerThread {
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    ServerThread::start(config, &lines, None).expect("the server starts")
}

/// A client that treats the result of one `recv` as one frame and compares it with the expected bytes.
pub(crate) struct OneFramePerRecv<S>(pub(crate) S);

impl OneFramePerRecv<TcpStream> {
    fn connect(server: &ServerThread) -> Self {
        let stream = TcpStream::connect(server.tcp_address().expect("the server has a TCP port")).unwrap();
        stream.set_read_timeout(Some(BOUND)).unwrap();
        Self(stream)
    }
}

impl<S: Read + Write> OneFramePerRecv<S> {
    fn send(&mut self, bytes: &[u8]) {
        self.0.write_all(bytes).unwrap();
    }

    fn recv(&mut self) -> Vec<u8> {
        let mut buffer = [0; 4 * MAX_FRAME_LEN];
        let len = uninterrupted::read(&mut self.0, &mut buffer).expect("an answer within the time limit");
        buffer[..len].to_vec()
    }

    #[track_caller]
    fn expect(&mut self, answer: &[u8]) {
        assert_eq!(self.recv(), answer);
    }

    #[track_caller]
    pub(crate) fn ask(&mut self, request: &[u8], answer: &[u8]) {
        self.send(request);
        self.expect(answer);
    }

    /// Runs a motion: E_CMD_PENDING and the result, possibly in one `recv`.
    #[track_caller]
    pub(crate) fn run(&mut self, request: &[u8], result: Status) {
        let id = request[3];
        let pending = status(id, Status::CmdPending);
        self.send(request);
        let mut answers = self.recv();
        if answers == pending {
            answers.extend(self.recv());
        }
        assert_eq!(answers, [pending, status(id, result)].concat());
    }
}

/// A client that calls `recv(n)` once for each expected part, like UMI's driver: first the header, then the rest.
struct RecvWithoutLoop(TcpStream);

impl RecvWithoutLoop {
    fn recv(&mut self, len: usize) -> Vec<u8> {
        let mut buffer = vec![0; len];
        let got = uninterrupted::read(&self.0, &mut buffer).expect("an answer within the time limit");
        assert_eq!(got, len, "one call returns the whole part");
        buffer
    }

    fn recv_frame(&mut self) -> (u8, Vec<u8>) {
        let head = self.recv(6);
        assert_eq!(head[..3], [0xAA; 3]);
        let size = usize::from(u16::from_le_bytes([head[4], head[5]]));
        let mut payload = self.recv(size + CHECKSUM_LEN);
        payload.truncate(size);
        (head[3], payload)
    }
}

#[test]
fn client_with_fixed_expectations_gets_pending_and_result_in_a_recv_each() {
    // Each motion takes more than a second, so the client reads its start before its end is sent.
    let server = serve(Config { time_scale: 0.5, ..config() });
    let mut client = OneFramePerRecv::connect(&server);
    client.ask(ACK, ACK_DONE);
    client.ask(HOME, &status(0x20, Status::CmdPending));
    client.expect(HOME_DONE);
    client.ask(&frame(0x25, &floats([20.0, 100.0])), GRIP_PENDING);
    client.expect(GRIP_DONE);
    client.ask(&frame(0x26, &floats([60.0, 60.0])), &status(0x26, Status::CmdPending));
    client.expect(&status(0x26, Status::Success));
    client.ask(&frame(0x21, &[&[0][..], &floats([30.0, 50.0])].concat()), &status(0x21, Status::CmdPending));
    client.expect(&status(0x21, Status::Success));
}

#[test]
fn client_that_calls_recv_without_a_loop_never_gets_part_of_a_frame() {
    let server = serve(config());
    let stream = OneFramePerRecv::connect(&server).0;
    let mut client = RecvWithoutLoop(stream);
    client.0.write_all(HOME).unwrap();
    assert_eq!(client.recv_frame(), (0x20, vec![0x1A, 0]));
    assert_eq!(client.recv_frame(), (0x20, vec![0, 0]));
    // Also many and long frames.
    let data: Vec<u8> = (0..=255).collect();
    for _ in 0..200 {
        client.0.write_all(&frame(0x06, &data)).unwrap();
        let (id, payload) = client.recv_frame();
        assert_eq!((id, &payload[2..]), (0x06, &data[..]));
    }
}

#[test]
fn loop_of_eight_ff_is_echoed_within_two_seconds() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    client.0.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
    client.ask(&frame(0x06, &[0xFF; 8]), &frame(0x06, &[&[0, 0][..], &[0xFF; 8]].concat()));
}

#[test]
fn checksums_of_zero_are_taken_when_checking_is_off_and_answers_have_right_ones() {
    let server = serve(Config { check_checksum: false, ..config() });
    let mut client = OneFramePerRecv::connect(&server);
    client.ask(&with_checksum_zero(0x24, b"ack"), ACK_DONE);
    client.run(&with_checksum_zero(0x20, &[1]), Status::Success);
    client.run(&with_checksum_zero(0x25, &floats([20.0, 100.0])), Status::Success);
}

#[test]
fn checksum_that_is_left_out_is_taken_from_the_next_frame_when_checking_is_off() {
    let server = serve(Config { check_checksum: false, ..config() });
    let mut client = OneFramePerRecv::connect(&server);
    // The two bytes are mandatory (command set, 1.4.1). They are taken from the next frame's preamble, so that frame is lost.
    let requests = [without_checksum(0x24, b"ack"), without_checksum(0x22, &[]), ACK.to_vec()];
    client.send(&requests.concat());
    let mut both = [ACK_DONE; 2].concat();
    client.0.read_exact(&mut both).expect("two answers within the time limit");
    assert_eq!(both, [ACK_DONE; 2].concat());
}

#[test]
fn frames_without_a_checksum_cost_only_themselves_when_checking_is_on() {
    let server = serve(config());
    for broken in [without_checksum(0x23, &[]), with_checksum_zero(0x23, &[]), without_checksum(0x20, &[1])] {
        let mut client = OneFramePerRecv::connect(&server);
        client.ask(&[broken, ACK.to_vec()].concat(), ACK_DONE);
        client.ask(&frame(0x07, &[]), &status(0x07, Status::Success));
    }
}

#[test]
fn wrong_checksum_is_answered_where_that_is_set() {
    let server = serve(Config { answer_bad_checksum: true, ..config() });
    let mut client = OneFramePerRecv::connect(&server);
    client.ask(&with_checksum_zero(0x22, &[]), &status(0x22, Status::ChecksumError));
    client.ask(ACK, ACK_DONE);
}

#[test]
fn half_a_frame_costs_only_itself_once_its_time_is_over() {
    let server = serve(Config { frame_timeout_ms: 50, ..config() });
    let mut client = OneFramePerRecv::connect(&server);
    client.send(&[0xAA, 0xAA, 0xAA, 0x06, 0xF0, 0x03, 1, 2, 3]);
    // Clients repeat a request without an answer. The first repetitions are consumed as the rest of the incomplete frame.
    client.0.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    let start = Instant::now();
    let answer = loop {
        client.send(ACK);
        let mut answer = vec![0; ACK_DONE.len()];
        match client.0.read_exact(&mut answer) {
            Ok(()) => break answer,
            Err(error) => assert!(start.elapsed() < BOUND, "{error}"),
        }
    };
    assert_eq!(answer, ACK_DONE);
}

#[test]
fn several_frames_in_one_segment_are_answered_one_by_one() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    let subscribe = |id| frame(id, &[0, 0, 0]);
    client.send(&[ACK.to_vec(), subscribe(0x40), subscribe(0x41), frame(0x33, &[])].concat());
    let expected = [
        ACK_DONE.to_vec(),
        frame(0x40, &[0; 6]),
        frame(0x41, &[0; 3]),
        frame(0x33, &[0, 0, 0, 0, 0x20, 0x42]),
    ]
    .concat();
    let mut answers = vec![0; expected.len()];
    client.0.read_exact(&mut answers).expect("all answers within the time limit");
    assert_eq!(answers, expected);
}

#[test]
fn frame_in_pieces_is_one_frame() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    client.0.set_nodelay(true).unwrap();
    for byte in ACK {
        client.send(&[*byte]);
    }
    client.expect(ACK_DONE);
}

#[test]
fn ack_precedes_everything_and_needs_its_key() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    client.ask(ACK, ACK_DONE);
    client.ask(&frame(0x24, &[]), &status(0x24, Status::CmdFormatError));
    client.ask(&frame(0x24, b"ACK"), &status(0x24, Status::CmdFormatError));
    client.ask(ACK, ACK_DONE);
}

#[test]
fn client_that_asks_for_nothing_gets_nothing() {
    let server = serve(config());
    let mut strict = OneFramePerRecv::connect(&server);
    let mut busy = OneFramePerRecv::connect(&server);
    busy.run(HOME, Status::Success);
    busy.ask(&frame(0x43, &[3, 10, 0]), &frame(0x43, &[&[0, 0][..], &110f32.to_le_bytes()].concat()));
    busy.send(&frame(0x25, &floats([20.0, 100.0])));
    let mut seen = Vec::new();
    while !seen.windows(GRIP_DONE.len()).any(|window| window == GRIP_DONE) {
        seen.extend(busy.recv());
    }
    // The first received byte belongs to the answer to the first request.
    strict.ask(&frame(0x06, b"mine"), &frame(0x06, b"\0\0mine"));
}

#[test]
fn updates_come_in_their_period_and_the_width_only_when_referenced() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    // Not referenced: the request is answered with 0 mm, without updates.
    client.ask(&frame(0x43, &[1, 10, 0]), &frame(0x43, &[0; 6]));
    client.ask(&frame(0x45, &[1, 20, 0]), &frame(0x45, &[0; 6]));
    let mut forces = vec![0; 5 * 14];
    client.0.read_exact(&mut forces).expect("updates within the time limit");
    assert_eq!(forces, frame(0x45, &[0; 6]).repeat(5));
    client.send(HOME);
    let mut seen = Vec::new();
    let width = frame(0x43, &[&[0, 0][..], &110f32.to_le_bytes()].concat());
    while !seen.windows(width.len()).any(|window| window == width) {
        seen.extend(client.recv());
    }
    let done =
        seen.windows(HOME_DONE.len()).position(|window| window == HOME_DONE).expect("the end of homing");
    let first = seen.windows(4).position(|window| window == [0xAA, 0xAA, 0xAA, 0x43]).unwrap();
    assert!(done < first, "a width was sent before the end of homing");
}

#[test]
fn unannounced_close_leaves_fast_stop_latched() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    client.run(HOME, Status::Success);
    drop(client);
    let mut next = OneFramePerRecv::connect(&server);
    // The gripper may detect the close slightly after the next connection.
    let stopped =
        system_state(SystemFlags::REFERENCED | SystemFlags::TARGET_POS_REACHED | SystemFlags::FAST_STOP);
    let start = Instant::now();
    loop {
        next.send(&frame(0x40, &[0, 0, 0]));
        if next.recv() == stopped {
            break;
        }
        assert!(start.elapsed() < BOUND, "no FAST STOP");
    }
    next.ask(HOME, &status(0x20, Status::AccessDenied));
    next.ask(ACK, ACK_DONE);
    next.run(HOME, Status::Success);
}

#[test]
fn unannounced_close_changes_nothing_where_that_is_set() {
    let server = serve(Config { disconnect_error: false, ..config() });
    let mut watcher = OneFramePerRecv::connect(&server);
    let mut client = OneFramePerRecv::connect(&server);
    client.ask(ACK, ACK_DONE);
    client.0.shutdown(Shutdown::Write).unwrap();
    assert_eq!(uninterrupted::read(&client.0, &mut [0]).unwrap(), 0, "the gripper closes its end");
    watcher.run(HOME, Status::Success);
}

#[test]
fn announced_client_is_refused_until_it_reconnects() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    client.ask(&frame(0x07, &[]), &status(0x07, Status::Success));
    for (id, payload) in [(0x24, &b"ack"[..]), (0x20, &[1]), (0x06, b"data"), (0x07, &[]), (0x23, &[])] {
        client.ask(&frame(id, payload), &status(id, Status::AccessDenied));
    }
    client.0.shutdown(Shutdown::Write).unwrap();
    assert_eq!(uninterrupted::read(&client.0, &mut [0]).unwrap(), 0, "the gripper closes its end");
    let mut again = OneFramePerRecv::connect(&server);
    // The refusals set SF_CMD_FAILURE. There is no FAST STOP.
    again.ask(&frame(0x40, &[0, 0, 0]), &system_state(SystemFlags::CMD_FAILURE));
    again.run(HOME, Status::Success);
}

/// A client that sends from any port and listens on the fixed one.
struct Udp {
    asking: UdpSocket,
    listening: UdpSocket,
    server: ServerThread,
}

impl Udp {
    fn new(config: Config) -> Self {
        let listening = UdpSocket::bind("127.0.0.1:0").unwrap();
        listening.set_read_timeout(Some(BOUND)).unwrap();
        let line = UdpLine {
            address: "127.0.0.1:0".parse().unwrap(),
            remote_port: listening.local_addr().unwrap().port(),
        };
        let server =
            ServerThread::start(config, &Lines { udp: Some(line), ..Lines::default() }, None).unwrap();
        Self { asking: UdpSocket::bind("127.0.0.1:0").unwrap(), listening, server }
    }

    fn send(&self, bytes: &[u8]) {
        uninterrupted::send_to(&self.asking, bytes, self.server.udp_address().unwrap()).unwrap();
    }

    #[track_caller]
    fn expect(&self, answer: &[u8]) {
        let mut datagram = [0; 4 * MAX_FRAME_LEN];
        let (len, _) = uninterrupted::recv_from(&self.listening, &mut datagram)
            .expect("an answer within the time limit");
        assert_eq!(&datagram[..len], answer);
    }
}

#[test]
fn udp_client_gets_each_answer_as_a_datagram_on_the_fixed_port() {
    let client = Udp::new(config());
    client.send(HOME);
    client.expect(&status(0x20, Status::CmdPending));
    client.expect(HOME_DONE);
    client.send(&frame(0x07, &[]));
    client.expect(&status(0x07, Status::NotAvailable));
    client.asking.set_nonblocking(true).unwrap();
    let nothing = uninterrupted::recv_from(&client.asking, &mut [0])
        .expect_err("no datagram is sent to the requesting port");
    assert_eq!(nothing.kind(), ErrorKind::WouldBlock);
}

#[test]
fn udp_datagram_without_a_checksum_is_no_frame_even_when_checking_is_off() {
    let client = Udp::new(Config { check_checksum: false, ..config() });
    for _ in 0..3 {
        client.send(&without_checksum(0x22, &[]));
        client.send(&with_checksum_zero(0x24, b"ack"));
        client.expect(ACK_DONE);
    }
}

#[test]
fn udp_datagram_that_breaks_off_does_not_spoil_the_next() {
    let client = Udp::new(config());
    client.send(&ACK[..7]);
    client.send(ACK);
    client.expect(ACK_DONE);
}

#[test]
fn can_client_cuts_frames_into_pieces_of_eight_and_only_the_size_ends_them() {
    let mut gripper = VirtualGripper::new(config());
    let port = gripper.connect(PortKind::Can).unwrap();
    let mut buffer = [0; MAX_FRAME_LEN];
    let grip = frame(0x25, &floats([20.0, 100.0]));
    // Stop is exactly one full CAN frame, Grip two, so no short frame marks the end.
    for (request, answer) in [
        (frame(0x22, &[]), status(0x22, Status::Success)),
        (grip, status(0x25, Status::NotInitialized)),
        (ACK.to_vec(), ACK_DONE.to_vec()),
        (frame(0x07, &[]), status(0x07, Status::NotAvailable)),
    ] {
        for piece in request.chunks(8) {
            assert!(!gripper.has_frame(port), "the request was answered before its end");
            gripper.receive(port, Time::ZERO, piece);
        }
        assert_eq!(gripper.transmit(port, &mut buffer), Some(&answer[..]));
    }
}

#[test]
fn force_is_the_sum_over_both_fingers() {
    let server = serve(Config { fingers: [Finger::Fmf; 2], ..config() });
    let mut client = OneFramePerRecv::connect(&server);
    client.run(HOME, Status::Success);
    client.ask(&frame(0x32, &40f32.to_le_bytes()), &status(0x32, Status::Success));
    client.run(&frame(0x25, &floats([20.0, 100.0])), Status::Success);
    let newtons = |value: f32| [&[0, 0][..], &value.to_le_bytes()].concat();
    client.ask(&frame(0x45, &[0, 0, 0]), &frame(0x45, &newtons(40.0)));
    client.ask(&frame(0x63, &[]), &frame(0x63, &newtons(20.0)));
    client.ask(&frame(0x73, &[]), &frame(0x73, &newtons(20.0)));
}

#[test]
fn pre_position_flag_d0_is_relative_and_d1_stops_on_a_block() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    client.run(HOME, Status::Success);
    let go = |flags: u8, width: f32| frame(0x21, &[&[flags][..], &floats([width, 200.0])].concat());
    let width = |width: f32| frame(0x43, &[&[0, 0][..], &width.to_le_bytes()].concat());
    client.run(&go(0b01, -10.0), Status::Success);
    client.ask(&frame(0x43, &[0, 0, 0]), &width(100.0));
    // A client that swaps the two flags moves to 50 mm here instead of by 50 mm.
    client.run(&go(0b10, 50.0), Status::Success);
    client.ask(&frame(0x43, &[0, 0, 0]), &width(50.0));
    client.run(&go(0b10, 10.0), Status::AxisBlocked);
    client.ask(&frame(0x45, &[0, 0, 0]), &frame(0x45, &[0; 6]));
}

#[test]
fn ids_that_scripts_serve_are_unknown_without_a_script() {
    let server = serve(config());
    let mut client = OneFramePerRecv::connect(&server);
    for id in 0xA0..=0xBF {
        // A driver's request to its script consists of a command byte and two floats.
        client.ask(&frame(id, &[&[1][..], &floats([20.0, 50.0])].concat()), &status(id, Status::CmdUnknown));
    }
}

#[test]
fn bytes_of_the_clients_match_the_protocol() {
    let home = Command::Homing { direction: HomingDirection::Positive };
    for (command, bytes) in [(Command::ACKNOWLEDGE, ACK), (home, HOME)] {
        assert_eq!(FrameEncoder::new(command.id().code(), command).collect::<Vec<u8>>(), bytes);
    }
    let update = Command::GetOpeningWidth { update: AutoUpdate::every(10) };
    let bytes: Vec<u8> = FrameEncoder::new(update.id().code(), update).collect();
    assert_eq!(bytes, frame(0x43, &[1, 10, 0]));
}

/// A Unix socket serves as a serial line.
#[cfg(unix)]
mod unix {
    use super::*;
    use std::os::unix::net::UnixStream;
    use wsg_sim::server::SerialLine;

    #[test]
    fn serial_client_may_send_zeros_for_checksums_and_cannot_announce_its_end() {
        let path = std::env::temp_dir().join(format!("wsg-clients-{}", std::process::id()));
        let lines = Lines { serial: Some(SerialLine::Unix(path.clone())), ..Lines::default() };
        let server = ServerThread::start(Config { check_checksum: false, ..config() }, &lines, None).unwrap();
        let stream = UnixStream::connect(server.serial_path().unwrap()).unwrap();
        stream.set_read_timeout(Some(BOUND)).unwrap();
        let mut client = OneFramePerRecv(stream);
        client.ask(&with_checksum_zero(0x24, b"ack"), ACK_DONE);
        client.run(&with_checksum_zero(0x20, &[1]), Status::Success);
        client.ask(&frame(0x07, &[]), &status(0x07, Status::NotAvailable));
    }
}
