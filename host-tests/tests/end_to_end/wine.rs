//! Runs `wsg-sim.exe` in Wine, as an approximation of Windows. `cargo xtask platforms` builds the program, sets Wine's
//! folder and runs these tests. `cargo xtask test` skips them.

use crate::clients::{ACK, ACK_DONE, BOUND, HOME, OneFramePerRecv, floats, frame};
use crate::modbus_tcp::grip_with_tokio_modbus;
use host_tests::example::Process;
use host_tests::terminal::Terminal;
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;
use wsg_protocol::Status;

/// Environment variable with the path of the program.
const PROGRAM: &str = "WSG_SIM_EXE";

fn program(arguments: &[&str]) -> Command {
    let exe = std::env::var_os(PROGRAM).unwrap_or_else(|| {
        panic!("{PROGRAM} must hold the path of wsg-sim.exe: run `cargo xtask platforms`")
    });
    let mut command = Command::new("wine");
    command.arg(exe).args(arguments).stdin(Stdio::null());
    command
}

/// A running program, with the place of each of its lines by name.
struct Served {
    _process: Process,
    places: HashMap<String, String>,
}

impl Served {
    /// Starts the program and waits for its output line that begins with `last`.
    fn start(arguments: &[&str], last: &str) -> Self {
        let child = program(arguments).stdout(Stdio::piped()).spawn();
        let mut process = Process(child.expect("wine must be installed"));
        let printed = BufReader::new(process.0.stdout.take().expect("stdout is piped"));
        let mut served = Self { _process: process, places: HashMap::new() };
        for line in printed.lines() {
            let line = line.expect("readable output");
            let (name, place) = line.split_once(' ').expect("a name and a place");
            served.places.insert(name.to_owned(), place.to_owned());
            if name == last {
                return served;
            }
        }
        panic!("wsg-sim.exe ended before it printed {last}: {:?}", served.places);
    }

    fn connect(&self, name: &str) -> TcpStream {
        let stream = TcpStream::connect(&self.places[name]).unwrap();
        stream.set_read_timeout(Some(BOUND)).unwrap();
        stream
    }

    /// Sends a request to the page's server and returns the stream with the answer.
    fn http(&self, request: &str, body: &str) -> TcpStream {
        let mut stream = self.connect("control");
        let len = body.len();
        let head = format!("{request} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len}\r\n\r\n");
        stream.write_all((head + body).as_bytes()).unwrap();
        stream
    }
}

#[test]
#[ignore = "needs Wine: run `cargo xtask platforms`"]
fn client_with_fixed_expectations_grips_over_tcp() {
    let served = Served::start(&["--tcp", "127.0.0.1:0", "--part", "20", "--time-scale", "4"], "tcp");
    let mut client = OneFramePerRecv(served.connect("tcp"));
    client.ask(ACK, ACK_DONE);
    client.run(HOME, Status::Success);
    client.run(&frame(0x25, &floats([20.0, 100.0])), Status::Success);
    client.ask(&frame(0x45, &[0, 0, 0]), &frame(0x45, &[&[0, 0][..], &40f32.to_le_bytes()].concat()));
    client.run(&frame(0x26, &floats([60.0, 60.0])), Status::Success);
}

#[test]
#[ignore = "needs Wine: run `cargo xtask platforms`"]
fn tokio_modbus_reads_writes_and_grips() {
    let served = Served::start(&["--modbus", "127.0.0.1:0", "--part", "20", "--time-scale", "10"], "modbus");
    grip_with_tokio_modbus(served.places["modbus"].parse().unwrap());
}

#[test]
#[ignore = "needs Wine: run `cargo xtask platforms`"]
fn page_shows_what_its_buttons_do() {
    let served = Served::start(&["--control", "127.0.0.1:0", "--tcp", "127.0.0.1:0"], "page");
    let mut page = String::new();
    served.http("GET /", "").read_to_string(&mut page).unwrap();
    assert!(page.starts_with("HTTP/1.1 200 ") && page.contains("<!doctype html>"), "{page}");

    let mut events = BufReader::new(served.http("GET /events", ""));
    let mut until = |sought: &str| {
        let start = Instant::now();
        let mut line = String::new();
        while !line.contains(sought) {
            line.clear();
            assert!(events.read_line(&mut line).expect("an event within the time limit") > 0, "no {sought}");
            assert!(start.elapsed() < BOUND, "no {sought}");
        }
    };
    until("event: hello");
    let mut answer = String::new();
    served.http("POST /command", r#"{"command":"home"}"#).read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    until(r#""REFERENCED""#);
}

/// Wine 8 wakes the reader of a serial line only when the line holds as many bytes as the reader's buffer (4096), while Windows
/// wakes it at the first byte. The test therefore sends 4096 bytes.
#[test]
#[ignore = "needs Wine: run `cargo xtask platforms`"]
fn com_port_is_a_serial_line() {
    const ROOM: usize = 4_096;
    const PORT: &str = "COM9";
    let (mut line, theirs) = UnixStream::pair().unwrap();
    line.set_read_timeout(Some(BOUND)).unwrap();
    let terminal = Terminal::to(theirs).unwrap();
    // Wine recreates its ports at start, so this port is created afterwards.
    assert!(program(&["--version"]).stdout(Stdio::null()).status().unwrap().success());
    let prefix = std::env::var_os("WINEPREFIX").expect("WINEPREFIX must be set");
    let port = Path::new(&prefix).join("dosdevices").join(PORT.to_lowercase());
    // An earlier run may have left the port.
    let _ = std::fs::remove_file(&port);
    symlink(&terminal.path, &port).unwrap();

    let served = Served::start(&["--serial", PORT], "serial");
    assert_eq!(served.places["serial"], PORT);
    for _ in 0..3 {
        line.write_all(&[vec![0; ROOM - ACK.len()], ACK.to_vec()].concat()).unwrap();
        let mut answer = vec![0; ACK_DONE.len()];
        line.read_exact(&mut answer).expect("an answer within the time limit");
        assert_eq!(answer, ACK_DONE);
    }
}

#[test]
#[ignore = "needs Wine: run `cargo xtask platforms`"]
fn lines_that_windows_lacks_are_refused_in_one_line() {
    for (arguments, expected) in [
        (
            ["--serial", "pty"],
            "no pseudo terminal can be opened: this requires Unix; expected a device, such as COM3",
        ),
        (
            ["--slcan", "pty"],
            "no pseudo terminal can be opened: this requires Unix; expected a device, such as COM3",
        ),
        (
            ["--profibus", "unix:x"],
            "the Unix socket x cannot be opened: this requires Unix; expected a device, such as COM3",
        ),
        (["--can", "can0"], "the CAN interface can0 cannot be opened: SocketCAN requires Linux"),
        (["--profinet", "eth0"], "PROFINET on eth0: packet sockets require Linux"),
    ] {
        let output = program(&arguments).output().unwrap();
        let printed = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), printed.trim_end()), (Some(1), &*format!("wsg-sim: {expected}")));
    }
    let output = program(&["--serial", "COM77"]).output().unwrap();
    let printed = String::from_utf8(output.stderr).unwrap();
    assert!(printed.starts_with("wsg-sim: the serial device COM77 cannot be opened: "), "{printed}");
}
