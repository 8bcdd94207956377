//! Features that require Unix: Unix sockets and pseudo terminals as serial lines, unprivileged users, signals. On
//! Windows `wsg-sim` reports that they are missing.

use crate::common::parse;
use crate::common::program::Program;
use crate::modbus::Master;
use crate::rig::{BOUND, Client, HOMING, QUICK, READABLE, any_port, connect, frame, http, scratch, serve};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Command as Process, Stdio};
use std::sync::mpsc;
use std::thread;
use wsg_protocol::{Command, Status};
use wsg_sim::Config;
use wsg_sim::server::{Lines, SerialLine, UdpLine};

const GET_STATE: &str = "GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n";

#[test]
fn random_bytes_on_every_port_leave_it_answering() {
    for check_checksum in [true, false] {
        let path = scratch(if check_checksum { "noise-checked" } else { "noise-unchecked" });
        let lines = Lines {
            tcp: any_port(),
            udp: any_port().map(|address| UdpLine { address, remote_port: 9 }),
            serial: Some(SerialLine::Unix(path)),
            gcl: any_port(),
            modbus: any_port(),
            control: any_port(),
            ..Lines::default()
        };
        let served = serve(Config { check_checksum, disconnect_error: false, ..Config::default() }, lines);
        // A xorshift: any numbers will do, if they are the same on every run.
        let mut random = 0x2545_F491u32;
        let mut noise = || -> Vec<u8> {
            let next = || {
                random ^= random << 13;
                random ^= random >> 17;
                random ^= random << 5;
                // Every other byte is taken from valid frames.
                if random & 0x100 == 0 {
                    random as u8
                } else {
                    [0xAA, 0x00, 0x07, 0x40][random as usize >> 30]
                }
            };
            std::iter::repeat_with(next).take(20_000).collect()
        };
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..4 {
            // The server may close any of them because of the noise.
            let _ = Client::of(&served).0.write_all(&noise());
            for address in [served.control_address(), served.gcl_address(), served.modbus_address()] {
                let _ = TcpStream::connect(address.unwrap()).unwrap().write_all(&noise());
            }
            let _ = UnixStream::connect(served.serial_path().unwrap()).unwrap().write_all(&noise());
            for datagram in noise().chunks(700) {
                uninterrupted::send_to(&udp, datagram, served.udp_address().unwrap()).unwrap();
            }
        }
        assert_eq!(Client::of(&served).ask(Command::GetForceLimit), Status::Success);
        let serial = UnixStream::connect(served.serial_path().unwrap()).unwrap();
        serial.set_read_timeout(Some(BOUND)).unwrap();
        assert_eq!(Client(serial).ask(Command::GetForceLimit), Status::Success);
        let (status, _, answer) = http(served.control_address().unwrap(), GET_STATE);
        assert_eq!(status, 200, "{answer}");
        let input_bits = Master::of(&served).ask(&[2, 0, 0, 0, 8]);
        assert!(input_bits[..2] == [2, 1] && input_bits[2].is_power_of_two(), "one state: {input_bits:02X?}");
        let mut text = connect(served.gcl_address().unwrap());
        text.write_all(b"DEVTYPE?\n").unwrap();
        text.read_exact(&mut [0; 21]).expect("an answer in time");
        served.stop().unwrap();
    }
}

#[test]
fn unix_socket_is_a_serial_line() {
    let path = scratch("line");
    let lines = Lines { serial: Some(SerialLine::Unix(path.clone())), ..Lines::default() };
    let config = Config { time_scale: READABLE, ..Config::default() };
    let served = serve(config, lines);
    let stream = UnixStream::connect(served.serial_path().unwrap()).unwrap();
    stream.set_read_timeout(Some(BOUND)).unwrap();
    let mut client = Client(stream);
    assert_eq!(client.run_in_segments(HOMING), Status::Success);
    assert_eq!(client.ask(Command::DisconnectAnnouncement), Status::NotAvailable);
    drop(served);
    assert!(!path.exists(), "the server deletes its socket");
}

#[test]
fn unix_socket_left_over_by_a_dead_server_is_taken_over() {
    let path = scratch("left-over");
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
    assert!(path.exists());
    let lines = Lines { serial: Some(SerialLine::Unix(path.clone())), ..Lines::default() };
    let served = serve(Config::default(), lines);
    assert!(UnixStream::connect(&path).is_ok());
    drop(served);
}

#[test]
fn pseudo_terminal_serves_successive_clients() {
    let lines = Lines { serial: Some(SerialLine::Pty), ..Lines::default() };
    let served = serve(Config { time_scale: QUICK, ..Config::default() }, lines);
    for _ in 0..2 {
        let path = served.serial_path().unwrap().to_owned();
        let mut terminal = std::fs::OpenOptions::new().read(true).write(true).open(path).unwrap();
        terminal.write_all(&frame(HOMING)).unwrap();
        // A terminal has no read time-out, so a separate thread reads.
        let (done, result) = mpsc::channel();
        thread::spawn(move || {
            let mut answers = [0; 20];
            let read = terminal.read_exact(&mut answers);
            let _ = done.send(read.map(|()| answers));
        });
        let answers = result.recv_timeout(BOUND).expect("answers in time").unwrap();
        let frames = parse(&answers);
        assert_eq!(frames, [(0x20, vec![0x1A, 0]), (0x20, vec![0, 0])]);
    }
}

