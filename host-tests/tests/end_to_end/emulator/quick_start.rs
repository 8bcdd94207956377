//! docs/quick-start.md from the third step to the last, on the released image with default settings and an empty flash. The test
//! pastes the commands, cycles the power, and accesses the registers as a master.

use document::{ImageAccess, image_accesses, read};
use host_tests::emulator::Extras;
use host_tests::flash_controller::FlashController;
use host_tests::masters::paste;
use host_tests::modbus_master::Master;
use host_tests::rig::{Rig, motions};
use host_tests::terminal::Terminal;
use host_tests::world::with_part;
use wsg_bridge_fw::io::Inputs;
use wsg_protocol::CommandId;

use super::service_port::poll;
use super::{Board, RELEASED, wait_until};

const DOCUMENT: &str = "docs/quick-start.md";

/// The bridge's address in the document.
const UNIT: u8 = 5;

/// A board with a gripper and a cable at its service port.
struct Plant {
    rig: Rig,
    cable: Terminal,
}

impl Plant {
    /// Switches the power on.
    fn power_up(flash: &FlashController) -> Self {
        flash.power_cycle();
        let extras = Extras { models: flash.models(), ..Extras::default() };
        let mut rig = Board::DEFAULT.rig(RELEASED, extras, with_part(20.0));
        let cable = Terminal::to(rig.board_mut().take_service_line().unwrap()).unwrap();
        let plant = Self { rig, cable };
        plant.wait(107, 2);
        plant
    }

    /// Waits until this input register has this value.
    fn wait(&self, register: u16, value: u16) {
        let (address, value) = (register.to_string(), format!("\t{value}\n"));
        let read = || poll(&self.cable, &["-t", "3", "-r", &address, "-c", "1"], &[]);
        wait_until(&format!("{value:?} in register {address}"), read, |printed| printed.contains(&value));
    }

    /// Pastes the commands of this text and returns their output.
    fn paste(&self, text: &str) -> String {
        paste(text, "$M", &[("/dev/ttyACM0", &self.cable.path)], "")
    }
}

/// Executes accesses as a PLC that polls.
fn play(master: &mut Master, accesses: &[ImageAccess]) {
    for access in accesses {
        match access {
            ImageAccess::Write(values) => master.write(0, values).unwrap(),
            ImageAccess::Read(expected) => {
                let is_read = |values: &Vec<u16>| ImageAccess::expects(expected, values.iter().copied());
                wait_until(&format!("{expected:?}"), || master.read(4, 0, 6).unwrap(), is_read);
            }
        }
    }
}

#[test]
#[ignore = "needs QEMU, the firmware image and mbpoll: run `cargo xtask test`"]
fn quick_start_by_mbpoll_and_registers_leads_to_a_grip() {
    host_tests::rig::unless_disturbed(leads_to_a_grip);
}

fn leads_to_a_grip() {
    let text = read(DOCUMENT);
    let (before, after) =
        text.split_once("\n## 7. ").expect("docs/quick-start.md must have a step 7, with the power cycle");
    // The variables persist, as in one shell.
    let variables = before.lines().filter(|line| line.starts_with("M=") || line.starts_with("T="));
    let variables: String = variables.map(|line| format!("{line}\n")).collect();

    let flash = Board::DEFAULT.flash();
    let plant = Plant::power_up(&flash);
    let printed = plant.paste(before);
    assert!(printed.contains("[107]: \t2"), "{printed}");
    assert_eq!(printed.matches("Written 1 references").count(), 8, "{printed}");
    plant.wait(204, 2);
    plant.wait(205, 0);
    assert_eq!(motions(&plant.rig.trace().since(0)), []);
    drop(plant);

    let mut plant = Plant::power_up(&flash);
    plant.rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    // Wait for the debounce time of the wire.
    plant.rig.pass(50).unwrap();
    let mut master = plant.rig.master(UNIT).unwrap();
    master.allow_pauses().unwrap();
    play(&mut master, &image_accesses(after));
    let printed = plant.paste(&after.replacen("```sh\n$M", &format!("```sh\n{variables}$M"), 1));
    for answer in ["[203]: \t1", "[176]: \t384", "[133]: \t0"] {
        assert!(printed.contains(answer), "{answer}: {printed}");
    }
    assert_eq!(motions(&plant.rig.trace().since(0)), [CommandId::Homing, CommandId::GripPart]);
    assert!(flash.violations().is_empty(), "{:?}", flash.violations());
}
