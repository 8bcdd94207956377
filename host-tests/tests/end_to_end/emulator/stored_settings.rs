//! Stored settings of the released image, with a model of its flash interface. Settings saved over the service port survive a
//! power cycle, with any fault of the flash.

use std::os::unix::net::UnixStream;

use host_tests::addresses::{report, setting};
use host_tests::can_wire::WireFrame;
use host_tests::chance::Chance;
use host_tests::clock::Clock;
use host_tests::emulator::Extras;
use host_tests::extent;
use host_tests::flash_controller::{ErrorFlag, Fault, FlashController};
use host_tests::flash_pages::{PAGE_LEN, Tear};
use host_tests::modbus_master::Master;
use host_tests::registers::RegisterModel;
use host_tests::rig::{PATIENCE, Rig, motions};
use host_tests::terminal::Terminal;
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, EVENTS_KEPT, EventCode, FIRST_COMMAND, FIRST_SETTING, SETTINGS,
};
use wsg_bridge_fw::storage::Page;
use wsg_bridge_fw::{Config as BridgeConfig, RECIPE_COUNT};
use wsg_sim::Config;

use super::can::CanBoard;
use super::service_port::poll;
use super::{Board, RELEASED, wait_until};

/// Values of SETTINGS_FROM and SAVE_STATE (docs/registers.md).
const DELIVERED: u16 = 0;
const STORED: u16 = 1;
const DAMAGED: u16 = 5;
const SAVING: u16 = 1;
const SAVED: u16 = 2;
const FAILED: u16 = 3;

/// Length of a record in double words: header, two bytes per setting, trailer.
const RECORD: usize = 2 + SETTINGS.len().div_ceil(4);

const RECIPE_REGISTERS: usize = 4 * RECIPE_COUNT;

/// A board with its flash, a gripper, and a master on the service port.
struct Plant {
    board: Board,
    rig: Rig,
    flash: FlashController,
    service: Master,
}

impl Plant {
    /// Switches the power of a new board on.
    fn new(board: Board) -> Self {
        Self::power_up(board, board.flash())
    }

    /// Switches the power on.
    fn power_up(board: Board, flash: FlashController) -> Self {
        Self::power_up_with(board, flash, vec![])
    }

    /// Like `power_up`, with more peripherals.
    fn power_up_with(board: Board, flash: FlashController, more: Vec<Box<dyn RegisterModel>>) -> Self {
        flash.power_cycle();
        let models = flash.models().into_iter().chain(more).collect();
        let mut rig = board.rig(RELEASED, Extras { models, ..Extras::default() }, Config::default());
        let line = rig.board_mut().take_service_line().unwrap();
        let service = Master::new(line, rig.board().clock(), 1);
        Self { board, rig, flash, service }
    }

    /// Switches the power off. Checks that no motion was sent and that the driver violated no rule of the flash.
    fn power_down(self) -> FlashController {
        assert_eq!(motions(&self.rig.trace().since(0)), []);
        assert!(self.flash.violations().is_empty(), "{:?}", self.flash.violations());
        self.flash
    }

    /// Connects a terminal to the service port, in place of the master.
    fn on_cable(mut self) -> (Self, Terminal) {
        let nothing = Master::new(UnixStream::pair().unwrap().0, Clock::wall(), 1);
        let service = std::mem::replace(&mut self.service, nothing);
        (self, Terminal::to(service.into_line().unwrap()).unwrap())
    }

    fn power_cycle(self) -> Self {
        let board = self.board;
        Self::power_up(board, self.power_down())
    }

    fn settings(&mut self) -> Vec<u16> {
        self.service.read(3, FIRST_SETTING, SETTINGS.len() as u16).unwrap()
    }

    fn set_debounce(&mut self, value: u16) {
        self.service.write(setting("DEBOUNCE"), &[value]).unwrap();
    }

    fn debounce(&mut self) -> u16 {
        self.service.read(3, setting("DEBOUNCE"), 1).unwrap()[0]
    }

    /// Sets every value of every recipe.
    fn set_recipes(&mut self, value: u16) {
        self.service.write(setting("RECIPE0_WIDTH"), &[value; RECIPE_REGISTERS]).unwrap();
    }

    fn report(&mut self, name: &str) -> u16 {
        self.service.report(name).unwrap()
    }

    /// Returns code, command, value and age of each event, the latest first.
    fn events(&mut self) -> Vec<[u16; 4]> {
        let events = self.service.read(4, report("EVENT1_CODE"), 4 * EVENTS_KEPT as u16).unwrap();
        events.as_chunks().0.to_vec()
    }

