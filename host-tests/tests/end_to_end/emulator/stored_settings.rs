//! Settings in the flash of the flashed image, with a model of its flash interface: what is saved over the service port is
//! there after a power cycle, whatever the flash does in between.

use std::time::{Duration, Instant};

use host_tests::emulator::{Emulator, Extras};
use host_tests::flash_controller::FlashController;
use host_tests::gripper_end::GripperEnd;
use host_tests::modbus_master::Master;
use host_tests::rig::motions;
use host_tests::trace::Trace;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS,
};
use wsg_bridge_fw::storage::Page;
use wsg_sim::Config;

use super::image;

const PATIENCE: Duration = Duration::from_secs(60);

/// A board with its flash, a gripper, and a master on the service port.
struct Plant {
    _board: Emulator,
    flash: FlashController,
    service: Master,
    _gripper: GripperEnd,
    trace: Trace,
}

impl Plant {
    /// Power comes on.
    fn power_up(flash: FlashController) -> Self {
        flash.power_cycle();
        let extras = Extras { models: flash.models(), ..Extras::default() };
        let mut board = Emulator::start_with(&image("WSG_FIRMWARE_ELF"), extras).unwrap();
        let trace = Trace::new(vec![]);
        let line = board.take_gripper_line().unwrap();
        let gripper = GripperEnd::start(line, Config::default(), &trace).unwrap();
        let service = Master::new(board.take_service_line().unwrap(), 1);
        Self { _board: board, flash, service, _gripper: gripper, trace }
    }

    /// Power goes and comes back. Until then nothing has moved, and the driver did nothing that it must not.
    fn power_cycle(self) -> Self {
        Self::power_up(self.power_down())
    }

    fn power_down(self) -> FlashController {
        assert_eq!(motions(&self.trace.since(0)), []);
        assert!(self.flash.violations().is_empty(), "{:?}", self.flash.violations());
        self.flash
    }

    fn read(&mut self, function: u8, first: u16, count: u16) -> Vec<u16> {
        let ([a1, a0], [c1, c0]) = (first.to_be_bytes(), count.to_be_bytes());
        let answer = self.service.ask(&[function, a1, a0, c1, c0]).unwrap();
        assert_eq!(answer[0], function, "{answer:02X?}");
        answer[2..].as_chunks().0.iter().map(|word| u16::from_be_bytes(*word)).collect()
    }

    fn settings(&mut self) -> Vec<u16> {
        self.read(3, FIRST_SETTING, SETTINGS.len() as u16)
    }

    fn setting(&mut self, name: &str) -> u16 {
        self.read(3, setting(name), 1)[0]
    }

    fn write(&mut self, address: u16, value: u16) {
        let request = [&[6][..], &address.to_be_bytes(), &value.to_be_bytes()].concat();
        assert_eq!(self.service.ask(&request).unwrap(), request);
    }

    fn set(&mut self, name: &str, value: u16) {
        self.write(setting(name), value);
    }

    fn report(&mut self, name: &str) -> u16 {
        self.read(4, FIRST_REPORT + REPORTS.iter().position(|it| it.name == name).unwrap() as u16, 1)[0]
    }

    /// SAVE or DEFAULTS, to its end: SAVE_STATE.
    fn save(&mut self, command: &str) -> u16 {
        self.command(command);
        self.end_of_save()
    }

    fn command(&mut self, name: &str) {
        let at = COMMANDS.iter().position(|command| command.name == name).unwrap() as u16;
        self.write(FIRST_COMMAND + at, COMMAND_KEY);
    }

    fn end_of_save(&mut self) -> u16 {
        let bound = Instant::now() + PATIENCE;
        loop {
            match self.report("SAVE_STATE") {
                1 => assert!(Instant::now() < bound, "the save does not end"),
                state => return state,
            }
        }
    }
}

fn setting(name: &str) -> u16 {
    FIRST_SETTING + SETTINGS.iter().position(|setting| setting.name == name).unwrap() as u16
}

/// SETTINGS_FROM and SAVE_STATE (docs/registers.md).
const DELIVERED: u16 = 0;
const STORED: u16 = 1;
const SAVED: u16 = 2;

/// Double words of a record: one, two bytes a setting, one.
const RECORD: usize = 2 + SETTINGS.len().div_ceil(4);

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn what_was_saved_is_there_after_a_power_cycle() {
    let mut plant = Plant::power_up(FlashController::new());
    assert_eq!((plant.report("SETTINGS_FROM"), plant.report("SAVE_STATE")), (DELIVERED, 0));
    plant.set("DEBOUNCE", 7);
    let saved = plant.settings();
    assert_eq!(plant.save("SAVE"), SAVED);
    plant.set("DEBOUNCE", 8);
    let mut plant = plant.power_cycle();
    assert_eq!((plant.report("SETTINGS_FROM"), plant.settings()), (STORED, saved));
    plant.power_down();
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn an_unreadable_double_word_costs_its_record_and_no_start() {
    let mut plant = Plant::power_up(FlashController::new());
    plant.set("DEBOUNCE", 7);
    assert_eq!(plant.save("SAVE"), SAVED);
    plant.set("DEBOUNCE", 8);
    assert_eq!(plant.save("SAVE"), SAVED);
    let flash = plant.power_down();
    flash.set(Page::First, RECORD + 3, None);
    let mut plant = Plant::power_up(flash);
    assert_eq!((plant.report("SETTINGS_FROM"), plant.setting("DEBOUNCE")), (STORED, 7), "of the save before");
}
