//! Third-party masters over Modbus/TCP, each at a virtual gripper and through a gateway: `mbpoll` (Debian; it uses libmodbus),
//! `pymodbus` and `modbus-tk` (PyPI), `jsmodbus` and `modbus-serial` (npm), `tokio-modbus`, and the example `gripping_cycle`,
//! which uses the last. `modbus-serial` is the client of Node-RED's Modbus nodes. `minimalmodbus` supports only RTU.
//!
//! Tests with `mbpoll`, `pymodbus`, `modbus_tk`, `jsmodbus` or `modbus_serial` in their names require that program. `cargo xtask
//! test` runs them if it finds or can install the program, and prints NOT CHECKED otherwise.

use document::read;
use host_tests::example;
use host_tests::gateway::{Gateway, unpaused};
use host_tests::masters::{mbpoll, node, paste, printed, python};
use std::net::SocketAddr;
use std::process::{Command, Output};
use std::time::{Duration, Instant};
use tokio::time::{sleep, timeout};
use tokio_modbus::client::{Context, tcp};
use tokio_modbus::prelude::{ExceptionCode, ReadCode, Reader, Slave, Writer};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

/// Time limit of every wait.
pub(crate) const BOUND: Duration = Duration::from_secs(60);
/// Pause between two requests: without it, a master would keep the gateway from the processor.
const PAUSE: Duration = Duration::from_millis(5);

/// Starts a gripper with a part of 20 mm.
pub(crate) fn serve(lines: Lines) -> ServerThread {
    let config = Config { part: Part::of_width(20.0), time_scale: 10.0, ..Config::default() };
    ServerThread::start(config, &lines, None).unwrap()
}

/// Runs a test at a gripper, and through a gateway to another one.
fn at_gripper_and_gateway(test: impl Fn(SocketAddr)) {
    let served = serve(Lines { modbus: "127.0.0.1:0".parse().ok(), ..Lines::default() });
    test(served.modbus_address().unwrap());
    through_gateway(&[], test);
}

