//! Third-party scanners and clients of EtherNet/IP, each at `wsg-sim --ethernetip` and through `wsg gateway`: `ethernetip`,
//! `cm-ethernetip`, `pycomm3` and `cpppo` (PyPI), `st-ethernet-ip` (npm) and `rseip`, with `tshark` as a monitor; and ten owners of
//! ten grippers.
//!
//! `cargo xtask test` selects the tests by the programs in their names, and skips missing ones: `pypi_ethernetip`, `cm_ethernetip`,
//! `st_ethernet_ip`, `pycomm3`, `cpppo`, `tshark`.

use crate::modbus_tcp::{BOUND, serve, through_gateway};
use crate::profinet::{Capture, SUSPICIOUS};
use host_tests::ethernetip::{Scanner, own_address, until};
use host_tests::example::{self, Process};
use host_tests::gateway::{Gateway, unpaused};
use host_tests::masters::{node, printed, python, python_of};
use rseip::cip::epath::EPath;
use rseip::cip::identity::IdentityObject;
use rseip::cip::service::{CommonServices, MessageService};
use rseip::client::{EipClient, EipDiscovery};
use rseip::futures_util::StreamExt;
use std::array;
use std::fmt::Write;
use std::net::{Ipv4Addr, SocketAddrV4, TcpStream};
use std::pin::pin;
use std::process::{Command, Output, Stdio};
use std::sync::{Mutex, PoisonError};
use tokio::time::timeout;
use wsg_fieldbus::{CommandFlags, GripperFlags, OutputImage};
use wsg_protocol::Status;
use wsg_protocol::types::SystemFlags;
use wsg_sim::server::{EthernetIpLine, Lines, ServerThread};

/// The adapter's address in the scripts. The scanners have 127.0.0.1.
const ADDRESS: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 2);

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

/// Starts a gripper, which accepts scanners when this returns.
fn start_gripper(address: Ipv4Addr) -> Process {
    let arguments = ["--part", "20", "--time-scale", "10", "--ethernetip", &address.to_string()];
    let mut command = Command::new(example::program("wsg-sim"));
    let gripper = command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).spawn().map(Process);
    until("the adapter listens", || TcpStream::connect((address, bus_ethernetip::PORT)).is_ok());
    gripper.unwrap()
}

/// Runs a test at a virtual gripper with this address, and through a gateway with it to another gripper.
fn at_gripper_and_gateway(address: Ipv4Addr, test: impl Fn()) {
    let _ports = PORTS.lock().unwrap_or_else(PoisonError::into_inner);
    {
        let _gripper = start_gripper(address);
        test();
    }
    through_gateway(&["--ethernetip", &address.to_string()], |_| test());
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
    at_gripper_and_gateway(ADDRESS, || assert_prints(&scanner(&steps), "cycle done"));
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
    let script = include_str!("ethernetip/pycomm3.py");
    at_gripper_and_gateway(ADDRESS, || assert_prints(&python(script, &[]), "passed"));
}

#[test]
#[ignore = "needs cpppo: see the top of this file"]
fn cpppo_identifies_and_reads() {
    let script = include_str!("ethernetip/cpppo.py");
    at_gripper_and_gateway(ADDRESS, || assert_prints(&python(script, &[]), "passed"));
}

#[test]
fn rseip_identifies_and_reads() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let address = own_address();
    at_gripper_and_gateway(address, || {
        let read = runtime.block_on(async { timeout(BOUND, read_with_rseip(address)).await });
        read.expect("the steps end within the time limit").unwrap();
    });
}

