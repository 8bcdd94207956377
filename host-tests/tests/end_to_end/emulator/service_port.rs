//! The service port of the released image with a third-party master, for every PLC bus.

use document::read;
use host_tests::can_bus::CanBus;
use host_tests::emulator::Extras;
use host_tests::masters;
use host_tests::rig::{Rig, motions};
use host_tests::terminal::Terminal;
use wsg_sim::Config;

use super::{Board, RELEASED};

/// Heading after which the commands of docs/commissioning.md move the fingers.
pub(super) const BY_HAND: &str = "\n## Without a PLC";

/// Runs `mbpoll` at the service port.
pub(super) fn poll(terminal: &Terminal, arguments: &[&str], values: &[&str]) -> String {
    masters::poll(&terminal.path, 115_200, arguments, values)
}

/// Starts a board with its gripper on RS-232. Also returns the other end of its USB cable.
fn on_cable(board: Board, variable: &str, extras: Extras<'_>) -> (Rig, Terminal) {
    let mut rig = board.rig(variable, extras, Config::default());
    let terminal = Terminal::to(rig.board_mut().take_service_line().unwrap()).unwrap();
    (rig, terminal)
}

/// Reads and changes settings over the USB cable.
fn reads_and_sets((rig, terminal): (Rig, Terminal), plc_bus: &str) {
    let poll = |arguments: &[&str], values: &[&str]| poll(&terminal, arguments, values);

    let version = poll(&["-t", "3", "-r", "100", "-c", "1"], &[]);
    assert!(version.contains("[100]: \t"), "{plc_bus}: {version}");
    // The gripper responds while `mbpoll` starts.
    let image =
        (0..50).map(|_| poll(&["-t", "3", "-r", "0", "-c", "6"], &[])).find(|it| it.contains("[5]: \t"));
    assert!(image.is_some(), "{plc_bus}: no input image");

    let written = poll(&["-t", "4", "-r", "106"], &["7"]);
    assert!(written.contains("Written 1 references"), "{plc_bus}: {written}");
    let debounce = poll(&["-t", "4", "-r", "106", "-c", "1"], &[]);
    assert!(debounce.contains("[106]: \t7"), "{plc_bus}: {debounce}");
    // A changed unit and character time-out of the bus must not lock the port.
    poll(&["-t", "4", "-r", "100"], &["9"]);
    poll(&["-t", "4", "-r", "103"], &["0"]);
    let unit = poll(&["-t", "4", "-r", "100", "-c", "1"], &[]);
    assert!(unit.contains("[100]: \t9"), "{plc_bus}: {unit}");

    for (table, values) in [("4", &["0x0800", "0", "5000", "4000"][..]), ("0", &["1"])] {
        let refused = poll(&["-t", table, "-r", if table == "0" { "3" } else { "0" }], values);
        assert!(refused.contains("Illegal function"), "{plc_bus}: {refused}");
    }
    assert_eq!(motions(&rig.trace().since(0)), [], "{plc_bus}");
}

fn mbpoll_reads_and_sets_over_service_port_without_plc_bus(board: Board) {
    reads_and_sets(on_cable(board, "WSG_FIRMWARE_ELF_NO_BUS", Extras::default()), "no bus");
}

fn mbpoll_reads_and_sets_over_the_service_port_beside_modbus(board: Board) {
    reads_and_sets(on_cable(board, RELEASED, Extras::default()), "Modbus");
}

#[test]
#[ignore = "needs QEMU, the firmware images and mbpoll: run `cargo xtask test`"]
fn mbpoll_reads_and_sets_over_the_service_port_beside_canopen() {
    host_tests::rig::unless_disturbed(|| {
        let extras = Extras { models: CanBus::new(250_000).models(), ..Extras::default() };
        reads_and_sets(on_cable(Board::DEFAULT, "WSG_FIRMWARE_ELF_CAN_PLC", extras), "CANopen");
    });
}

fn mbpoll_commands_of_the_document_work_when_pasted(board: Board) {
    let (rig, terminal) = on_cable(board, RELEASED, Extras::default());
    let answers = (0..50)
        .map(|_| poll(&terminal, &["-t", "3", "-r", "107", "-c", "1"], &[]))
        .any(|it| it.contains("\t2"));
    assert!(answers, "the gripper does not respond");
    let here = [("/dev/ttyACM0", terminal.path.as_str())];

    let text = read("docs/commissioning.md");
    let (service_port, _) =
        text.split_once(BY_HAND).expect("the page must have commands by hand, which move fingers");
    let printed = masters::paste(service_port, "$M", &here, "");
    for answer in [
        "[0]: \t",
        "[134]: \t",
        "[146]: \t",
        "[108]: \t",
        "Written 4 references",
        "Written 1 references",
        "[100]: \t6",
    ] {
        assert!(printed.contains(answer), "{answer}: {printed}");
    }
    assert_eq!(motions(&rig.trace().since(0)), []);
}

on_every_board!(board =>
    mbpoll_reads_and_sets_over_service_port_without_plc_bus,
    mbpoll_reads_and_sets_over_the_service_port_beside_modbus,
    mbpoll_commands_of_the_document_work_when_pasted,
);
