//! Third-party masters over a pseudo terminal to the emulated board: `mbpoll`, `pymodbus`, `minimalmodbus`,
//! `modbus-tk`, `jsmodbus` and `tokio-modbus`.
//!
//! A pseudo terminal refuses parity, so the masters use 8N1. The emulated line models neither rate nor parity.

use std::time::Duration;

use document::read;
use host_tests::emulator::Extras;
use host_tests::masters::{self, printed};
use host_tests::rig::{Rig, motions};
use host_tests::terminal::Terminal;
use host_tests::world::with_part;
use tokio_modbus::ExceptionCode;
use tokio_modbus::client::{Context, rtu};
use tokio_modbus::prelude::{Reader, Slave, Writer};
use wsg_bridge_fw::io::Inputs;
use wsg_protocol::CommandId;

use super::service_port::BY_HAND;
use super::{Board, RELEASED, await_gripper, wait_until};

struct Plant {
    rig: Rig,
    terminal: Terminal,
    /// Requests that the bus had lost before the time-outs were raised.
    lost_before: [u16; 5],
}

/// Input registers from 118 on: BUS_MESSAGES, BUS_ERRORS, BUS_EXCEPTIONS, SERVER_MESSAGES, NO_RESPONSES, SERVER_BUSY,
/// BUS_OVERRUNS.
const COUNTS: (u16, u16) = (118, 7);

/// Returns from COUNTS how many requests were not answered, then the errors that may explain it.
fn lost(counts: &[u16]) -> [u16; 5] {
    let [messages, errors, _, own, unanswered, busy, overruns] = counts[..] else { panic!("{counts:?}") };
    [messages - own, errors, unanswered, busy, overruns]
}

/// A board with a responding gripper. The FAST STOP of power-up is not acknowledged.
fn plant(board: Board) -> Plant {
    let mut rig = board.rig(RELEASED, Extras::default(), with_part(20.0));
    rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    let mut master = rig.master(1).unwrap();
    master.allow_pauses().unwrap();
    await_gripper(&mut master);
    let lost_before = lost(&master.read(4, COUNTS.0, COUNTS.1).unwrap());
    Plant { rig, terminal: Terminal::to(master.into_line().unwrap()).unwrap(), lost_before }
}

/// Checks that the bridge has answered every request on its bus and received nothing else. No master repeats a request.
fn assert_all_answered(plant: &Plant, printed: &str) {
    let counts = run_tokio(&plant.terminal, async |client| {
        client.read_input_registers(COUNTS.0, COUNTS.1).await.unwrap().unwrap()
    });
    assert_eq!(lost(&counts), plant.lost_before, "{printed}");
}

/// Runs requests with `tokio-modbus`.
fn run_tokio<T>(terminal: &Terminal, requests: impl AsyncFnOnce(&mut Context) -> T) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let port = serial2_tokio::SerialPort::open(&terminal.path, 19_200).unwrap();
        let mut client = rtu::attach_slave(port, Slave(1));
        let within = Duration::from_secs(120);
        tokio::time::timeout(within, requests(&mut client))
            .await
            .expect("the bridge answers within the time limit")
    })
}

/// Checks that the bridge has sent homing, a grip and a release once each, the final width, and that no request was lost.
fn assert_one_cycle(plant: &Plant, printed: &str) {
    assert_all_answered(plant, printed);
    let expected = [CommandId::Homing, CommandId::GripPart, CommandId::ReleasePart];
    assert_eq!(motions(&plant.rig.trace().since(0)), expected, "{printed}");
    let width = plant.rig.gripper().state().width;
    assert!((width - 40.0).abs() < 0.5, "{width}");
}

/// Runs a Python master with the script, which homes, grips, releases and checks the results.
fn run_python(board: Board, script: &str) {
    let plant = plant(board);
    let script = script.replace("# line.py\n", include_str!("line.py"));
    let script = script.replace("# cycle.py\n", include_str!("cycle.py"));
    let output = masters::python(&script, &[&plant.terminal.path]);
    assert!(output.status.success(), "{}", printed(&output));
    assert_one_cycle(&plant, &printed(&output));
}

fn pymodbus_runs_a_grip_cycle(board: Board) {
    run_python(board, include_str!("pymodbus.py"));
}

fn minimalmodbus_runs_a_grip_cycle(board: Board) {
    run_python(board, include_str!("minimalmodbus.py"));
}

fn modbus_tk_runs_a_grip_cycle(board: Board) {
    run_python(board, include_str!("modbus_tk.py"));
}

fn jsmodbus_runs_a_grip_cycle(board: Board) {
    let plant = plant(board);
    let output = masters::node(include_str!("../../jsmodbus.js"), &["rtu", &plant.terminal.path]);
    assert!(output.status.success(), "{}", printed(&output));
    assert_one_cycle(&plant, &printed(&output));
}

