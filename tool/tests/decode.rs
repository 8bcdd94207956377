//! Runs `wsg decode` on logs of the simulator and on invalid input.

#[path = "common/program.rs"]
mod program;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use program::{printed, wsg};
use wsg_protocol::{Command as Request, FrameEncoder, HomingDirection};
use wsg_sim::Config;
use wsg_sim::server::{Lines, Log, ServerThread};

/// Time-out for reading from the simulator.
const BOUND: Duration = Duration::from_secs(60);

/// A log sink that a test can read.
#[derive(Clone, Default)]
struct Written(Arc<Mutex<Vec<u8>>>);

impl Write for Written {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn connect(address: Option<SocketAddr>) -> TcpStream {
    let stream = TcpStream::connect(address.expect("the server has this line")).unwrap();
    stream.set_read_timeout(Some(BOUND)).unwrap();
    stream
}

#[test]
fn simulator_session_log_is_decoded_frame_by_frame() {
    let log = Written::default();
    let lines =
        Lines { tcp: "127.0.0.1:0".parse().ok(), gcl: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let config = Config { time_scale: 50.0, ..Config::default() };
    let server = ServerThread::start(config, &lines, Some(Log::to(log.clone()))).unwrap();
    let mut stream = connect(server.tcp_address());
    let mut damaged: Vec<u8> = FrameEncoder::new(0x22, Request::Stop).collect();
    damaged[7] ^= 1;
    // A frame with a wrong checksum is not answered.
    stream.write_all(&damaged).unwrap();
    let mut ask = |request: Request<'_>, answers: usize| {
        let frame: Vec<u8> = FrameEncoder::new(request.id().code(), request).collect();
        stream.write_all(&frame).unwrap();
        stream.read_exact(&mut vec![0; answers]).unwrap();
    };
    ask(Request::ACKNOWLEDGE, 10);
    ask(Request::Homing { direction: HomingDirection::Positive }, 20);
    ask(Request::GetSystemLimits, 42);
    ask(Request::DisconnectAnnouncement, 10);
    let mut gcl = connect(server.gcl_address());
    for line in ["POS?\n", "DANCE()\n"] {
        gcl.write_all(line.as_bytes()).unwrap();
        let mut byte = [0];
        while byte != *b"\n" {
            gcl.read_exact(&mut byte).unwrap();
        }
    }
    server.stop().unwrap();

    let log = log.0.lock().unwrap().clone();
    let output = wsg(&["decode"], &log);
    let text = printed(&output);
    assert!(output.status.success(), "{text}");
    let frames = [
        "!!  log: wrong checksum: 22h Stop with 0 bytes of payload",
        "->  24h Acknowledge FAST STOP",
        "<-  24h Acknowledge FAST STOP E_SUCCESS",
        "->  20h Homing positive direction",
        "<-  20h Homing E_CMD_PENDING",
        "<-  20h Homing E_SUCCESS",
        "->  53h Get System Limits",
        "<-  53h Get System Limits E_SUCCESS stroke 110.0 mm",
        "->  07h Disconnect Announcement",
        "<-  07h Disconnect Announcement E_SUCCESS",
        "->  POS queries a value (GCL, 2.3.1)",
        "<-  POS value, in mm",
        "->  not understood: unknown name",
        "<-  DANCE refused or failed: E_CMD_UNKNOWN (14)",
    ];
    let mut rest = text.as_str();
    for frame in frames {
        let at = rest.find(frame).unwrap_or_else(|| panic!("{frame} is missing or out of order:\n{text}"));
        rest = &rest[at..];
    }
    assert!(
        text.contains("9 intact frames, 0 with a wrong checksum, 4 lines of GCL, 0 bytes dropped"),
        "{text}"
    );
}

#[test]
fn input_without_a_frame_fails_with_an_explanation() {
    let output = wsg(&["decode", "-"], &[0x00, 0xFF, 0x01]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        printed(&output).starts_with("wsg: unknown format; expected a hex dump, "),
        "{}",
        printed(&output)
    );
    let raw = wsg(&["decode", "--format", "raw"], &[0x00, 0xFF, 0x01]);
    assert_eq!(raw.status.code(), Some(1));
    assert!(printed(&raw).contains("dropped 3 bytes: no preamble"), "{}", printed(&raw));
    let empty = wsg(&["decode"], b"");
    assert_eq!((empty.status.code(), printed(&empty).as_str()), (Some(1), "wsg: the recording is empty\n"));
    let missing = wsg(&["decode", "no/such/file"], b"");
    assert!(printed(&missing).starts_with("wsg: cannot read no/such/file: "), "{}", printed(&missing));
    let wrong = wsg(&["decode", "--can-id", "0x7FF"], b"");
    assert_eq!(wrong.status.code(), Some(2));
    assert!(printed(&wrong).contains("`0x7FF` is not a CAN identifier"), "{}", printed(&wrong));
}

#[test]
fn closed_output_pipe_is_not_an_error() {
    let stop: Vec<u8> = FrameEncoder::new(0x22, Request::Stop).collect();
    let mut child = Command::new(env!("CARGO_BIN_EXE_wsg"))
        .arg("decode")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    child.stdin.take().expect("standard input is piped").write_all(&stop.repeat(10_000)).unwrap();
    let output = child.wait_with_output().expect("the program exits");
    assert_eq!((output.status.code(), printed(&output).as_str()), (Some(0), ""));
}
