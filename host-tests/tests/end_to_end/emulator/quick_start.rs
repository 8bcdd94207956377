//! docs/quick-start.md from the third step to the last, on the released image with default settings and an empty flash. The test
//! pastes the commands, cycles the power, and sends the frames as a master.

use std::time::Instant;

use document::{can_frames, read};
use host_tests::can_bus::{CanBus, Station};
use host_tests::can_wire::WireFrame;
use host_tests::emulator::{Emulator, Extras};
use host_tests::flash_controller::FlashController;
use host_tests::masters::paste;
use host_tests::registers::RegisterModel;
use host_tests::rig::{MOTION_PATIENCE, PATIENCE, Rig, motions};
use host_tests::terminal::Terminal;
use host_tests::trace::Trace;
use host_tests::world::with_part;
use wsg_bridge_fw::io::Inputs;
use wsg_protocol::CommandId;

use super::image;
use super::service_port::poll;

const DOCUMENT: &str = "docs/quick-start.md";

/// The bridge's frame in the document.
const TPDO1: u16 = 0x185;

/// A board with a gripper and a cable at its service port.
struct Plant {
    rig: Rig,
    cable: Terminal,
}

impl Plant {
    /// Switches the power on.
    fn power_up(flash: &FlashController, more: Vec<Box<dyn RegisterModel>>) -> Self {
        flash.power_cycle();
        let models = flash.models().into_iter().chain(more).collect();
        let extras = Extras { models, ..Extras::default() };
        let board = Emulator::start_with(&image("WSG_FIRMWARE_ELF"), extras).unwrap();
        let mut rig = Rig::of(board, None, with_part(20.0), Trace::new(vec![])).unwrap();
        let cable = Terminal::to(rig.board_mut().take_service_line().unwrap()).unwrap();
        let plant = Self { rig, cable };
        plant.wait(107, 2);
        plant
    }

    /// Waits until this input register has this value.
    fn wait(&self, register: u16, value: u16) {
        let bound = Instant::now() + PATIENCE;
        let address = register.to_string();
        while !poll(&self.cable, &["-t", "3", "-r", &address, "-c", "1"], &[])
            .contains(&format!("\t{value}\n"))
        {
            assert!(Instant::now() < bound, "register {register} does not become {value}");
        }
    }

    /// Pastes the commands of this text and returns their output.
    fn paste(&self, text: &str) -> String {
        paste(text, "$M", &[("/dev/ttyACM0", &self.cable.path)], "")
    }
}

fn receives(master: &Station, wanted: &WireFrame) {
    let bound = Instant::now() + MOTION_PATIENCE;
    while master.received.recv_timeout(PATIENCE).expect("a frame") != *wanted {
        assert!(Instant::now() < bound, "{wanted:?} was not received");
    }
}

#[test]
#[ignore = "needs QEMU, the firmware image and mbpoll: run `cargo xtask test`"]
fn mbpoll_commands_and_frames_of_the_quick_start_lead_to_a_grip() {
    let text = read(DOCUMENT);
    let (before, after) =
        text.split_once("\n## 7. ").expect("docs/quick-start.md must have a step 7, with the power cycle");
    // The variables persist, as in one shell.
    let variables = before.lines().filter(|line| line.starts_with("M=") || line.starts_with("T="));
    let variables: String = variables.map(|line| format!("{line}\n")).collect();

    let flash = FlashController::new();
    let plant = Plant::power_up(&flash, vec![]);
    let printed = plant.paste(before);
    assert!(printed.contains("[107]: \t2"), "{printed}");
    assert_eq!(printed.matches("Written 1 references").count(), 8, "{printed}");
    plant.wait(204, 2);
    plant.wait(205, 0);
    assert_eq!(motions(&plant.rig.trace().since(0)), []);
    drop(plant);

    let can = CanBus::new(250_000);
    let master = can.join();
    let plant = Plant::power_up(&flash, vec![Box::new(can)]);
    receives(&master, &WireFrame::standard(0x705, &[0]));
    plant.rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    // Wait for the debounce time of the wire.
    plant.rig.pass(50).unwrap();
    // A master on a busy machine is less punctual than a PLC.
    let written = poll(&plant.cable, &["-t", "4", "-r", "101"], &["60000"]);
    assert!(written.contains("Written 1 references"), "{written}");
    for (id, data) in can_frames(after) {
        let frame = WireFrame::standard(id, &data);
        if id == TPDO1 {
            receives(&master, &frame);
        } else {
            master.send(frame);
        }
    }
    let printed = plant.paste(&after.replacen("```sh\n$M", &format!("```sh\n{variables}$M"), 1));
    for answer in ["[203]: \t1", "[174]: \t2", "[133]: \t0"] {
        assert!(printed.contains(answer), "{answer}: {printed}");
    }
    assert_eq!(motions(&plant.rig.trace().since(0)), [CommandId::Homing, CommandId::GripPart]);
    assert!(flash.violations().is_empty(), "{:?}", flash.violations());
}
