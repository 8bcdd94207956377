//! Runs `wsg demo` on ports that the system chooses.
#![cfg(unix)]

#[path = "common/program.rs"]
mod program;

use std::fs::OpenOptions;
use std::io::{BufRead, BufReader, Lines, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use document::read;
use host_tests::world::modbus::sealed;
use program::{printed, wsg};
use rustix::process::{Pid, Signal, kill_process};
use tokio::time::timeout;
use tokio_modbus::client::{Context, Reader, Writer, rtu};
use tokio_modbus::slave::Slave;

const FREE: [&str; 6] = ["--page", "localhost:0", "--tcp", "127.0.0.1:0", "--modbus", "127.0.0.1:0"];

#[test]
fn demo_plays_a_cycle_with_a_lost_part() {
    let output = wsg(&[&["demo", "--cycles", "1", "--speed-up", "50"], &FREE[..]].concat(), b"");
    let shown = printed(&output);
    assert_eq!(output.status.code(), Some(0), "{shown}");
    // Without addresses and times.
    let lines: Vec<_> = shown.lines().skip(4).filter_map(|line| line.get(8..)).collect();
    assert_eq!(
        lines,
        [
            "HOME: the fingers search for their end stop",
            "referenced at 110.0 mm",
            "GRIP a part of 20.0 mm",
            "HOLDING at 19.6 mm with 40.0 N",
            "the part is pulled out",
            "PART LOST",
            "RELEASE to 60.0 mm",
            "IDLE at 60.0 mm",
            "GRIP a part of 20.0 mm",
            "HOLDING at 19.6 mm with 40.0 N",
            "RELEASE to 60.0 mm",
            "IDLE at 60.0 mm",
            "cycle 1 is complete",
        ]
    );
    // The quick start shows the first lines, with default addresses and real times.
    let text = read("docs/quick-start.md");
    let (_, block) = text.split_once("```console\n   page ").unwrap();
    let shown: Vec<_> = shown.lines().collect();
    let documented: Vec<_> = block.split("```").next().unwrap().lines().collect();
    assert_eq!(documented[3].trim(), shown[3]);
    let steps: Vec<_> = documented[4..].iter().filter_map(|line| line.get(11..)).collect();
    assert_eq!(steps, lines[..steps.len()]);
    assert_eq!(steps.len(), 3);
}

#[test]
fn demo_serves_its_page_and_modbus_until_ctrl_c() {
    let mut demo = Command::new(env!("CARGO_BIN_EXE_wsg"))
        .args([&["demo", "--speed-up", "50"], &FREE[..]].concat())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(demo.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut address = |word: &str| {
        let line = lines.next().unwrap();
        line.strip_prefix(word).unwrap_or_else(|| panic!("{line}")).trim().to_owned()
    };
    let page = address("page     http://");
    let (_, modbus) = (address("gripper  tcp://"), address("modbus   "));

    let mut client = TcpStream::connect(page.trim_end_matches('/')).unwrap();
    write!(client, "GET / HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", page.trim_end_matches('/'))
        .unwrap();
    let mut answer = String::new();
    client.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("<html"), "{answer}");

    // FC 4: GSTATE.
    let mut client = TcpStream::connect(modbus).unwrap();
    client.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 1]).unwrap();
    let mut answer = [0; 11];
    client.read_exact(&mut answer).unwrap();
    assert_eq!(answer[..9], [0, 1, 0, 0, 0, 5, 1, 4, 2]);

    // The cycle repeats.
    assert!(lines.any(|line| line.ends_with("cycle 2 is complete")));
    let pid = Pid::from_child(&demo);
    kill_process(pid, Signal::INT).unwrap();
    let last = lines.last().unwrap();
    assert!(last.ends_with("  ended"), "{last}");
    assert_eq!(demo.wait().unwrap().code(), Some(0));
}

/// A demonstration with a bridge for a Modbus RTU master.
struct Bridged {
    demo: Child,
    lines: Lines<BufReader<ChildStdout>>,
    bus: String,
    service: String,
}

impl Bridged {
    fn start(settings: &Path) -> Self {
        let addresses = ["--page", "localhost:0", "--tcp", "127.0.0.1:0", "--speed-up", "10"];
        let mut demo = Command::new(env!("CARGO_BIN_EXE_wsg"))
            .args(["demo", "--bus", "pty", "--service", "pty", "--settings"])
            .arg(settings)
            .args(addresses)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(demo.stdout.take().unwrap()).lines();
        let mut port = |word: &str| {
            let line = lines.find_map(|line| Some(line.unwrap().strip_prefix(word)?.to_owned())).expect(word);
            line.split_whitespace().next().unwrap().to_owned()
        };
        let (bus, service) = (port("bus "), port("service "));
        Self { demo, lines, bus, service }
    }

    /// Runs `wsg bridge` at the service port.
    fn wsg(&self, words: &str) -> String {
        let words: Vec<&str> = words.split(' ').collect();
        printed(&wsg(&[&["bridge", &self.service], &words[..]].concat(), b""))
    }

