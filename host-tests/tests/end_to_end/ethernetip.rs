//! Third-party scanners and clients of EtherNet/IP, each at `wsg-sim --ethernetip` and through `wsg gateway`: `ethernetip`,
//! `cm-ethernetip`, `pycomm3` and `cpppo` (PyPI), and `st-ethernet-ip` (npm), with `tshark` as a monitor.
//!
//! `cargo xtask test` selects the tests by the programs in their names, and skips missing ones: `pypi_ethernetip`, `cm_ethernetip`,
//! `st_ethernet_ip`, `pycomm3`, `cpppo`, `tshark`.

use crate::profinet::{Capture, SUSPICIOUS};
use host_tests::example;
use host_tests::gateway::{Gateway, unpaused};
use host_tests::masters::{node, printed, python, python_of};
use std::fmt::Write;
use std::net::TcpStream;
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, PoisonError};
use std::thread::sleep;
use std::time::{Duration, Instant};
use wsg_fieldbus::{CommandFlags, GripperFlags, OutputImage};
use wsg_protocol::types::SystemFlags;
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

/// The adapter's address. The scanners have 127.0.0.1.
const ADDRESS: &str = "127.0.0.2";

/// Held by the running test: cyclic data has a fixed port.
static PORTS: Mutex<()> = Mutex::new(());

/// A step of a grip cycle: command flags, width and speed; GSTATE and status code if they count, flags of SYSSTATE that must be 1
/// and 0, and the width of the inputs if it counts.
struct Step(CommandFlags, [u16; 2], Option<(GripperFlags, u16)>, [SystemFlags; 2], Option<u16>);

/// Each flag rises once, except that of MOVE, so no step depends on a PLC's cycle. FAST STOP also acts in the first outputs.
fn steps() -> Vec<String> {
    let (none, fast_stop, referenced) =
        (SystemFlags::empty(), SystemFlags::FAST_STOP, SystemFlags::REFERENCED);
    let idle = Some((GripperFlags::IDLE, 0));
    let refused = Some((GripperFlags::ERROR, 3));
    let steps = [
        Step(CommandFlags::empty(), [0, 0], idle, [none, none], None),
        Step(CommandFlags::FASTSTOP, [0, 0], None, [fast_stop, none], None),
        Step(CommandFlags::STOP_ACK, [0, 0], idle, [none, fast_stop], None),
        Step(CommandFlags::MOVE, [5000, 10_000], refused, [none, referenced], None),
        Step(CommandFlags::HOMING, [0, 0], idle, [referenced, none], None),
        Step(CommandFlags::GRIP, [2000, 10_000], Some((GripperFlags::HOLDING, 0)), [none, none], Some(1960)),
        Step(CommandFlags::RELEASE, [4000, 10_000], idle, [none, fast_stop], Some(4000)),
        // 500 mm/s is too fast.
        Step(CommandFlags::MOVE, [4000, 50_000], None, [fast_stop, none], None),
    ];
    steps.iter().map(Step::text).collect()
}

impl Step {
    /// Returns outputs, mask and inputs in hex.
    fn text(&self) -> String {
        let Self(flags, [width, speed], state, [ones, zeros], expected_width) = *self;
        let outputs = OutputImage { flags, user: 0, width: width as i16, speed, force_limit: 4000 };
        let (mut mask, mut inputs) = ([0; 12], [0; 12]);
        let mut set = |at: usize, bits: &[u8], value: &[u8]| {
            mask[at..][..bits.len()].copy_from_slice(bits);
            inputs[at..][..value.len()].copy_from_slice(value);
        };
        if let Some((state, code)) = state {
            set(0, &[0xFF], &[state.bits()]);
            set(10, &[0xFF; 2], &code.to_be_bytes());
        }
        // SYSSTATE begins with the byte that holds D0 to D7.
        set(2, &(ones | zeros).bits().to_le_bytes(), &ones.bits().to_le_bytes());
        if let Some(width) = expected_width {
            set(6, &[0xFF; 2], &width.to_be_bytes());
        }
        let mut text = String::new();
        for (at, image) in [&outputs.to_bytes()[..], &mask, &inputs].into_iter().enumerate() {
            text.push_str(if at == 0 { "" } else { " " });
            image.iter().for_each(|byte| write!(text, "{byte:02x}").unwrap());
        }
        text
    }
}

/// A running `wsg-sim`, which is killed on drop.
struct Gripper(Child);