    /// Returns code and value of the latest event.
    fn last_event(&mut self) -> (u16, u16) {
        let [code, _, value, _] = self.events()[0];
        (code, value)
    }

    fn command(&mut self, name: &str) {
        self.service.write(command(name), &[COMMAND_KEY]).unwrap();
    }

    /// Saves, waits for the end, and returns SAVE_STATE.
    fn save(&mut self) -> u16 {
        self.command("SAVE");
        wait_until("the save to end", || self.report("SAVE_STATE"), |state| *state != SAVING)
    }

    /// Saves until the flash model cuts the power.
    fn save_until_cut(&mut self, what: &str) {
        self.command("SAVE");
        let is_off = || {
            let (state, operations) = (self.report("SAVE_STATE"), self.flash.operations());
            let is_off = self.flash.is_off();
            assert!(is_off || state == SAVING, "{what}: {operations} operations, {:?}", self.events()[0]);
            (is_off, operations)
        };
        wait_until(&format!("a power cut: {what}"), is_off, |(is_off, _)| *is_off);
    }
}

fn command(name: &str) -> u16 {
    FIRST_COMMAND + COMMANDS.iter().position(|command| command.name == name).unwrap() as u16
}

/// Asserts that the PLC's bus runs at this rate, in bit/s, and that the bridge answers as this unit.
fn assert_bus_runs(plant: &mut Plant, unit: u8, rate: u32) {
    const BRR: u32 = 0x0C;
    let (kind, board) = (plant.board.in_qemu(), plant.rig.board_mut());
    assert_eq!(board.readl(kind.bus_uart + BRR).unwrap(), kind.bus_divider(rate));
    let mut bus = Master::new(board.take_modbus_line().unwrap(), board.clock(), unit);
    assert_eq!(bus.read(3, setting("UNIT"), 1).unwrap(), [u16::from(unit)]);
}

fn mbpoll_stores_recipes_bus_and_rate_until_defaults_is_written<C: CanBoard>() {
    let mbpoll = |cable: &Terminal, registers: &str, values: &[u16]| {
        let values: Vec<String> = values.iter().map(u16::to_string).collect();
        let values: Vec<&str> = values.iter().map(String::as_str).collect();
        poll(cable, &registers.split(' ').collect::<Vec<_>>(), &values)
    };
    let write = |cable: &Terminal, first: u16, values: &[u16]| {
        let printed = mbpoll(cable, &format!("-t 4 -r {first}"), values);
        assert!(printed.contains(&format!("Written {} references", values.len())), "{printed}");
    };
    // Run SAVE or DEFAULTS and wait for its end.
    let store = |cable: &Terminal, name: &str| {
        write(cable, command(name), &[COMMAND_KEY]);
        let read = || mbpoll(cable, "-t 3 -r 204 -c 1", &[]);
        wait_until(&format!("{name} to end"), read, |printed| printed.contains("[204]: \t2"));
    };
    let are_there = |cable: &Terminal, recipes: &[u16]| {
        let printed = mbpoll(cable, &format!("-t 4 -r {} -c 64", setting("RECIPE0_WIDTH")), &[]);
        let first = usize::from(setting("RECIPE0_WIDTH"));
        recipes
            .iter()
            .enumerate()
            .all(|(n, value)| printed.contains(&format!("[{}]: \t{value}\n", first + n)))
    };

    let (plant, cable) = Plant::new(C::BOARD).on_cable();
    let recipes: Vec<u16> = (0..RECIPE_REGISTERS as u16).map(|n| 1_000 + n).collect();
    write(&cable, setting("RECIPE0_WIDTH"), &recipes);
    write(&cable, setting("UNIT"), &[9]);
    write(&cable, setting("MODBUS_RATE"), &[384]);
    store(&cable, "SAVE");

    let (mut plant, cable) = plant.power_cycle().on_cable();
    assert!(are_there(&cable, &recipes));
    assert_bus_runs(&mut plant, 9, 38_400);
    write(&cable, setting("PLC_BUS"), &[2]);
    write(&cable, setting("CAN_RATE"), &[250]);
    write(&cable, setting("CAN_NODE"), &[5]);
    store(&cable, "SAVE");

    let can = C::new_bus(250_000);
    let master = can.join();
    let plant = Plant::power_up_with(C::BOARD, plant.power_down(), C::extras(&can).models);
    let (plant, cable) = plant.on_cable();
    assert!(are_there(&cable, &recipes));
    // Node 5's boot-up message and an SDO answer (CiA 301, 7.2.8.3.3, 7.2.4.3.5).
    let receives = |identifier, data: &[u8]| {
        let wanted = WireFrame::standard(identifier, data);
        while master.received.recv_timeout(PATIENCE).expect("a frame of node 5").id != wanted.id {}
    };
    receives(0x705, &[0]);
    master.send(WireFrame::standard(0x605, &[0x40, 0x00, 0x10, 0, 0, 0, 0, 0]));
    receives(0x585, &[]);
    assert_eq!(can.controller().rate(), 250_000);
    store(&cable, "DEFAULTS");

    let mut plant = plant.power_cycle();
    let delivered = BridgeConfig::DEFAULT;
    assert_eq!(plant.settings(), delivered.record());
    assert_eq!(plant.report("SETTINGS_FROM"), STORED);
    assert_bus_runs(&mut plant, delivered.bus.unit, delivered.bus.baud);
    plant.power_down();
}