/// Runs a test with the address for Modbus/TCP of a gateway with these options, which is connected to its gripper.
pub(crate) fn through_gateway(options: &[&str], test: impl Fn(SocketAddr)) {
    println!("through a gateway:");
    let start = || {
        let served = serve(Lines { tcp: "127.0.0.1:0".parse().ok(), ..Lines::default() });
        let gateway = Gateway::start(served.tcp_address().unwrap(), options);
        (served, gateway)
    };
    unpaused(
        start,
        |(_, gateway)| gateway,
        |_, _| false,
        |(_, gateway)| {
            with_tokio_modbus(gateway.modbus, async |context| {
                // The gripper answers.
                while context.read_input_registers(0, 6).await.unwrap().is_err() {
                    sleep(PAUSE).await;
                }
                // BUS_TIMEOUT: a busy machine is less punctual than a PLC.
                context.write_single_register(101, 60_000).await.unwrap().unwrap();
            });
            test(gateway.modbus);
        },
    );
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
wait(lambda image: image[1] & 0x0010)                    # FAST STOP
print("cycle done")
"#;

#[track_caller]
fn assert_done(output: &Output) {
    assert!(output.status.success() && printed(output).contains("cycle done"), "{}", printed(output));
}

#[test]
#[ignore = "needs pymodbus: see the top of this file"]
fn pymodbus_runs_a_grip_cycle_over_tcp() {
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
assert identity[0].startswith(b"wsg-"), identity
answer = client.diag_query_data(b"\x12\x34", device_id=1)
assert answer.isError() and answer.exception_code == 1, "Diagnostics is for serial lines"
"#;
    let script = [head, CYCLE, tail].concat();
    at_gripper_and_gateway(|address| assert_done(&python(&script, &[&address.port().to_string()])));
}

#[test]
#[ignore = "needs modbus-tk: see the top of this file"]
fn modbus_tk_runs_a_grip_cycle_over_tcp() {
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
    let script = [head, CYCLE, tail].concat();
    at_gripper_and_gateway(|address| assert_done(&python(&script, &[&address.port().to_string()])));
}

#[test]
#[ignore = "needs jsmodbus: see the top of this file"]
fn jsmodbus_runs_a_grip_cycle_over_tcp() {
    let script = include_str!("jsmodbus.js");
    at_gripper_and_gateway(|address| assert_done(&node(script, &["tcp", &address.port().to_string()])));
}

#[test]
#[ignore = "needs modbus-serial: see the top of this file"]
fn modbus_serial_runs_a_grip_cycle_over_tcp() {
    let script = r#"
const assert = require("node:assert");
const ModbusRTU = require("modbus-serial");
const client = new ModbusRTU();

async function ended() {
    const end = Date.now() + 60_000;
    for (;;) {
        const { data } = await client.readInputRegisters(0, 6);
        if (data[5] !== 26) {                            // not E_CMD_PENDING
            return [data[0] >> 8, data[5]];
        }
        assert(Date.now() < end, "time-out");
    }
}

async function command(flags, ...parameters) {
    for (const word of [0, flags << 8, 0]) {
        await client.writeRegisters(0, [word, ...parameters]);
    }
    return ended();
}

async function run() {
    await client.connectTCP("127.0.0.1", { port: Number(process.argv[1]) });
    client.setID(1);
    client.setTimeout(60_000);
    assert.deepEqual(await command(1 << 0, 5000, 5000, 4000), [0x80, 3], "MOVE is refused");
    assert.deepEqual(await command(1 << 4, 0, 0, 0), [0x01, 0], "STOP/ACK");
    assert.deepEqual(await command(1 << 3, 0, 0, 0), [0x01, 0], "HOMING");
    assert.deepEqual(await command(1 << 1, 2000, 5000, 4000), [0x10, 0], "GRIP");
    assert.deepEqual((await client.readHoldingRegisters(0, 4)).data, [0, 2000, 5000, 4000]);
    await client.writeRegisters(0, [0, 4000, 5000, 4000]);
    await client.writeCoil(2, true);
    assert.deepEqual(await ended(), [0x01, 0], "RELEASE");
    await client.writeCoils(0, [false, false, false]);
    assert.deepEqual((await client.readCoils(0, 3)).data.slice(0, 3), [false, false, false]);
    await assert.rejects(client.readHoldingRegisters(4, 1), (error) => error.modbusCode === 2);
    console.log("cycle done");
}

run().then(() => process.exit(0), (error) => {
    console.error(error);
    process.exit(1);
});
"#;
    at_gripper_and_gateway(|address| assert_done(&node(script, &[&address.port().to_string()])));
}

#[test]
#[ignore = "needs mbpoll: see the top of this file"]
fn mbpoll_commands_of_the_document_grip_when_pasted() {
    at_gripper_and_gateway(|address| {
        let port = format!("-p {}", address.port());
        let status = format!("mbpoll -0 -1 -q {port} -t 3 -r 5 -c 1 127.0.0.1");
        let printed = paste(&read("docs/quick-start.md"), "-p 1502", &[("-p 1502", &port)], &status);
        for answer in ["[0]: \t0x1000", "[1]: \t0x0500", "[4]: \t0x0FA0", "[5]: \t0x0000"] {
            assert!(printed.contains(answer), "{answer}: {printed}");
        }
    });
}

#[test]
#[ignore = "needs mbpoll: see the top of this file"]
fn mbpoll_reads_writes_and_homes_over_tcp() {
    at_gripper_and_gateway(home_with_mbpoll);
}

/// Homes the fingers with `mbpoll`, after a refused motion, and checks its other functions.
fn home_with_mbpoll(address: SocketAddr) {
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
    // MOVE, which the gripper refuses, then HOMING, by their coils. HOMING continues between the connections.
    let refused = ["-t", "3", "-r", "5", "-c", "1"];
    let referenced = ["-t", "1", "-r", "16", "-c", "1"];
    for (coil, polled, end) in [("0", refused, "[5]: \t3"), ("3", referenced, "[16]: \t1")] {
        let written = poll(&["-t", "0", "-r", coil], &["1"]);
        assert!(written.contains("Written 1 references"), "{written}");
        let start = Instant::now();
        while !poll(&polled, &[]).contains(end) {
            assert!(start.elapsed() < BOUND, "no {end} within the time limit");
        }
        poll(&["-t", "0", "-r", coil], &["0"]);
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
    at_gripper_and_gateway(grip_with_tokio_modbus);
}

/// Grips and releases a part of 20 mm with `tokio-modbus`, after a refused motion, and checks its other functions.
pub(crate) fn grip_with_tokio_modbus(address: SocketAddr) {
    with_tokio_modbus(address, async |context| {
        let ends = [(0x0100, 0x8000, 3), (0x0800, 0x0100, 0), (0x0200, 0x1000, 0), (0x0400, 0x0100, 0)];
        for (flags, state, status) in ends {
            let image = [0, 2000, 10_000, 4000];
            context.write_multiple_registers(0, &image).await.unwrap().unwrap();
            context.write_single_register(0, flags).await.unwrap().unwrap();
            let end = loop {
                let image = context.read_input_registers(0, 6).await.unwrap().unwrap();
                if image[5] != 26 {
                    break image;
                }
                sleep(PAUSE).await;
            };
            assert_eq!((end[0], end[5]), (state, status), "{flags:04X}: {end:?}");
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
    let run = |to: SocketAddr| {
        let arguments = ["--tcp", &to.to_string(), "--cycles", "2"];
        Command::new(example::path("gripping_cycle")).args(arguments).output().unwrap()
    };
    at_gripper_and_gateway(|address| {
        let output = run(address);
        let printed = printed(&output);
        assert!(output.status.success(), "{printed}");
        let counted = "2 parts held, 0 not found, 0 lost; 1 homings, 0 errors\n";
        assert!(printed.starts_with("2 cycles in ") && printed.contains(counted), "{printed}");
        assert!(printed.contains(" requests, 0 repeated; slowest answer "), "{printed}");
    });
    // No program listens on port 1.
    let address = SocketAddr::from(([127, 0, 0, 1], 1));
    let output = run(address);
    assert_eq!(output.status.code(), Some(1));
    assert!(printed(&output).contains(&format!("{address} cannot be reached")), "{}", printed(&output));
}
