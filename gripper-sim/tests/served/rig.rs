//! Servers, sockets and clients that the tests share. Every wait is bounded by a socket time-out.

use crate::common::parse;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::path::PathBuf;
use std::time::{Duration, Instant};
use wsg_protocol::{AutoUpdate, Command, FrameEncoder, HomingDirection, Status, SystemFlags};
use wsg_sim::server::{Lines, Log, ServerThread};
use wsg_sim::{Config, MAX_FRAME_LEN};

/// Maximum duration of any wait.
pub(crate) const BOUND: Duration = Duration::from_secs(60);
/// Time scale at which motions take negligible time.
pub(crate) const QUICK: f32 = 100.0;
/// Time scale at which a motion takes more than a second, so that its start can be read before its end even on a busy machine.
pub(crate) const READABLE: f32 = 0.5;

pub(crate) const HOMING: Command<'static> = Command::Homing { direction: HomingDirection::Positive };

/// Repeats `attempt` until it returns something. `what` names the missing thing in the error after [`BOUND`].
#[track_caller]
pub(crate) fn await_some<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        assert!(start.elapsed() < BOUND, "{what}");
        std::thread::yield_now();
    }
}

/// Waits until `holds` returns `true`.
#[track_caller]
pub(crate) fn await_true(what: &str, mut holds: impl FnMut() -> bool) {
    await_some(what, || holds().then_some(()));
}

/// Returns a socket with a time-out for every wait.
pub(crate) fn udp_socket() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(BOUND)).unwrap();
    socket
}

/// Returns the next datagram and its sender.
#[track_caller]
pub(crate) fn recv_datagram(socket: &UdpSocket) -> (Vec<u8>, SocketAddr) {
    let mut buffer = vec![0; 2_048];
    let (len, from) = uninterrupted::recv_from(socket, &mut buffer).expect("a datagram in time");
    buffer.truncate(len);
    (buffer, from)
}

/// Returns an address with a port that the system chooses.
pub(crate) fn any_port() -> Option<SocketAddr> {
    "127.0.0.1:0".parse().ok()
}

pub(crate) fn serve(config: Config, lines: Lines) -> ServerThread {
    ServerThread::start(config, &lines, None).expect("the server starts")
}

pub(crate) fn tcp_lines() -> Lines {
    Lines { tcp: any_port(), ..Lines::default() }
}

/// Returns a path in the temporary directory that no other test uses.
pub(crate) fn scratch(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("wsg-sim-{}-{name}", std::process::id()))
}

/// A file that is deleted on drop.
pub(crate) struct File(pub(crate) PathBuf);

impl File {
    pub(crate) fn new(name: &str, text: &str) -> Self {
        let path = scratch(name);
        std::fs::write(&path, text).unwrap();
        Self(path)
    }

    pub(crate) fn text(&self) -> String {
        std::fs::read_to_string(&self.0).unwrap()
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A server that writes its log to a file.
pub(crate) struct Logged {
    pub(crate) served: ServerThread,
    log: File,
}

impl Logged {
    pub(crate) fn new(name: &str, config: Config, lines: &Lines) -> Self {
        let log = File::new(&format!("{name}.log"), "");
        let served = ServerThread::start(config, lines, Some(Log::to_file(&log.0).unwrap()));
        Self { served: served.expect("the server starts"), log }
    }

    /// Waits until `look` finds something in the log so far.
    pub(crate) fn until<T>(&self, mut look: impl FnMut(&str) -> Option<T>) -> T {
        await_some("an entry of the log", || look(&self.log.text()))
    }

    /// Stops the server and returns the log.
    pub(crate) fn stop(self) -> String {
        self.served.stop().unwrap();
        self.log.text()
    }
}

/// Connects with a time-out for every wait.
pub(crate) fn connect(address: impl ToSocketAddrs) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(BOUND)).unwrap();
    stream.set_write_timeout(Some(BOUND)).unwrap();
    stream.set_nodelay(true).unwrap();
    stream
}