/// Returns operations of a save, each with a kind of power cut: 200 in the full run, otherwise six.
fn cuts() -> Vec<(u32, Tear)> {
    const OPERATIONS: u32 = 1 + RECORD as u32;
    const LAST: u32 = OPERATIONS - 1;
    if extent::is_whole() {
        let tear = |n: u32| Tear::ALL[(n / OPERATIONS) as usize % Tear::ALL.len()];
        return (0..200).map(|n| (n % OPERATIONS, tear(n))).collect();
    }
    vec![
        (LAST, Tear::Complete),
        (0, Tear::Mixed),
        (1, Tear::SomeBits),
        (RECORD as u32 / 2, Tear::Unreadable),
        (LAST, Tear::Changing),
        (LAST, Tear::SeemsErased),
    ]
}

fn power_cut_in_a_save_leaves_old_or_new_settings_and_no_motion(board: Board) {
    let mut plant = Plant::new(board);
    assert_eq!((plant.report("SETTINGS_FROM"), plant.report("SAVE_STATE")), (DELIVERED, 0));
    plant.set_recipes(999);
    assert_eq!(plant.save(), SAVED);
    let mut old = plant.settings();
    // With data at the ends of both pages, each save begins with an erase: one operation, followed by the double words.
    let power_cycle = |plant: Plant| {
        let flash = plant.power_down();
        Page::ALL.into_iter().for_each(|page| flash.set(page, PAGE_LEN - 1, Some(0)));
        Plant::power_up(board, flash)
    };
    plant = power_cycle(plant);
    for (n, (operation, tear)) in (1_000..).zip(cuts()) {
        let what = format!("operation {operation}, {tear:?}");
        // Wires that are high at start-up are not edges.
        plant.rig.board().set_inputs(Inputs::FAST_STOP_OK | Inputs::HOME | Inputs::GRIP).unwrap();
        plant.set_recipes(n);
        let new = plant.settings();
        plant.flash.cut(operation, tear);
        plant.save_until_cut(&what);

        plant = power_cycle(plant);
        assert_eq!(plant.report("SETTINGS_FROM"), STORED, "{what}");
        let found = plant.settings();
        let is_last = operation == RECORD as u32;
        match tear {
            Tear::Complete if is_last => assert_eq!(found, new, "{what}"),
            Tear::Changing | Tear::Mixed if is_last => assert!(found == new || found == old, "{what}"),
            _ => assert_eq!(found, old, "{what}"),
        }
        old = found;
        if is_last && matches!(tear, Tear::Changing | Tear::Mixed) {
            // This record may or may not read back intact next time, so the next one replaces it.
            plant.set_recipes(n + 1_000);
            assert_eq!(plant.save(), SAVED, "{what}");
            old = plant.settings();
            plant = power_cycle(plant);
        }
    }
    plant.power_down();
}