#[test]
fn low_port_without_privileges_is_replaced_or_explained() {
    let lowest = std::fs::read_to_string("/proc/sys/net/ipv4/ip_unprivileged_port_start");
    if lowest.is_ok_and(|port| port.trim().parse().is_ok_and(|port: u16| port <= 1_000)) {
        // This user may listen on any port.
        return;
    }
    // A place where any user may execute the program.
    let program = scratch("ordinary");
    // By another process: a program that a test beside this one starts would inherit the open file, which is then busy.
    let copied = Process::new("cp").arg(env!("CARGO_BIN_EXE_wsg-sim")).arg(&program).status().unwrap();
    assert!(copied.success());
    let ordinary = |arguments: &[&str]| {
        let mut command = Process::new(&program);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        if rustix::process::geteuid().is_root() {
            command.uid(65_534).gid(65_534);
        }
        command.spawn().unwrap()
    };
    let output = ordinary(&["--tcp", "127.0.0.1:999"]).wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), stderr.lines().count()), (Some(1), 1), "{stderr}");
    assert!(stderr.contains("ports below 1024 require privileges; try --tcp 127.0.0.1:11000"), "{stderr}");

    let mut child = ordinary(&[]);
    let mut stderr = String::new();
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    errors.read_line(&mut stderr).unwrap();
    // The program may have ended because the port is taken.
    let _ = child.kill();
    child.wait().unwrap();
    std::fs::remove_file(&program).unwrap();
    assert!(
        stderr.contains("port 1000 requires privileges that you lack: serving 127.0.0.1:11000 instead"),
        "{stderr}"
    );
}

#[test]
fn binary_serves_until_it_is_interrupted() {
    let mut program = Program::start(&["--tcp", "127.0.0.1:0", "--model", "wsg32", "--time-scale", "50"]);
    assert_eq!(program.line(), "model wsg32");
    let mut client = Client(connect(program.place_of("tcp")));
    assert_eq!(client.ask(Command::GetSystemInfo), Status::Success);
    assert!(program.interrupt().success());
}

/// Sets the limit of descriptors of the program to the number in use plus `more`.
#[cfg(target_os = "linux")]
fn leave_descriptors(program: &Program, more: u64) {
    use rustix::process::{Resource, Rlimit, prlimit};
    let pid = program.pid();
    // The limit applies to the highest number, and numbers are assigned from below.
    let open = std::fs::read_dir(format!("/proc/{}/fd", pid.as_raw_nonzero())).unwrap().count() as u64;
    let limit = Rlimit { current: Some(open + more), maximum: Some(open + more) };
    prlimit(Some(pid), Resource::Nofile, limit).unwrap();
}

#[cfg(target_os = "linux")]
#[test]
fn lack_of_descriptors_is_reported_and_recovered_from() {
    let path = scratch("descriptors");
    let arguments = ["--tcp", "127.0.0.1:0", "--gcl", "127.0.0.1:0", "--gcl-udp", "127.0.0.1:0"];
    let serial = format!("unix:{}", path.display());
    let more = ["--serial", &serial, "--modbus", "127.0.0.1:0", "--control", "127.0.0.1:0"];
    let mut program = Program::start(&[&arguments[..], &more].concat());
    program.place_of("model");
    let tcp = program.place_of("tcp");
    program.place_of("serial");
    let [gcl, _, modbus] = ["gcl", "gcl-udp", "modbus"].map(|name| program.place_of(name));
    let control = program.place_of("control");
    let state = || http(&control, GET_STATE);
    assert_eq!(state().0, 200);

    leave_descriptors(&program, 8);
    // Served connections get their answers, however many others are rejected.
    let served: Vec<TcpStream> = (0..40)
        .map(|_| connect(&tcp))
        .filter_map(|mut stream| {
            let is_served =
                stream.write_all(&frame(Command::Stop)).and_then(|()| stream.read_exact(&mut [0; 10]));
            is_served.is_ok().then_some(stream)
        })
        .collect();
    assert!((1..40).contains(&served.len()), "{}", served.len());
    for port in [&gcl, &modbus] {
        let mut refused = connect(port);
        // End of stream or a reset.
        assert!(
            !matches!(uninterrupted::read(&mut refused, &mut [0; 1]), Ok(1..)),
            "the connection is closed"
        );
    }
    let (status, head, body) = state();
    assert!(status == 503 && body.ends_with("close connections\"}\n"), "{status} {body}");
    assert!(format!("{head}\r\n").contains(&format!("Content-Length: {}\r\n", body.len())), "{head}");
    // This client waits for a descriptor.
    let serial = UnixStream::connect(&path).unwrap();
    serial.set_read_timeout(Some(BOUND)).unwrap();
    assert_eq!(state().0, 503);

    drop(served);
    assert_eq!(
        Client(serial).ask(Command::Acknowledge { key: wsg_protocol::types::AckKey }),
        Status::Success
    );
    while state().0 != 200 {}
    assert_eq!(Client(connect(&tcp)).ask(Command::Stop), Status::Success);
}