/// Sends a raw HTTP request and returns the status, head and body of the answer.
pub(crate) fn http(control: impl ToSocketAddrs, request: &str) -> (u16, String, String) {
    let mut stream = connect(control);
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer in time");
    let (head, body) = answer.split_once("\r\n\r\n").expect("an answer with a head");
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head.to_owned(), body.to_owned())
}

pub(crate) fn frame(command: Command<'_>) -> Vec<u8> {
    FrameEncoder::new(command.id().code(), command).collect()
}

/// A client of the binary protocol.
pub(crate) struct Client<S>(pub(crate) S);

impl Client<TcpStream> {
    pub(crate) fn of(served: &ServerThread) -> Self {
        Self(connect(served.tcp_address().expect("TCP is served")))
    }
}

impl<S: Read + Write> Client<S> {
    pub(crate) fn send(&mut self, command: Command<'_>) {
        self.0.write_all(&frame(command)).unwrap();
    }

    /// Returns the id and payload of the next frame.
    pub(crate) fn recv(&mut self) -> (u8, Vec<u8>) {
        let mut frame = vec![0; 6];
        self.0.read_exact(&mut frame).expect("an answer in time");
        frame.resize(8 + usize::from(u16::from_le_bytes([frame[4], frame[5]])), 0);
        self.0.read_exact(&mut frame[6..]).expect("the rest of the answer");
        parse(&frame).pop().expect("an intact frame")
    }

    /// Returns the id and status of the only frame in one read, like several clients in the field.
    fn recv_segment(&mut self) -> (u8, Status) {
        let mut buffer = [0; 4 * MAX_FRAME_LEN];
        let len = uninterrupted::read(&mut self.0, &mut buffer).expect("an answer in time");
        let frames = parse(&buffer[..len]);
        assert_eq!(frames.len(), 1, "one read must return exactly one frame: {:02X?}", &buffer[..len]);
        assert_eq!(frames[0].1.len() + 8, len, "the read must not contain other bytes");
        (frames[0].0, status_in(&frames[0].1))
    }

    /// Returns the status in the next frame.
    pub(crate) fn status(&mut self) -> Status {
        status_in(&self.recv().1)
    }

    pub(crate) fn ask(&mut self, command: Command<'_>) -> Status {
        self.send(command);
        let (id, payload) = self.recv();
        assert_eq!(id, command.id().code());
        status_in(&payload)
    }

    /// Runs a motion to its end and returns its second status.
    pub(crate) fn run(&mut self, command: Command<'_>) -> Status {
        assert_eq!(self.ask(command), Status::CmdPending);
        self.status()
    }

    /// Does the same, and requires that each answer is a segment of its own.
    pub(crate) fn run_in_segments(&mut self, command: Command<'_>) -> Status {
        self.send(command);
        assert_eq!(self.recv_segment(), (command.id().code(), Status::CmdPending));
        let (id, status) = self.recv_segment();
        assert_eq!(id, command.id().code());
        status
    }

    pub(crate) fn flags(&mut self) -> SystemFlags {
        self.send(Command::GetSystemState { update: AutoUpdate::once() });
        let (id, payload) = self.recv();
        assert_eq!(id, 0x40);
        SystemFlags::from_bits_retain(u32::from_le_bytes(payload[2..6].try_into().unwrap()))
    }
}

fn status_in(payload: &[u8]) -> Status {
    Status::from_code(u16::from_le_bytes([payload[0], payload[1]]))
}

/// Opens a terminal in raw mode.
#[cfg(unix)]
pub(crate) fn open_terminal(path: &std::path::Path) -> std::fs::File {
    use rustix::fs::{Mode, OFlags};
    use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
    let terminal = rustix::fs::open(path, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
    let mut settings = tcgetattr(&terminal).unwrap();
    settings.make_raw();
    tcsetattr(&terminal, OptionalActions::Now, &settings).unwrap();
    terminal.into()
}

/// Opens a pseudo terminal as the far end of an adapter. Returns it and the path of the device.
#[cfg(unix)]
pub(crate) fn open_adapter() -> (std::fs::File, PathBuf) {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let adapter = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&adapter).unwrap();
    unlockpt(&adapter).unwrap();
    let path = ptsname(&adapter, Vec::new()).unwrap().into_string().unwrap();
    (adapter.into(), path.into())
}
