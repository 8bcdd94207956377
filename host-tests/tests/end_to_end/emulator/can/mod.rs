//! The image with CAN over SLCAN in the emulator, under three settings: the gripper on the bus, the PLC on the bus, and both;
//! and a third-party CANopen master.

use std::time::Instant;

use host_tests::can_hub::CanHub;
use host_tests::emulator::Emulator;
use host_tests::gripper_end::GripperEnd;
use host_tests::masters::{self, said};
use host_tests::rig::{ACKNOWLEDGED_WITHIN, MOTION_PATIENCE, PATIENCE, motions};
use host_tests::terminal::Terminal;
use host_tests::trace::Trace;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::CommandId;
use wsg_sim::{Config, Part};

use super::image;

const READY: Outputs = Outputs::READY.union(Outputs::LINK_OK);

fn config() -> Config {
    Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() }
}

/// Whether this is the end of a command: READY, and these besides.
fn wait(board: &Emulator, wanted: Outputs) {
    board.wait_outputs(MOTION_PATIENCE, |outputs| outputs == wanted).unwrap();
}

fn pulse(board: &Emulator, wire: Inputs) {
    board.set_input(wire, true).unwrap();
    let start = board.now_ms().unwrap();
    while board.now_ms().unwrap().wrapping_sub(start) < 5 {}
    board.set_input(wire, false).unwrap();
    let start = board.now_ms().unwrap();
    while board.now_ms().unwrap().wrapping_sub(start) < 5 {}
}

/// From power-up to READY, by the wires.
fn make_ready(board: &Emulator) {
    board.wait_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
    board.set_input(Inputs::FAST_STOP_OK, true).unwrap();
    // The FAST STOP of power-up has to be confirmed before it can be acknowledged.
    let bound = Instant::now() + PATIENCE;
    while Instant::now() < bound {
        pulse(board, Inputs::STOP_ACK);
        if board.wait_outputs(ACKNOWLEDGED_WITHIN, |outputs| outputs == READY).is_ok() {
            return;
        }
    }
    panic!("not READY: {:?}", board.outputs());
}

/// A command by a wire: BUSY, and then these outputs.
fn command(board: &Emulator, wire: Inputs, wanted: Outputs) {
    board.set_input(wire, true).unwrap();
    board.wait_outputs(PATIENCE, |outputs| outputs.contains(Outputs::BUSY)).unwrap();
    board.set_input(wire, false).unwrap();
    wait(board, wanted);
}

fn assert_one_cycle(gripper: &GripperEnd, trace: &Trace) {
    let expected = [CommandId::Homing, CommandId::GripPart, CommandId::ReleasePart];
    assert_eq!(motions(&trace.since(0)), expected);
    assert!(gripper.state().width > 25.0, "{}", gripper.state().width);
}

#[test]
#[ignore = "needs QEMU and the firmware image with the gripper on CAN: run `cargo xtask test`"]
fn gripper_on_can_runs_a_grip_cycle_by_wires() {
    let mut board = Emulator::start(&image("WSG_FIRMWARE_ELF_CAN_GRIPPER")).unwrap();
    let hub = CanHub::start(board.take_slcan_line().unwrap()).unwrap();
    let trace = Trace::new(vec![]);
    let gripper = GripperEnd::start(hub.gripper, config(), &trace).unwrap();
    make_ready(&board);
    command(&board, Inputs::HOME, READY | Outputs::REFERENCED);
    command(&board, Inputs::GRIP, READY | Outputs::REFERENCED | Outputs::HOLDING);
    command(&board, Inputs::RELEASE, READY | Outputs::REFERENCED);
    assert_one_cycle(&gripper, &trace);
}

/// Runs the master against a board; the gripper is on the bus with it or on its serial line.
fn run_master(elf: &str, gripper_on_bus: bool) {
    let mut board = Emulator::start(&image(elf)).unwrap();
    let hub = CanHub::start(board.take_slcan_line().unwrap()).unwrap();
    let line = if gripper_on_bus { hub.gripper } else { board.take_gripper_line().unwrap() };
    let trace = Trace::new(vec![]);
    let gripper = GripperEnd::start(line, config(), &trace).unwrap();
    // The gripper confirms the FAST STOP of power-up.
    board.wait_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
    board.set_input(Inputs::FAST_STOP_OK, true).unwrap();
    let terminal = Terminal::to(hub.master).unwrap();
    let eds = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/wsg-bridge.eds");
    let output = masters::python(include_str!("master.py"), &[&terminal.path, eds]);
    assert!(output.status.success() && said(&output).contains("passed"), "{}", said(&output));
    let cycle = [CommandId::GripPart, CommandId::ReleasePart];
    let expected = [&[CommandId::Homing], &cycle[..], &cycle].concat();
    assert_eq!(motions(&trace.since(0)), expected, "{}", said(&output));
    drop(gripper);
}

#[test]
#[ignore = "needs QEMU, the firmware image with the PLC on CAN and canopen: run `cargo xtask test`"]
fn plc_on_can_is_served_to_a_master_of_canopen() {
    run_master("WSG_FIRMWARE_ELF_CAN_PLC", false);
}

#[test]
#[ignore = "needs QEMU, the firmware image with both on CAN and canopen: run `cargo xtask test`"]
fn plc_and_gripper_on_one_bus_are_served_to_a_master_of_canopen() {
    run_master("WSG_FIRMWARE_ELF_CAN_BOTH", true);
}
