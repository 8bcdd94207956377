//! Models of public drivers of these grippers: their requests and their assumptions. Each connects to the servers of the
//! virtual gripper as to a real one and sends the same bytes as the original. Every wait is bounded by a time-out of the
//! socket. The tests of `gripper-sim` cover connections, checksums, updates, UDP and CAN.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;
use wsg_protocol::{AutoUpdate, Command, FrameEncoder, HomingDirection, Status};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, MAX_FRAME_LEN, Part};

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
fn strict_client_gets_pending_and_result_in_a_recv_each() {
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
fn client_without_a_recv_loop_never_gets_part_of_a_frame() {
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
fn frame_without_checksum_costs_only_itself_if_checking_is_on() {
    let server = serve(config());
    for broken in [without_checksum(0x23, &[]), with_checksum_zero(0x23, &[]), without_checksum(0x20, &[1])] {
        let mut client = OneFramePerRecv::connect(&server);
        client.ask(&[broken, ACK.to_vec()].concat(), ACK_DONE);
        client.ask(&frame(0x07, &[]), &status(0x07, Status::Success));
    }
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
fn bytes_of_the_clients_match_the_protocol() {
    let home = Command::Homing { direction: HomingDirection::Positive };
    for (command, bytes) in [(Command::ACKNOWLEDGE, ACK), (home, HOME)] {
        assert_eq!(FrameEncoder::new(command.id().code(), command).collect::<Vec<u8>>(), bytes);
    }
    let update = Command::GetOpeningWidth { update: AutoUpdate::every(10) };
    let bytes: Vec<u8> = FrameEncoder::new(update.id().code(), update).collect();
    assert_eq!(bytes, frame(0x43, &[1, 10, 0]));
}