fn mbpoll_reads_writes_and_homes(board: Board) {
    let plant = plant(board);
    let poll =
        |arguments: &[&str], values: &[&str]| masters::poll(&plant.terminal.path, 19_200, arguments, values);
    // BUS_TIMEOUT of a minute. On a busy host, there may be more than a second between two calls.
    let written = poll(&["-t", "4", "-r", "101"], &["60000"]);
    assert!(written.contains("Written 1 references"), "{written}");
    let written = poll(&["-t", "4", "-r", "0"], &["0", "1220", "5000", "4000"]);
    assert!(written.contains("Written 4 references"), "{written}");
    let holding = poll(&["-t", "4", "-r", "0", "-c", "4"], &[]);
    assert!(holding.contains("[1]: \t1220") && holding.contains("[3]: \t4000"), "{holding}");
    let beyond = poll(&["-t", "4", "-r", "3", "-c", "2"], &[]);
    assert!(beyond.contains("Illegal data address"), "{beyond}");
    // Trigger STOP/ACK, then HOMING, by their coils.
    for coil in ["4", "3"] {
        for value in ["1", "0"] {
            let written = poll(&["-t", "0", "-r", coil], &[value]);
            assert!(written.contains("Written 1 references"), "{written}");
        }
    }
    let read = || poll(&["-t", "1", "-r", "16", "-c", "1"], &[]);
    wait_until("REFERENCED", read, |printed| printed.contains("[16]: \t1"));
    assert_eq!(motions(&plant.rig.trace().since(0)), [CommandId::Homing]);
    let unit = poll(&["-t", "4", "-r", "100", "-c", "1"], &[]);
    assert!(unit.contains("[100]: \t1"), "{unit}");
    let server_id = poll(&["-u"], &[]);
    assert!(
        ["Id    : 0x01", "Status: On", "wsg-bridge-fw V"].iter().all(|printed| server_id.contains(printed)),
        "{server_id}"
    );
    assert_all_answered(&plant, "");
}

fn mbpoll_commands_of_the_document_grip_when_pasted(board: Board) {
    let plant = plant(board);
    let changes = [("/dev/ttyUSB0", plant.terminal.path.as_str()), ("-P even", "-P none")];
    let status = "$M -t 3 -r 5 -c 1 $T";
    let text = read("docs/commissioning.md");
    let (_, by_hand) = text.split_once(BY_HAND).expect("the page must have commands by hand");
    let printed = masters::paste(by_hand, "$M", &changes, status);
    assert!(printed.contains("[0]: \t4096") && printed.contains("[4]: \t4000"), "{printed}");
    assert_eq!(printed.matches("Written").count(), 7, "{printed}");
    assert_one_cycle(&plant, &printed);
}

fn tokio_modbus_runs_a_grip_cycle(board: Board) {
    let plant = plant(board);
    run_tokio(&plant.terminal, tokio_cycle);
    assert_one_cycle(&plant, "");
}

async fn tokio_cycle(client: &mut Context) {
    client.write_multiple_registers(0, &[0; 4]).await.unwrap().unwrap();
    tokio_command(client, &[1 << 12, 0, 0, 0]).await;
    assert_eq!(tokio_command(client, &[1 << 11, 0, 0, 0]).await, (1, 0), "HOMING ends in IDLE");
    assert_eq!(tokio_command(client, &[1 << 9, 20_00, 50_00, 40_00]).await, (1 << 4, 0), "GRIP in HOLDING");
    assert_eq!(client.read_holding_registers(0, 4).await.unwrap().unwrap(), [0, 20_00, 50_00, 40_00]);
    assert_eq!(tokio_command(client, &[1 << 10, 40_00, 50_00, 40_00]).await, (1, 0), "RELEASE in IDLE");

    assert_eq!(client.read_holding_registers(4, 1).await.unwrap(), Err(ExceptionCode::IllegalDataAddress));
    let written_and_read = client.read_write_multiple_registers(0, 2, 1, &[40_01]).await.unwrap().unwrap();
    assert_eq!(written_and_read, [0, 40_01]);
    client.masked_write_register(1, 0xFF00, 0x0034).await.unwrap().unwrap();
    assert_eq!(client.read_holding_registers(1, 1).await.unwrap().unwrap(), [(40_01 & 0xFF00) | 0x34]);
    client.write_single_coil(8, true).await.unwrap().unwrap();
    assert_eq!(client.read_coils(8, 2).await.unwrap().unwrap()[..2], [true, false]);
    assert!(client.read_discrete_inputs(0, 1).await.unwrap().unwrap()[0], "IDLE");
}

/// Runs a command and returns GSTATE and status at its end.
async fn tokio_command(client: &mut Context, image: &[u16; 4]) -> (u16, u16) {
    client.write_multiple_registers(0, image).await.unwrap().unwrap();
    client.write_multiple_registers(0, &[0, image[1], image[2], image[3]]).await.unwrap().unwrap();
    loop {
        let input = client.read_input_registers(0, 6).await.unwrap().unwrap();
        if input[5] != 26 {
            return (input[0] >> 8, input[5]);
        }
    }
}

fn gripping_cycle_example_runs_over_rtu_and_counts(board: Board) {
    let plant = plant(board);
    let arguments = ["--rtu", &plant.terminal.path, "--cycles", "2", "--answer-within", "60"];
    let program = host_tests::example::path("gripping_cycle");
    let output = std::process::Command::new(program).args(arguments).output().unwrap();
    let printed = printed(&output);
    assert!(output.status.success(), "{printed}");
    let counted = "2 parts held, 0 not found, 0 lost; 1 homings, 0 errors\n";
    assert!(printed.starts_with("2 cycles in ") && printed.contains(counted), "{printed}");
    assert!(printed.contains(" requests, 0 repeated;"), "{printed}");
    assert_all_answered(&plant, &printed);
}

on_every_board!(board =>
    gripping_cycle_example_runs_over_rtu_and_counts,
    jsmodbus_runs_a_grip_cycle,
    mbpoll_commands_of_the_document_grip_when_pasted,
    mbpoll_reads_writes_and_homes,
    minimalmodbus_runs_a_grip_cycle,
    modbus_tk_runs_a_grip_cycle,
    pymodbus_runs_a_grip_cycle,
    tokio_modbus_runs_a_grip_cycle,
);
