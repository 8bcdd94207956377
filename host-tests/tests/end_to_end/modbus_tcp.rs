//! Third-party masters over Modbus/TCP at the virtual gripper and at a gateway: `mbpoll` (Debian), `pymodbus` and `modbus-tk`
//! (PyPI), `jsmodbus` (npm) and `tokio-modbus`, and the example `gripping_cycle`, which uses the last. `minimalmodbus` supports
//! only RTU.
//!
//! Tests with `mbpoll`, `pymodbus`, `modbus_tk` or `jsmodbus` in their names require that program. `cargo xtask test` runs them
//! if it finds or can install the program, and prints NOT CHECKED otherwise.

use document::read;
use host_tests::example;
use host_tests::gateway::Gateway;
use host_tests::masters::{mbpoll, node, paste, printed, python};
use std::net::SocketAddr;
use std::process::{Command, Output};
use std::time::{Duration, Instant};
use tokio::time::timeout;
use tokio_modbus::client::{Context, tcp};
use tokio_modbus::prelude::{ExceptionCode, ReadCode, Reader, Slave, Writer};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(60);

/// Starts a gripper with a part of 20 mm and returns its Modbus/TCP address.
fn gripper() -> (ServerThread, SocketAddr) {
    let config = Config { part: Part::of_width(20.0), time_scale: 10.0, ..Config::default() };
    let lines = Lines { modbus: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let served = ServerThread::start(config, &lines, None).unwrap();
    let address = served.modbus_address().unwrap();
    (served, address)
}

/// The common part of all Python masters: home, grip, release, and a refused motion. It requires `read(address, count)`,
/// `inputs(address, count)`, `write(address, values)` and `coil(address, value)`.
const CYCLE: &str = r#"
import time

def wait(done):
    end = time.time() + 60
    while time.time() < end:
        image = inputs(0, 6)
        if done(image):
            return image
    raise SystemExit("time-out; input image %r" % (image,))

def command(flags, width=0, speed=0, force=0):
    write(0, [0, width, speed, force])
    write(0, [flags << 8, width, speed, force])
    image = wait(lambda image: image[5] != 26)           # not E_CMD_PENDING
    write(0, [0, width, speed, force])
    return image

image = command(1 << 0, 5000, 10000, 4000)               # MOVE
assert (image[0], image[5]) == (0x8000, 3), image        # ERROR, E_NOT_INITIALIZED
image = command(1 << 4)                                  # STOP/ACK
assert (image[0], image[5]) == (0x0100, 0), image
image = command(1 << 3)                                  # HOMING
assert (image[0], image[5]) == (0x0100, 0), image        # IDLE, E_SUCCESS
assert image[1] & 0x0100, image                          # REFERENCED
image = command(1 << 1, 2000, 10000, 4000)               # GRIP
assert (image[0], image[3:]) == (0x1000, [1960, 4000, 0]), image
assert read(0, 4) == [0, 2000, 10000, 4000], read(0, 4)
write(0, [0, 4000, 10000, 4000])
coil(2, True)                                            # RELEASE
image = wait(lambda image: image[5] != 26)
coil(2, False)
assert (image[0], image[3:]) == (0x0100, [4000, 0, 0]), image
write(0, [0x0100, 4000, 50000, 4000])                    # MOVE at 500 mm/s
assert inputs(1, 1)[0] & 0x0010, "FAST STOP"
print("cycle done")
"#;

#[track_caller]
fn assert_done(output: &Output) {
    assert!(output.status.success() && printed(output).contains("cycle done"), "{}", printed(output));
}

#[test]
#[ignore = "needs pymodbus: see the top of this file"]
fn pymodbus_runs_a_grip_cycle_over_tcp() {
    let (_served, address) = gripper();
    let head = r#"
import sys
from pymodbus.client import ModbusTcpClient
client = ModbusTcpClient("127.0.0.1", port=int(sys.argv[1]), timeout=5, retries=0)
assert client.connect()

def checked(answer):
    assert not answer.isError(), answer
    return answer

def read(address, count):
    return checked(client.read_holding_registers(address, count=count, device_id=1)).registers

def inputs(address, count):
    return checked(client.read_input_registers(address, count=count, device_id=255)).registers

def write(address, values):
    checked(client.write_registers(address, values, device_id=0))

def coil(address, value):
    checked(client.write_coil(address, value, device_id=1))
"#;
    let tail = r#"
answer = client.read_holding_registers(4, count=1, device_id=1)
assert answer.isError() and answer.exception_code == 2, answer
answer = client.readwrite_registers(read_address=0, read_count=4, write_address=1, values=[4001], device_id=1)
assert checked(answer).registers == [0x0100, 4001, 50000, 4000], answer
checked(client.mask_write_register(address=1, and_mask=0xF0F0, or_mask=0x0101, device_id=1))
assert read(1, 1) == [(4001 & 0xF0F0) | (0x0101 & ~0xF0F0 & 0xFFFF)], read(1, 1)
assert checked(client.read_coils(0, count=16, device_id=1)).bits == [True] + [False] * 15
assert checked(client.read_discrete_inputs(28, count=1, device_id=1)).bits[0] is True, "FAST STOP"
identity = checked(client.read_device_information(read_code=1, object_id=0, device_id=1)).information
assert identity[0] == b"wsg-sim", identity
answer = client.diag_query_data(b"\x12\x34", device_id=1)
assert answer.isError() and answer.exception_code == 1, "Diagnostics is for serial lines"
"#;
    assert_done(&python(&[head, CYCLE, tail].concat(), &[&address.port().to_string()]));
}

#[test]
#[ignore = "needs modbus-tk: see the top of this file"]
fn modbus_tk_runs_a_grip_cycle_over_tcp() {
    let (_served, address) = gripper();
    let head = r#"
import sys
import modbus_tk.defines as cst
from modbus_tk import modbus, modbus_tcp
client = modbus_tcp.TcpMaster("127.0.0.1", int(sys.argv[1]), timeout_in_sec=5)

def read(address, count):
    return list(client.execute(1, cst.READ_HOLDING_REGISTERS, address, count))

def inputs(address, count):
    return list(client.execute(1, cst.READ_INPUT_REGISTERS, address, count))

def write(address, values):
    assert client.execute(1, cst.WRITE_MULTIPLE_REGISTERS, address, output_value=values) == (address, len(values))

def coil(address, value):
    client.execute(1, cst.WRITE_SINGLE_COIL, address, output_value=int(value))
"#;
    let tail = r#"
for address, count, code in [(4, 1, cst.ILLEGAL_DATA_ADDRESS), (0, 5, cst.ILLEGAL_DATA_ADDRESS)]:
    try:
        read(address, count)
        raise SystemExit("register 4 must not exist")
    except modbus.ModbusError as error:
        assert error.get_exception_code() == code, error
client.execute(1, cst.WRITE_MULTIPLE_COILS, 8, output_value=[1, 0, 1, 0, 0, 0, 0, 1])
assert read(0, 1) == [0x0185], read(0, 1)
assert client.execute(1, cst.READ_COILS, 0, 16) == (1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1)
assert client.execute(1, cst.READ_DISCRETE_INPUTS, 28, 1) == (1,), "FAST STOP"
"#;
    assert_done(&python(&[head, CYCLE, tail].concat(), &[&address.port().to_string()]));
}

#[test]
#[ignore = "needs jsmodbus: see the top of this file"]
fn jsmodbus_runs_a_grip_cycle_over_tcp() {
    let (_served, address) = gripper();
    assert_done(&node(include_str!("jsmodbus.js"), &["tcp", &address.port().to_string()]));
}

#[test]
#[ignore = "needs mbpoll: see the top of this file"]
fn mbpoll_commands_of_the_document_grip_when_pasted() {
    let (_gripper, address) = gripper();
    let port = format!("-p {}", address.port());
    let status = format!("mbpoll -0 -1 -q {port} -t 3 -r 5 -c 1 127.0.0.1");
    let printed = paste(&read("docs/quick-start.md"), "-p 1502", &[("-p 1502", &port)], &status);
    // The part between the fingers has 20 mm, the part of the document 22 mm.
    for answer in ["[0]: \t0x1000", "[1]: \t0x0500", "[4]: \t0x0FA0", "[5]: \t0x0000"] {
        assert!(printed.contains(answer), "{answer}: {printed}");
    }
}

#[test]
#[ignore = "needs mbpoll: see the top of this file"]
fn mbpoll_reads_writes_and_homes_over_tcp() {
    let (_served, address) = gripper();
    let port = address.port().to_string();
    // Values follow the host. Each call opens a new connection.
    let poll = |arguments: &[&str], values: &[&str]| {
        mbpoll(&[&["-m", "tcp", "-p", &port], arguments, &["127.0.0.1"], values].concat())
    };
    let written = poll(&["-t", "4", "-r", "0"], &["0", "1220", "5000", "4000"]);
    assert!(written.contains("Written 4 references"), "{written}");
    let holding = poll(&["-t", "4", "-r", "0", "-c", "4"], &[]);
    assert!(holding.contains("[1]: \t1220") && holding.contains("[3]: \t4000"), "{holding}");
    let beyond = poll(&["-t", "4", "-r", "3", "-c", "2"], &[]);
    assert!(beyond.contains("Illegal data address"), "{beyond}");
    // HOMING by its coil continues between the connections.
    let written = poll(&["-t", "0", "-r", "3"], &["1"]);
    assert!(written.contains("Written 1 references"), "{written}");
    let referenced = || poll(&["-t", "1", "-r", "16", "-c", "1"], &[]).contains("[16]: \t1");
    let start = Instant::now();
    while !referenced() {
        assert!(start.elapsed() < BOUND, "REFERENCED is not set within the time limit");
    }
    let width = poll(&["-t", "3", "-r", "3", "-c", "1"], &[]);
    assert!(width.contains("[3]: \t11000"), "{width}");
    // SYSSTATE as a 32-bit number, high word first: REFERENCED is 01000000h, TARGET_POS_REACHED 80000000h.
    let state = poll(&["-B", "-t", "3:int", "-r", "1", "-c", "1"], &[]);
    let expected = 0x8100_0000_u32.cast_signed().to_string();
    assert!(state.contains(&format!("[1]: \t{expected}")), "{state}");
}

/// Runs the steps of a `tokio-modbus` client within the time limit.
fn with_tokio_modbus(address: SocketAddr, act: impl AsyncFnOnce(&mut Context)) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let done = timeout(BOUND, async {
            let mut context = tcp::connect_slave(address, Slave::tcp_device()).await.unwrap();
            act(&mut context).await;
        });
        done.await.expect("the steps end within the time limit");
    });
}

