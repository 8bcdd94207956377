//! A virtual gripper on every line, who looks at it without a part in it, and the program.

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

/// No test waits longer for what must happen.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

fn loopback() -> SocketAddr {
    "127.0.0.1:0".parse().unwrap()
}

/// A gripper with a part of 20 mm before it, on every line.
pub(crate) struct Bench {
    server: ServerThread,
    /// Over UDP, where the end of a connection is not announced: an announcement would end motions.
    observer: Gripper<Udp, StdClock>,
}

/// Whose fingers travel as fast as real ones, and are soon homed.
pub(crate) fn real() -> Config {
    Config { part: Part::of_width(20.0), homing_speed: Some(400.0), ..Config::default() }
}

/// Whose motions take no time to speak of.
pub(crate) fn quick() -> Config {
    Config { time_scale: 50.0, ..real() }
}

impl Bench {
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
            ServerThread::start(config, &lines, None).expect("loopback and pseudo terminals are there");
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

    /// Waits until the flags are as told; which they are.
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

    /// That the fingers were stopped before they had arrived, and may move again.
    pub(crate) fn assert_stopped(&mut self) {
        let flags = self.until(|flags| !flags.contains(SystemFlags::MOVING));
        assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
        let width = self.observer.width().unwrap().0;
        // The part is in the way at 20 mm.
        assert!(width > 30.0, "they went on: {width} mm, {flags}");
    }
}

/// What a program came to.
#[derive(Debug)]
pub(crate) struct Ended {
    pub(crate) status: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// `wsg gripper` that runs. It ends with its test, however that ends.
pub(crate) struct Program {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Option<Receiver<String>>,
    stderr: Option<Receiver<String>>,
}

/// Lines as they come; to the end, `None` is waited for.
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
        let mut child = prepare(&mut command).spawn().expect("it starts");
        let stdin = child.stdin.take();
        let stdout = child.stdout.take().map(lines_of);
        let stderr = child.stderr.take().map(lines_of);
        Self { child, stdin, stdout, stderr }
    }

    /// Runs it to its end.
    pub(crate) fn run(arguments: &[&str]) -> Ended {
        Self::start(arguments).end()
    }

    /// The same with these lines on standard input.
    pub(crate) fn run_with_lines(arguments: &[&str], lines: &str) -> Ended {
        let mut program = Self::start(arguments);
        program.say(lines);
        program.end()
    }

    pub(crate) fn say(&mut self, lines: &str) {
        let stdin = self.stdin.as_mut().expect("it is open");
        stdin.write_all(lines.as_bytes()).expect("it reads");
        stdin.flush().unwrap();
    }

    /// The next line on standard output.
    pub(crate) fn line(&mut self) -> String {
        let stdout = self.stdout.as_ref().expect("it is read");
        stdout.recv_timeout(PATIENCE).expect("it says more")
    }

    /// The next line on standard error.
    pub(crate) fn error_line(&mut self) -> String {
        let stderr = self.stderr.as_ref().expect("it is read");
        stderr.recv_timeout(PATIENCE).expect("it says more")
    }

    /// Reads no more of standard error, which is then a broken pipe. The next line ends the thread that reads.
    pub(crate) fn close_stderr(&mut self) {
        self.stderr = None;
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).expect("it runs");
    }

    /// What it comes to, with nothing more on standard input.
    pub(crate) fn end(mut self) -> Ended {
        self.stdin = None;
        let rest = |lines: Option<Receiver<String>>| {
            let begin = Instant::now();
            let mut text = String::new();
            while let Some(line) = lines.as_ref().and_then(|lines| lines.recv_timeout(PATIENCE).ok()) {
                text += &line;
                assert!(begin.elapsed() < PATIENCE, "it goes on: {text}");
            }
            text
        };
        let (stdout, stderr) = (rest(self.stdout.take()), rest(self.stderr.take()));
        let status = self.child.wait().expect("it has closed its output");
        Ended { status: status.code().expect("it ends by itself"), stdout, stderr }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // An error means that it has ended already, which is what is wanted.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A file that is gone with its test.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("wsg-tool-{}-{name}", std::process::id()));
        File::create(&path)
            .and_then(|mut file| file.write_all(text.as_bytes()))
            .expect("a file can be written");
        Self(path)
    }

    pub(crate) fn path(&self) -> &str {
        self.0.to_str().expect("a plain name")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
