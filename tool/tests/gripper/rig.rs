//! Test fixtures: a virtual gripper on every line, an independent observer, and the program under test.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use wsg_protocol::SystemFlags;
use wsg_protocol::can::Identifiers;
use wsg_protocol::driver::blocking::Gripper;
use wsg_protocol::driver::host::{StdClock, Udp};
use wsg_sim::server::{CanBus, CanLine, Lines, SerialLine, ServerThread, UdpLine};
use wsg_sim::{Config, Part};

/// Time-out for every wait in a test.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

fn loopback() -> SocketAddr {
    "127.0.0.1:0".parse().unwrap()
}

/// A virtual gripper with a 20 mm part in its way, reachable over every line.
pub(crate) struct TestRig {
    server: ServerThread,
    /// A second client over UDP, which needs no disconnect announcement. An announcement would stop motions.
    observer: Gripper<Udp, StdClock>,
}

/// Returns a configuration with real finger speeds and fast homing.
pub(crate) fn real() -> Config {
    Config { part: Part::of_width(20.0), homing_speed: Some(400.0), ..Config::default() }
}

/// Returns a configuration whose motions take almost no time.
pub(crate) fn quick() -> Config {
    Config { time_scale: 50.0, ..real() }
}

impl TestRig {
    pub(crate) fn new(config: Config) -> Self {
        let socket = UdpSocket::bind(loopback()).unwrap();
        let remote_port = socket.local_addr().unwrap().port();
        let lines = Lines {
            tcp: Some(loopback()),
            udp: Some(UdpLine { address: loopback(), remote_port }),
            serial: Some(SerialLine::Pty),
            can: Some(CanLine { bus: CanBus::Slcan(SerialLine::Pty), identifiers: Identifiers::DEFAULT }),
            gcl: Some(loopback()),
            gcl_udp: Some(loopback()),
            ..Lines::default()
        };
        let server =
            ServerThread::start(config, &lines, None).expect("loopback and pseudo terminals are available");
        let udp = Udp::new(socket, server.udp_address().unwrap()).unwrap();
        let mut observer = Gripper::new(udp, StdClock::new());
        observer.connect().expect("the gripper answers");
        Self { server, observer }
    }

    pub(crate) fn tcp(&self) -> String {
        format!("tcp://{}", self.server.tcp_address().unwrap())
    }

    pub(crate) fn gcl(&self) -> String {
        format!("gcl://{}", self.server.gcl_address().unwrap())
    }

    pub(crate) fn gcl_udp(&self) -> String {
        format!("gcl+udp://{}", self.server.gcl_udp_address().unwrap())
    }

    pub(crate) fn serial(&self) -> String {
        format!("serial:{}", self.server.serial_path().unwrap().display())
    }

    pub(crate) fn slcan(&self) -> String {
        format!("slcan:{}?kbit=1000&id=120", self.server.can_path().unwrap().display())
    }

    pub(crate) fn flags(&mut self) -> SystemFlags {
        self.observer.system_state().expect("the gripper answers")
    }

    /// Polls the flags until they meet a condition, and returns them.
    pub(crate) fn until(&mut self, is_so: impl Fn(SystemFlags) -> bool) -> SystemFlags {
        let begin = Instant::now();
        loop {
            let flags = self.flags();
            if is_so(flags) {
                return flags;
            }
            assert!(begin.elapsed() < PATIENCE, "{flags}");
        }
    }

    pub(crate) fn until_moving(&mut self) {
        self.until(|flags| flags.contains(SystemFlags::MOVING));
    }

    /// Asserts that the fingers were stopped in mid-travel and are not locked by a FAST STOP.
    pub(crate) fn assert_stopped(&mut self) {
        let flags = self.until(|flags| !flags.contains(SystemFlags::MOVING));
        assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
        let width = self.observer.width().unwrap().0;
        // The part would block the fingers at 20 mm.
        assert!(width > 30.0, "the fingers were not stopped: {width} mm, {flags}");
    }
}

/// Exit status and output of a program.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) status: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// A running `wsg gripper`. It is killed when dropped.
pub(crate) struct Program {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Option<Receiver<String>>,
    stderr: Option<Receiver<String>>,
}

/// Reads lines in a thread and sends them, each with its line feed, until the stream ends.
fn lines_of(stream: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            if sender.send(line + "\n").is_err() {
                break;
            }
        }
    });
    receiver
}

impl Program {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        Self::start_with(arguments, |command| command.stdout(Stdio::piped()).stderr(Stdio::piped()))
    }

    pub(crate) fn start_with(arguments: &[&str], prepare: impl FnOnce(&mut Command) -> &mut Command) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wsg"));
        command.arg("gripper").args(arguments).stdin(Stdio::piped());
        let mut child = prepare(&mut command).spawn().expect("the program starts");
        let stdin = child.stdin.take();
        let stdout = child.stdout.take().map(lines_of);
        let stderr = child.stderr.take().map(lines_of);
        Self { child, stdin, stdout, stderr }
    }

    /// Runs the program until it exits.
    pub(crate) fn run(arguments: &[&str]) -> Ended {
        Self::start(arguments).end()
    }

    /// Runs the program until it exits, with these lines on standard input.
    pub(crate) fn run_with_lines(arguments: &[&str], lines: &str) -> Ended {
        let mut program = Self::start(arguments);
        program.enter(lines);
        program.end()
    }

    pub(crate) fn enter(&mut self, lines: &str) {
        self.enter_bytes(lines.as_bytes());
    }

    pub(crate) fn enter_bytes(&mut self, bytes: &[u8]) {
        let stdin = self.stdin.as_mut().expect("standard input is open");
        stdin.write_all(bytes).expect("the program reads its input");
        stdin.flush().unwrap();
    }

    /// Returns the next line of standard output.
    pub(crate) fn line(&mut self) -> String {
        let stdout = self.stdout.as_ref().expect("standard output is read");
        stdout.recv_timeout(PATIENCE).expect("the program prints another line")
    }

    /// Returns the next line of standard error.
    pub(crate) fn error_line(&mut self) -> String {
        let stderr = self.stderr.as_ref().expect("standard error is read");
        stderr.recv_timeout(PATIENCE).expect("the program prints another line")
    }

    /// Stops reading standard error, which breaks the pipe. The reading thread ends at the next line.
    pub(crate) fn close_stderr(&mut self) {
        self.stderr = None;
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).expect("the program is running");
    }

    /// Closes standard input and waits for the program to exit.
    pub(crate) fn end(mut self) -> Ended {
        self.stdin = None;
        let rest = |lines: Option<Receiver<String>>| {
            let begin = Instant::now();
            let mut text = String::new();
            while let Some(line) = lines.as_ref().and_then(|lines| lines.recv_timeout(PATIENCE).ok()) {
                text += &line;
                assert!(begin.elapsed() < PATIENCE, "the program is still writing: {text}");
            }
            text
        };
        let (stdout, stderr) = (rest(self.stdout.take()), rest(self.stderr.take()));
        let status = self.child.wait().expect("the program has closed its output");
        Ended { status: status.code().expect("the program was not killed"), stdout, stderr }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // An error means that the program has already exited.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A temporary file, deleted when dropped.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("wsg-tool-{}-{name}", std::process::id()));
        File::create(&path)
            .and_then(|mut file| file.write_all(text.as_bytes()))
            .expect("the temporary folder is writable");
        Self(path)
    }

    pub(crate) fn path(&self) -> &str {
        self.0.to_str().expect("the path is UTF-8")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