    /// Presses Ctrl-C, and returns the changes of the outputs.
    fn end(mut self) -> Vec<String> {
        kill_process(Pid::from_child(&self.demo), Signal::INT).unwrap();
        let lines = self.lines.by_ref();
        let shown = lines.map(|line| line.unwrap().get(8..).unwrap_or_default().to_owned()).collect();
        assert_eq!(self.demo.wait().unwrap().code(), Some(0));
        shown
    }
}

/// Ends the program of a failed test, too.
impl Drop for Bridged {
    fn drop(&mut self) {
        let _ = self.demo.kill();
        let _ = self.demo.wait();
    }
}

/// Issues a command as a PLC does, and returns GSTATE and status at its end.
async fn command(master: &mut Context, flags: u16) -> (u16, u16) {
    for flags in [flags, 0] {
        master.write_multiple_registers(0, &[flags, 2000, 5000, 4000]).await.unwrap().unwrap();
    }
    loop {
        let image = master.read_input_registers(0, 6).await.unwrap().unwrap();
        if image[5] != 26 {
            return (image[0] >> 8, image[5]);
        }
    }
}

#[tokio::test]
async fn modbus_rtu_master_grips_with_demonstration_bridge() {
    let settings = std::env::temp_dir().join(format!("wsg-demo-{}.flash", std::process::id()));
    let bridged = Bridged::start(&settings);
    let port = serial2_tokio::SerialPort::open(&bridged.bus, 19_200).unwrap();
    let mut master = rtu::attach_slave(port, Slave(1));
    // A busy machine is less punctual than a PLC.
    master.write_single_register(101, 60_000).await.unwrap().unwrap();
    assert_eq!(command(&mut master, 0).await, (1, 0), "zeros move nothing: IDLE");
    assert_eq!(command(&mut master, 0x1000).await, (1, 0), "STOP/ACK ends in IDLE");
    assert_eq!(command(&mut master, 0x0800).await, (1, 0), "HOMING ends in IDLE");
    assert_eq!(command(&mut master, 0x0200).await, (1 << 4, 0), "GRIP ends in HOLDING");
    let shown = bridged.wsg("show BUS_TIMEOUT GRIPPER_LINK");
    assert!(shown.contains("60000") && shown.contains("GRIPPER_LINK"), "{shown}");
    let shown = bridged.wsg("save");
    drop(master);
    let outputs = bridged.end();
    assert!(outputs.last().is_some_and(|outputs| outputs.contains("HOLDING")), "{outputs:?}; {shown}");

    let bridged = Bridged::start(&settings);
    let shown = bridged.wsg("show BUS_TIMEOUT SETTINGS_FROM");
    bridged.end();
    std::fs::remove_file(&settings).unwrap();
    assert!(shown.contains("60000"), "{shown}");
}

/// The system holds some 70 KB for a terminal that its reader does not fetch.
#[tokio::test]
async fn master_that_reads_no_answers_does_not_stop_the_bridge() {
    let settings = std::env::temp_dir().join(format!("wsg-demo-{}.unread", std::process::id()));
    let bridged = Bridged::start(&settings);
    let mut bus = OpenOptions::new().write(true).open(&bridged.bus).unwrap();
    let port = serial2_tokio::SerialPort::open(&bridged.service, 115_200).unwrap();
    let mut service = rtu::attach_slave(port, Slave(1));
    // 80 registers from 100 on: an answer of 165 bytes.
    let request = sealed(&[1, 3, 0, 100, 0, 80]);
    for _ in 0..800 {
        bus.write_all(&request).unwrap();
        let answer = timeout(Duration::from_secs(20), service.read_holding_registers(100, 1)).await;
        assert_eq!(answer.expect("the bridge must answer").unwrap().unwrap(), [1]);
    }
    bridged.end();
}

#[test]
fn settings_of_another_kind_are_refused_and_kept() {
    let file = std::env::temp_dir().join(format!("wsg-demo-{}.txt", std::process::id()));
    std::fs::write(&file, "1").unwrap();
    let ports = ["demo", "--page", "localhost:0", "--tcp", "127.0.0.1:0", "--bus", "pty"];
    let output = wsg(&[&ports[..], &["--settings", file.to_str().unwrap()]].concat(), b"");
    let left = std::fs::read_to_string(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    assert_eq!((output.status.code(), left.as_str()), (Some(1), "1"), "{}", printed(&output));
    assert!(printed(&output).contains("is no file with settings"), "{}", printed(&output));
}

#[test]
fn wrong_option_or_address_is_refused_with_a_hint() {
    for (arguments, expected) in [
        (["--tpc", "localhost:0"], "a similar argument exists: '--tcp'"),
        (["--service", "pty"], "--bus <PORT>"),
        (["--tcp", "bench:0"], "expected an address with a port, such as 127.0.0.1:8080 or localhost:0"),
    ] {
        let output = wsg(&[&["demo"], &arguments[..]].concat(), b"");
        assert_eq!(output.status.code(), Some(2));
        assert!(printed(&output).contains(expected), "{}", printed(&output));
    }
}

#[test]
fn demo_names_an_address_in_use() {
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap().to_string();
    let output = wsg(&[&["demo"], &FREE[2..], &["--page", &address]].concat(), b"");
    let shown = printed(&output);
    assert_eq!(output.status.code(), Some(1), "{shown}");
    assert!(shown.lines().count() == 1 && shown.contains(&address) && shown.contains("--page"), "{shown}");
}
