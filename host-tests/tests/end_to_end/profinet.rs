//! The virtual gripper and `wsg gateway` on PROFINET, in network namespaces connected by a virtual cable, with third-party controllers,
//! with `tshark` as a monitor, and with hostile frames.
//!
//! Long tests run only in `cargo xtask ci` (`WSG_WHOLE`). All tests require root. `cargo xtask test` selects them by the programs
//! in their names and skips missing ones: `profinet_py`, `pnio_dcp`, `scapy`, `tshark`, `in_namespaces`.

use bus_profinet::Stored;
use host_tests::example::{self, Process};
use host_tests::extent;
use host_tests::masters::{PYTHON_VARIABLE, printed};
use host_tests::namespaces::{self, End, at_controller, prioritize, prioritize_grippers};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use wsg_sim::server::{Lines, ProfinetLine, ServerThread};
use wsg_sim::{Config, Part};

const CONTROLLER: &str = include_str!("profinet/profinet_py.py");
const DCP: &str = include_str!("profinet/pnio_dcp.py");
const EPM: &str = include_str!("profinet/epm.py");
const HOSTILE: &str = include_str!("profinet/hostile.py");

/// Connected namespaces, and what the tests run in them.
struct Network(namespaces::Network);

impl Network {
    fn new() -> Self {
        Self(namespaces::Network::new())
    }

    /// Starts a gripper with default settings in its namespace.
    fn serve(&self, config: Config) -> ServerThread {
        self.serve_as(config, Stored::NONE)
    }

    /// Like `serve`, but with a stored name or address.
    fn serve_as(&self, config: Config, stored: Stored) -> ServerThread {
        let line = ProfinetLine { interface: "eth0".to_owned(), stored, keep: None };
        let control = "127.0.0.1:0".parse().ok();
        let lines = Lines { profinet: Some(line), control, ..Lines::default() };
        let server = self.0.at(End::Gripper, || ServerThread::start(config, &lines, None).unwrap());
        prioritize_grippers();
        server
    }

    /// Waits until `/state` of a gripper shows these outputs.
    fn await_outputs(&self, server: &ServerThread, expected: &str) {
        let (address, expected) = (server.control_address().unwrap(), format!("\"output\":{expected}"));
        self.0.at(End::Gripper, || {
            let end = Instant::now() + Duration::from_secs(60);
            loop {
                let mut stream = TcpStream::connect(address).unwrap();
                stream.write_all(b"GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
                let mut answer = String::new();
                stream.read_to_string(&mut answer).unwrap();
                if answer.contains(&expected) {
                    return;
                }
                assert!(Instant::now() < end, "{answer}");
            }
        });
    }

    /// Starts `wsg gateway` for a gripper on TCP.
    fn serve_gateway(&self, config: Config, options: &[&str]) -> (Process, ServerThread) {
        let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
        let server = self.0.at(End::Gripper, || ServerThread::start(config, &lines, None).unwrap());
        let address = format!("tcp://{}", server.tcp_address().unwrap());
        let arguments = [&["gateway", "--gripper", &address, "--profinet", "eth0"], options].concat();
        let program = self.start("wsg", &arguments);
        prioritize(&program.0.id().to_string());
        prioritize_grippers();
        (program, server)
    }

    /// Starts a program and waits until it serves PROFINET.
    fn start(&self, program: &str, arguments: &[&str]) -> Process {
        let mut program = self.command(program, arguments);
        let mut child =
            program.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        let program = Process(child);
        assert!(lines.any(|line| line == "profinet eth0"), "it ended before it served PROFINET");
        // Drain the remaining output, so that the program never blocks on it.
        thread::spawn(move || lines.for_each(drop));
        program
    }

    /// Returns a command for a program of the workspace in the gripper's namespace.
    fn command(&self, program: &str, arguments: &[&str]) -> Command {
        let mut ip = Command::new("ip");
        let namespace = self.0.namespace(End::Gripper);
        ip.args(["netns", "exec", &namespace]).arg(example::program(program)).args(arguments);
        ip
    }

    fn python(&self, script: &str, arguments: &[&str]) -> Output {
        let Some(python) = std::env::var(PYTHON_VARIABLE).ok() else {
            panic!("{PYTHON_VARIABLE} is not set: run `cargo xtask test`");
        };
        at_controller(self.0.number(), &python).args(["-c", script]).args(arguments).output().unwrap()
    }

    /// Starts to capture all packets to a file.
    fn capture(&self) -> Capture {
        let file = std::env::temp_dir().join(format!("{}.pcap", self.0.namespace(End::Controller)));
        let mut tshark = at_controller(self.0.number(), "tshark");
        tshark.args(["-i", "eth0"]);
        Capture::start(tshark, file)
    }
}

/// A running capture to a file.
pub(crate) struct Capture {
    child: Child,
    file: PathBuf,
}

impl Capture {
    /// Starts a capture with the interface of this `tshark`.
    pub(crate) fn start(mut tshark: Command, file: PathBuf) -> Self {
        tshark.args(["-F", "pcap", "-w"]).arg(&file);
        let mut child = tshark.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        // tshark names the interface before the capture starts.
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let begun = lines.by_ref().map(Result::unwrap).any(|line| line.ends_with("Capture started."));
        assert!(begun, "tshark ended before it started the capture");
        thread::spawn(move || lines.for_each(drop));
        Self { child, file }
    }