/// Identifies a gripper and reads it. `rseip` wraps each request in an Unconnected_Send.
async fn read_with_rseip(address: Ipv4Addr) -> rseip::Result<()> {
    let discovery = EipDiscovery::new(Ipv4Addr::LOCALHOST).broadcast(address).forever();
    let mut devices = pin!(discovery.run::<IdentityObject<'static>>().await?);
    let (identity, from) = devices.next().await.unwrap();
    assert_eq!((&identity.product_name[..], identity.product_code), ("WSG", 1));
    assert_eq!(from, (address, bus_ethernetip::PORT).into());

    let path = |[class, instance, attribute]: [u16; 3]| {
        EPath::new().with_class(class).with_instance(instance).with_attribute(attribute)
    };
    let mut client = EipClient::new_host_lookup(address.to_string()).await?;
    let name: Vec<u8> = client.get_attribute_single(path([1, 1, 7])).await?;
    assert_eq!(name, b"\x03WSG");
    let inputs: Vec<u8> = client.get_attribute_single(path([4, 100, 3])).await?;
    assert_eq!((inputs.len(), inputs[0]), (12, GripperFlags::IDLE.bits()));
    let width: u16 = client.get_attribute_single(path([0x64, 4, 3])).await?;
    assert_eq!(width.to_be_bytes(), inputs[6..8]);
    let refused = client.get_attribute_single::<u16>(path([0x64, 4, 999])).await;
    assert!(refused.unwrap_err().to_string().contains("CIP general status: 20"), "no such register");
    // No explicit message sets outputs.
    let refused = client.set_attribute_single(path([4, 150, 3]), [0xFF_u8; 8]).await;
    assert!(refused.unwrap_err().to_string().contains("CIP general status: 14"), "outputs are read only");
    let outputs: Vec<u8> = client.get_attribute_single(path([4, 150, 3])).await?;
    assert_eq!(outputs, [0; 8]);
    client.close().await
}

#[test]
fn ten_owners_in_one_process_command_their_own_grippers() {
    let adapters: [_; 10] = array::from_fn(|_| own_address());
    {
        let line = |ip| EthernetIpLine {
            address: SocketAddrV4::new(ip, bus_ethernetip::PORT),
            vendor: EthernetIpLine::VENDOR,
        };
        let grippers = adapters.map(|ip| serve(Lines { ethernetip: Some(line(ip)), ..Lines::default() }));
        command_own_grippers(&adapters, &grippers);
    }
    println!("through a gateway:");
    let start = || {
        let grippers = adapters.map(|_| serve(Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() }));
        let mut config = String::new();
        for (ip, gripper) in adapters.iter().zip(&grippers) {
            let gripper = gripper.tcp_address().unwrap();
            // A busy machine is less punctual than a PLC.
            writeln!(
                config,
                "[[gripper]]\ngripper = \"tcp://{gripper}\"\nmodbus = \"127.0.0.1:0\"\nethernetip = \"{ip}\"\n\
                 [gripper.delivered]\nBUS_TIMEOUT = 60000"
            )
            .unwrap();
        }
        (grippers, Gateway::of_config(&config, adapters.len()))
    };
    unpaused(
        start,
        |(_, gateway)| gateway,
        |_, _| false,
        |(grippers, _)| command_own_grippers(&adapters, grippers),
    );
}

/// Moves each gripper to a width of its own with an owner of its own, at the same time. FASTSTOP of one owner stops its gripper only.
fn command_own_grippers(adapters: &[Ipv4Addr], grippers: &[ServerThread]) {
    let owners: Vec<_> = adapters.iter().map(|ip| Scanner::start(*ip, OutputImage::ZERO)).collect();
    let inputs = |owner: &Scanner| owner.read(BOUND).expect("inputs arrive");
    until("the grippers are connected", || {
        owners.iter().all(|owner| inputs(owner).status != Status::IoError)
    });
    let write = |at: usize, flags, width, speed| {
        let outputs = OutputImage { flags, user: 0, width, speed, force_limit: 40_00 };
        assert!(owners[at].write(outputs, BOUND), "{flags:?} arrives at gripper {at}");
    };
    let command = |flags, width: &dyn Fn(usize) -> i16, speed| {
        for flags in [CommandFlags::empty(), flags] {
            (0..owners.len()).for_each(|at| write(at, flags, width(at), speed));
        }
    };
    let has = |at: usize, flag| grippers[at].state().flags.contains(flag);
    let is_at = |at: usize, width: i16| {
        (grippers[at].state().width - f32::from(width) / 100.0).abs() < 0.01
            && inputs(&owners[at]).width == width
    };

    let near = |at: usize| 25_00 + 5_00 * at as i16;
    let far = |at: usize| 105_00 - near(at) / 10;
    command(CommandFlags::HOMING, &near, 100_00);
    until("the fingers are referenced", || {
        (0..owners.len())
            .all(|at| has(at, SystemFlags::REFERENCED) && inputs(&owners[at]).status == Status::Success)
    });
    command(CommandFlags::MOVE, &near, 400_00);
    until("the fingers have moved", || (0..owners.len()).all(|at| is_at(at, near(at))));
    command(CommandFlags::MOVE, &far, 5_00);
    let last = owners.len() - 1;
    write(last, CommandFlags::FASTSTOP, far(last), 5_00);
    until("the last gripper stops", || has(last, SystemFlags::FAST_STOP));
    until("the others continue", || (0..last).all(|at| is_at(at, far(at))));
    for at in 0..owners.len() {
        assert_eq!(has(at, SystemFlags::FAST_STOP), at == last, "gripper {at}");
    }
}

#[test]
#[ignore = "needs ethernetip, st-ethernet-ip, pycomm3, tshark and root: run `cargo xtask test`"]
fn tshark_has_no_warning_about_pypi_ethernetip_st_ethernet_ip_and_pycomm3() {
    let _ports = PORTS.lock().unwrap_or_else(PoisonError::into_inner);
    let filter = format!("host {ADDRESS} and (port 44818 or port 2222)");
    let mut tshark = Command::new("tshark");
    tshark.args(["-i", "lo", "-f", &filter]);
    let file = std::env::temp_dir().join(format!("ethernetip-{}.pcap", std::process::id()));
    // Before the capture, because it refuses connections until it listens.
    let _gripper = start_gripper(ADDRESS);
    let mut capture = Capture::start(tshark, file);
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