impl Gripper {
    fn start() -> Self {
        let arguments = ["--part", "20", "--time-scale", "10", "--ethernetip", ADDRESS];
        let mut command = Command::new(example::program("wsg-sim"));
        Self(command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Gripper {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Waits until the adapter listens.
fn await_adapter() {
    let end = Instant::now() + Duration::from_secs(60);
    while TcpStream::connect((ADDRESS, bus_ethernetip::PORT)).is_err() {
        assert!(Instant::now() < end, "no adapter listens");
        sleep(Duration::from_millis(10));
    }
}

/// Runs a test at a virtual gripper, and through a gateway to another one.
fn at_gripper_and_gateway(test: impl Fn()) {
    let _ports = PORTS.lock().unwrap_or_else(PoisonError::into_inner);
    {
        let _gripper = Gripper::start();
        await_adapter();
        test();
    }
    println!("through a gateway:");
    let start = || {
        let config = Config { part: Part::of_width(20.0), time_scale: 10.0, ..Config::default() };
        let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
        let served = ServerThread::start(config, &lines, None).unwrap();
        let gateway = Gateway::start(served.tcp_address().unwrap(), &["--ethernetip", ADDRESS]);
        (served, gateway)
    };
    unpaused(
        start,
        |(_, gateway)| gateway,
        |_, _| false,
        |_| {
            await_adapter();
            test();
        },
    );
}

#[track_caller]
fn assert_prints(output: &Output, end: &str) {
    assert!(output.status.success() && printed(output).contains(end), "{}", printed(output));
}

/// Runs the grip cycle with a scanner.
#[track_caller]
fn run_cycle(scanner: impl Fn(&[&str]) -> Output) {
    let steps = steps();
    let steps: Vec<_> = steps.iter().map(String::as_str).collect();
    at_gripper_and_gateway(|| assert_prints(&scanner(&steps), "cycle done"));
}

const CYCLE: &str = include_str!("ethernetip/cycle.py");

#[test]
#[ignore = "needs ethernetip: see the top of this file"]
fn pypi_ethernetip_runs_a_grip_cycle() {
    let script = [CYCLE, include_str!("ethernetip/pypi_ethernetip.py")].concat();
    run_cycle(|steps| python(&script, steps));
}

#[test]
#[ignore = "needs cm-ethernetip: see the top of this file"]
fn cm_ethernetip_runs_a_grip_cycle() {
    let script = [CYCLE, include_str!("ethernetip/cm_ethernetip.py")].concat();
    run_cycle(|steps| python_of("cm-ethernetip", &script, steps));
}

#[test]
#[ignore = "needs st-ethernet-ip: see the top of this file"]
fn st_ethernet_ip_runs_a_grip_cycle() {
    run_cycle(|steps| node(include_str!("ethernetip/st_ethernet_ip.js"), steps));
}

#[test]
#[ignore = "needs pycomm3: see the top of this file"]
fn pycomm3_identifies_and_reads() {
    at_gripper_and_gateway(|| {
        assert_prints(&python(include_str!("ethernetip/pycomm3.py"), &[]), "passed");
    });
}

#[test]
#[ignore = "needs cpppo: see the top of this file"]
fn cpppo_identifies_and_reads() {
    at_gripper_and_gateway(|| assert_prints(&python(include_str!("ethernetip/cpppo.py"), &[]), "passed"));
}

#[test]
#[ignore = "needs ethernetip, st-ethernet-ip, pycomm3, tshark and root: run `cargo xtask test`"]
fn tshark_has_no_warning_about_pypi_ethernetip_st_ethernet_ip_and_pycomm3() {
    let _ports = PORTS.lock().unwrap_or_else(PoisonError::into_inner);
    let filter = format!("host {ADDRESS} and (port 44818 or port 2222)");
    let mut tshark = Command::new("tshark");
    tshark.args(["-i", "lo", "-f", &filter]);
    let file = std::env::temp_dir().join(format!("ethernetip-{}.pcap", std::process::id()));
    let mut capture = Capture::start(tshark, file);
    let _gripper = Gripper::start();
    await_adapter();
    let steps = steps();
    let steps: Vec<_> = steps.iter().map(String::as_str).collect();
    // st-ethernet-ip last, because it never closes its connection; pycomm3 first, because it expects no outputs.
    assert_prints(&python(include_str!("ethernetip/pycomm3.py"), &[]), "passed");
    assert_prints(&python(include_str!("ethernetip/multicast.py"), &[]), "passed");
    assert_prints(&node(include_str!("ethernetip/st_ethernet_ip.js"), &steps), "cycle done");
    capture.wait_for(10, "cip.service == 0x8e", &["frame.number"]);
    capture.end();
    // It decodes the cyclic data of both directions, and of the group.
    let directions =
        ["ip.dst == 127.0.0.1 && udp.srcport == 2222", "ip.dst == 127.0.0.2", "ip.dst == 239.192.1.32"];
    for filter in directions.map(|filter| format!("{filter} && cipio")) {
        assert!(capture.packets(&filter, &["frame.number"]).len() > steps.len(), "{filter}");
    }
    let warnings = capture.packets(SUSPICIOUS, &["frame.number", "frame.protocols", "_ws.expert.message"]);
    assert_eq!(warnings, Vec::<String>::new());
}