#[test]
fn tokio_modbus_reads_writes_and_grips() {
    let (_served, address) = gripper();
    grip_with_tokio_modbus(address);
}

#[test]
fn tokio_modbus_reads_writes_and_grips_through_a_gateway() {
    let config = Config { part: Part::of_width(20.0), time_scale: 10.0, ..Config::default() };
    let lines = Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() };
    let served = ServerThread::start(config, &lines, None).unwrap();
    let gateway = Gateway::start(served.tcp_address().unwrap(), &[]);
    with_tokio_modbus(gateway.modbus, async |context| {
        // The gripper answers.
        while context.read_input_registers(0, 6).await.unwrap().is_err() {}
        // BUS_TIMEOUT: a busy machine is less punctual than a PLC.
        context.write_single_register(101, 60_000).await.unwrap().unwrap();
    });
    grip_with_tokio_modbus(gateway.modbus);
}

/// Grips and releases a part of 20 mm with `tokio-modbus`, and checks its other functions.
pub(crate) fn grip_with_tokio_modbus(address: SocketAddr) {
    with_tokio_modbus(address, async |context| {
        for (flags, state) in [(0x0800, 0x0100), (0x0200, 0x1000), (0x0400, 0x0100)] {
            let image = [0, 2000, 10_000, 4000];
            context.write_multiple_registers(0, &image).await.unwrap().unwrap();
            context.write_single_register(0, flags).await.unwrap().unwrap();
            let end = loop {
                let image = context.read_input_registers(0, 6).await.unwrap().unwrap();
                if image[5] != 26 {
                    break image;
                }
            };
            assert_eq!((end[0], end[5]), (state, 0), "{flags:04X}: {end:?}");
        }
        let answer = context.read_write_multiple_registers(0, 2, 0, &[0x0020]).await.unwrap().unwrap();
        assert_eq!(answer, [0x0020, 2000]);
        context.masked_write_register(0, 0xFFFF, 0).await.unwrap().unwrap();
        context.write_multiple_coils(8, &[true, false]).await.unwrap().unwrap();
        let coils = context.read_coils(8, 8).await.unwrap().unwrap();
        assert_eq!(coils, [true, false, false, false, false, true, false, false]);
        assert_eq!(context.read_discrete_inputs(16, 1).await.unwrap(), Ok(vec![true]));
        let beyond = context.read_holding_registers(0, 5).await.unwrap();
        assert_eq!(beyond, Err(ExceptionCode::IllegalDataAddress));
        let identity = context.read_device_identification(ReadCode::Basic, 0).await.unwrap().unwrap();
        assert_eq!(identity.device_id_objects.len(), 3);
    });
}

#[test]
fn gripping_cycle_example_runs_over_tcp_and_counts() {
    let (served, address) = gripper();
    let run = |to: &str| {
        let arguments = ["--tcp", to, "--cycles", "2"];
        Command::new(example::path("gripping_cycle")).args(arguments).output().unwrap()
    };
    let output = run(&address.to_string());
    assert!(output.status.success(), "{}", printed(&output));
    let printed_first = "2 parts held, 0 not found, 0 lost; 1 homings, 0 errors\n";
    assert!(
        printed(&output).starts_with("2 cycles in ") && printed(&output).contains(printed_first),
        "{}",
        printed(&output)
    );
    assert!(printed(&output).contains(" requests, 0 repeated; slowest answer "), "{}", printed(&output));
    served.stop().unwrap();
    let output = run(&address.to_string());
    assert_eq!(output.status.code(), Some(1));
    assert!(printed(&output).contains(&format!("{address} cannot be reached")), "{}", printed(&output));
}