    /// Ends the capture, and returns the fields of the packets that match the filter.
    fn finish(mut self, filter: &str, fields: &[&str]) -> Vec<String> {
        self.end();
        self.packets(filter, fields)
    }

    /// Waits until `count` packets match the filter, and returns their fields. The capture lags the traffic.
    pub(crate) fn wait_for(&self, count: usize, filter: &str, fields: &[&str]) -> Vec<String> {
        let end = Instant::now() + Duration::from_secs(60);
        loop {
            let packets = self.packets(filter, fields);
            if packets.len() >= count {
                return packets;
            }
            assert!(Instant::now() < end, "{packets:?}");
            thread::sleep(Duration::from_millis(100));
        }
    }

    /// Returns the fields of the packets captured so far that match the filter.
    pub(crate) fn packets(&self, filter: &str, fields: &[&str]) -> Vec<String> {
        let mut tshark = Command::new("tshark");
        tshark.args(["-n", "-r"]).arg(&self.file).args(["-Y", filter, "-T", "fields"]);
        tshark.args(fields.iter().flat_map(|field| ["-e", field]));
        let output = tshark.output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        // The last packet of a capture that still runs can be incomplete.
        assert!(output.status.success() || errors.contains("cut short"), "{errors}");
        String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect()
    }

    pub(crate) fn end(&mut self) {
        let pid = rustix::process::Pid::from_child(&self.child);
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        let _ = self.child.wait();
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        self.end();
        let _ = fs::remove_file(&self.file);
    }
}

fn config() -> Config {
    Config { part: Part::of_width(20.0), time_scale: 5.0, serial_number: 4_711, ..Config::default() }
}

/// Matches malformed packets and packets with a warning.
///
/// TCP segments that the kernel repeats are no fault of a peer: it repeats them when the machine pauses.
pub(crate) const SUSPICIOUS: &str = "(_ws.malformed || _ws.expert.severity >= \"Warning\") \
    && !tcp.analysis.flags && !tcp.options.sack.dsack";

#[test]
#[ignore = "needs profinet-py, tshark and root: run `cargo xtask test`"]
fn profinet_py_grip_cycle_in_namespaces_has_no_fault_for_tshark() {
    let network = Network::new();
    let capture = network.capture();
    let server = network.serve(config());
    let output = network.python(CONTROLLER, &["cycle"]);
    assert!(output.status.success(), "{}", printed(&output));
    // The last outputs had a width and a speed. They are cleared after the controller has disconnected.
    network.await_outputs(&server, "[0,0,0,0,0,0,0,0]");
    let warnings = capture.finish(SUSPICIOUS, &["frame.number", "frame.protocols", "_ws.expert.message"]);
    assert_eq!(warnings, Vec::<String>::new());
}

/// Runs the controller with these arguments on a gripper of its own. The controller checks the behaviour.
fn passes(config: Config, arguments: &[&str]) {
    let network = Network::new();
    let _server = network.serve(config);
    let output = network.python(CONTROLLER, arguments);
    assert!(output.status.success(), "{}", printed(&output));
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn cut_cable_in_namespaces_stops_motion_and_profinet_py_returns() {
    if extent::is_whole() {
        passes(Config { time_scale: 1.0, ..config() }, &["cut"]);
    }
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn motion_stops_when_profinet_py_is_killed_in_namespaces() {
    passes(Config { time_scale: 1.0, ..config() }, &["killed"]);
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn only_new_valid_profinet_py_flags_in_namespaces_cause_motion() {
    if extent::is_whole() {
        passes(Config { time_scale: 1.0, ..config() }, &["unasked"]);
    }
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn profinet_py_at_8_ms_in_namespaces_misses_at_most_1_in_1000() {
    if extent::is_whole() {
        passes(config(), &["soak", "60"]);
    }
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn profinet_py_in_namespaces_finds_its_writes_after_a_restart() {
    let network = Network::new();
    let file = std::env::temp_dir().join(format!("{}.toml", network.0.namespace(End::Gripper)));
    fs::write(&file, "# Cell 7\nprofinet = \"eth0\"\ntime-scale = 5\n").unwrap();
    // The program is killed each time, so each write must be stored immediately.
    for part in ["label", "labelled"] {
        let _program = network.start("wsg-sim", &["--config", file.to_str().unwrap()]);
        let output = network.python(CONTROLLER, &[part]);
        assert!(output.status.success(), "{}", printed(&output));
    }
    let kept = fs::read_to_string(&file).unwrap();
    fs::remove_file(&file).unwrap();
    assert!(kept.starts_with("# Cell 7\nprofinet = \"eth0\"\ntime-scale = 5\n"), "{kept}");
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn profinet_py_in_namespaces_finds_its_writes_after_a_restart_of_a_gateway() {
    let network = Network::new();
    let file = std::env::temp_dir().join(network.0.namespace(End::Gripper));
    let kept = file.with_extension("profinet");
    for part in ["label", "labelled"] {
        let _gateway = network.serve_gateway(config(), &["--settings", file.to_str().unwrap()]);
        let output = network.python(CONTROLLER, &[part]);
        assert!(output.status.success(), "{}", printed(&output));
        // A thread stores the last write, so that no disk holds the bridges.
        let bound = Instant::now() + Duration::from_secs(60);
        while !fs::read_to_string(&kept).is_ok_and(|kept| kept.contains("links")) {
            assert!(Instant::now() < bound, "the write was not stored");
            thread::yield_now();
        }
    }
    fs::remove_file(kept).unwrap();
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn motion_of_profinet_py_through_a_gateway_stops_when_the_cable_is_cut_in_namespaces() {
    let network = Network::new();
    let modbus = ["--modbus", "127.0.0.1:1502"];
    let _gateway = network.serve_gateway(Config { time_scale: 1.0, ..config() }, &modbus);
    // Only the watchdog of PROFINET ends the motion.
    let set = ["bridge", "tcp://127.0.0.1:1502", "set", "BUS_TIMEOUT", "0"];
    assert!(network.command("wsg", &set).stdout(Stdio::null()).status().unwrap().success());
    let output = network.python(CONTROLLER, &["cut"]);
    assert!(output.status.success(), "{}", printed(&output));
}

#[test]
#[ignore = "needs profinet-py and root: run `cargo xtask test`"]
fn profinet_py_connects_again_in_namespaces_after_a_pause_of_a_gateway() {
    let network = Network::new();
    let (gateway, _server) = network.serve_gateway(config(), &[]);
    let output = network.python(CONTROLLER, &["paused", &gateway.0.id().to_string()]);
    assert!(output.status.success(), "{}", printed(&output));
}

#[test]
#[ignore = "needs tshark and root: run `cargo xtask test`"]
fn endpoint_mapper_in_namespaces_describes_the_device_to_tshark() {
    let stored = Stored { ip: ProfinetLine::ip_of_text("192.168.7.5/24").unwrap(), ..Stored::NONE };
    let network = Network::new();
    let capture = network.capture();
    let _server = network.serve_as(config(), stored);
    let output = network.python(EPM, &[]);
    assert!(output.status.success(), "{}", printed(&output));
    let entries = capture.wait_for(
        2,
        "epm.num_ents == 1",
        &["epm.proto.udp_port", "epm.proto.ip", "epm.tower.num_floors", "epm.rc"],
    );
    assert_eq!(entries, ["34964\t192.168.7.5\t5\t0x00000000"; 2]);
    // The last answer returns a released handle.
    capture.wait_for(2, "epm.opnum == 4 && dcerpc.pkt_type == 2", &["frame.number"]);
    let warnings = capture.finish(SUSPICIOUS, &["frame.number", "frame.protocols", "_ws.expert.message"]);
    assert_eq!(warnings, Vec::<String>::new());
}

#[test]
#[ignore = "needs pnio-dcp and root: run `cargo xtask test`"]
fn pnio_dcp_finds_names_addresses_and_resets_in_namespaces() {
    let network = Network::new();
    let _server = network.serve(config());
    let output = network.python(DCP, &[]);
    assert!(output.status.success(), "{}", printed(&output));
}

#[test]
#[ignore = "needs scapy, profinet-py, tshark and root: run `cargo xtask test`"]
fn scapy_in_namespaces_harms_nothing_for_profinet_py_and_tshark() {
    if !extent::is_whole() {
        return;
    }
    let network = Network::new();
    let mut capture = network.capture();
    let server = network.serve(config());
    let output = network.python(CONTROLLER, &["cycle"]);
    assert!(output.status.success(), "{}", printed(&output));
    capture.end();
    let file = capture.file.to_str().unwrap().to_owned();
    let output = network.python(HOSTILE, &[&file, "1", "20000"]);
    assert!(output.status.success(), "{}", printed(&output));
    // The device is unchanged, except for a name and an address that the frames may have set.
    let output = network.python(CONTROLLER, &["unmoved"]);
    assert!(output.status.success(), "{}", printed(&output));
    server.stop().unwrap();
}