fn each_flash_fault_is_reported_and_keeps_stored_settings(board: Board) {
    let mut plant = Plant::new(board);
    plant.set_debounce(7);
    assert_eq!(plant.save(), SAVED);
    assert!(plant.flash.is_at_rest());
    // The place of the next record reads as all ones but is not erased, so the other page is used.
    plant.flash.set(Page::First, RECORD, Some(u64::MAX));
    plant.set_debounce(8);
    assert_eq!((plant.save(), plant.flash.erases()), (SAVED, 2));
    // An error flag left by a boot loader.
    plant.flash.leave_open(ErrorFlag::Sequence);
    plant.set_debounce(9);
    assert_eq!(
        (plant.save(), plant.flash.erases()),
        (SAVED, 2),
        "the save must succeed at the first attempt"
    );

    let reported = ErrorFlag::ALL.into_iter().map(|flag| {
        let why = match flag {
            ErrorFlag::WriteProtection => 2,
            ErrorFlag::Programming => 3,
            _ => 4,
        };
        (Fault::Reports(flag), why)
    });
    for (value, (fault, why)) in (10..).zip(reported.chain([(Fault::LockedUp, 2)])) {
        plant.flash.set_fault(Some(fault));
        plant.set_debounce(value);
        assert_eq!((plant.save(), plant.report("SETTINGS_CHANGED")), (FAILED, 1), "{fault:?}");
        assert_eq!(plant.last_event(), (EventCode::SaveFailed as u16, why), "{fault:?}");
        assert!(plant.flash.is_at_rest(), "{fault:?}");
    }
    plant.flash.set_fault(None);
    plant.set_debounce(30);
    assert_eq!(plant.save(), SAVED, "the next save must succeed");
    plant.flash.set_fault(Some(Fault::Stuck));
    for value in 31..33 {
        plant.set_debounce(value);
        assert_eq!(plant.save(), FAILED);
        assert_eq!(plant.last_event(), (EventCode::SaveFailed as u16, 1));
    }
    plant.flash.set_fault(None);

    let mut plant = plant.power_cycle();
    assert_eq!((plant.report("SETTINGS_FROM"), plant.debounce()), (STORED, 30));
    plant.power_down();
}

fn an_unreadable_double_word_costs_its_record_and_no_start(board: Board) {
    let mut plant = Plant::new(board);
    for value in [7, 8] {
        plant.set_debounce(value);
        assert_eq!(plant.save(), SAVED);
    }
    let flash = plant.power_down();
    // Corrected bits leave a flag that would hide a later uncorrectable double word.
    (0..RECORD).for_each(|index| flash.set_correctable(Page::First, index));
    flash.set(Page::First, RECORD + 3, None);
    let mut plant = Plant::power_up(board, flash);
    assert_eq!(
        (plant.report("SETTINGS_FROM"), plant.debounce()),
        (STORED, 7),
        "the previous save must count"
    );

    // The whole other page is damaged.
    let flash = plant.power_down();
    flash.set(Page::First, 3, None);
    let mut chance = Chance::new(1);
    (0..PAGE_LEN).for_each(|index| flash.set(Page::Second, index, Some(chance.number())));
    let mut plant = Plant::power_up(board, flash);
    assert_eq!(plant.report("SETTINGS_FROM"), DAMAGED);
    let refused = [EventCode::SettingsRefused as u16, 0, DAMAGED];
    assert!(plant.events().iter().any(|event| event[..3] == refused), "{:?}", plant.events());
    assert_eq!(plant.settings(), BridgeConfig::DEFAULT.record());
    plant.set_debounce(9);
    assert_eq!(plant.save(), SAVED);
    let mut plant = plant.power_cycle();
    assert_eq!((plant.report("SETTINGS_FROM"), plant.debounce()), (STORED, 9));
    plant.power_down();
}

fn a_program_that_cannot_be_read_resets_the_board(board: Board) {
    let mut plant = Plant::new(board);
    plant.flash.set_fault(Some(Fault::UnreadableProgram));
    plant.command("SAVE");
    // QEMU exits when the firmware resets itself.
    wait_until("a reset", || plant.rig.board().now_ms().is_err(), |has_ended| *has_ended);
}

/// With one bank, which the settings cannot use, an unreadable upper half of a line is reported by another flag (RM0440, 3.7.7).
#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn nucleo_with_one_bank_starts_with_default_settings() {
    let board = Board::NUCLEO;
    let flash = board.flash();
    flash.set_single_bank();
    flash.set(Page::First, 1, None);
    let mut plant = Plant::power_up(board, flash);
    assert_eq!(plant.settings(), BridgeConfig::DEFAULT.record());
    assert_eq!(plant.save(), FAILED);
    plant.power_down();
}

on_every_board!(board_in_qemu =>
    power_cut_in_a_save_leaves_old_or_new_settings_and_no_motion,
    each_flash_fault_is_reported_and_keeps_stored_settings,
    an_unreadable_double_word_costs_its_record_and_no_start,
    a_program_that_cannot_be_read_resets_the_board,
);

mod on_can {
    use super::mbpoll_stores_recipes_bus_and_rate_until_defaults_is_written;

    on_every_board!(controller_in_qemu => mbpoll_stores_recipes_bus_and_rate_until_defaults_is_written);
}
