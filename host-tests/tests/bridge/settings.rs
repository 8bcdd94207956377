//! Persistent settings: SAVE, RESTORE, DEFAULTS, the selection at a start, and recipes for the bus.

use std::ops::{Deref, DerefMut};

use host_tests::addresses::{place, report, setting};
use host_tests::flash_model::{Fault, FlashModel, Tear};
use host_tests::serial_gripper::SerialGripper;
use host_tests::world::modbus::Master;
use host_tests::world::{World, quick};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::registers::{COMMAND_KEY, COMMANDS, EventCode, FIRST_COMMAND, Record};
use wsg_bridge_fw::storage::Page;
use wsg_bridge_fw::{Config, ResetCause};
use wsg_fieldbus::CommandFlags;
use wsg_protocol::{CommandId, Kind};

/// A station with a master on the service port and one on the PLC's bus.
struct Plant(Master);

impl Deref for Plant {
    type Target = Master;

    fn deref(&self) -> &Master {
        &self.0
    }
}

impl DerefMut for Plant {
    fn deref_mut(&mut self) -> &mut Master {
        &mut self.0
    }
}

impl Plant {
    fn start(flash: FlashModel) -> Self {
        Self::delivered_with(&Config::DEFAULT.record(), flash)
    }

    fn delivered_with(delivered: &Record, flash: FlashModel) -> Self {
        let delivered = Config::from_record(delivered).expect("the settings are valid");
        let gripper = SerialGripper::new(quick());
        Self(Master::of(World::with(delivered, gripper, flash, ResetCause::PowerOn)))
    }

    /// Restarts the board after a power cycle. The gripper restarts, too.
    fn restart(self) -> Self {
        Self::start(self.0.into_world().flash)
    }

    fn read(&mut self, function: u8, address: u16) -> u16 {
        self.by_service(|master| master.registers(function, address, 1)).expect("the register exists")[0]
    }

    fn setting(&mut self, name: &str) -> u16 {
        self.read(3, setting(name))
    }

    fn set(&mut self, name: &str, value: u16) {
        assert_eq!(self.write_register(setting(name), value), Ok(()), "{name}");
    }

    fn write_register(&mut self, address: u16, value: u16) -> Result<(), u8> {
        self.by_service(|master| master.set_register(address, value))
    }

    fn report(&mut self, name: &str) -> u16 {
        self.read(4, report(name))
    }

    fn command(&mut self, name: &str) -> Result<(), u8> {
        self.write_register(command(name), COMMAND_KEY)
    }

    /// Writes the output image over the PLC's bus.
    fn write_image(&mut self, flags: CommandFlags, [width, speed, force]: [u16; 3]) {
        self.write(0, &[u16::from(flags.bits()) << 8, width, speed, force]);
        self.pass(10);
    }

    /// Acknowledges the FAST STOP of power-up and homes, by wires.
    fn get_ready(&mut self) {
        self.pass(300);
        for wire in [Inputs::STOP_ACK, Inputs::HOME] {
            self.inputs |= wire;
            self.pass(100);
            self.inputs -= wire;
            self.pass(1_500);
        }
        assert!(self.outputs().contains(Outputs::READY | Outputs::REFERENCED), "{:?}", self.outputs());
        self.take_sent();
    }

    fn has_moved(&self) -> bool {
        self.far.sent().iter().any(|id| id.kind() == Kind::Motion)
    }
}

fn command(name: &str) -> u16 {
    FIRST_COMMAND + COMMANDS.iter().position(|command| command.name == name).expect("a command") as u16
}

#[test]
fn only_saved_settings_apply_after_a_power_cycle() {
    let mut plant = Plant::start(FlashModel::new());
    assert_eq!((plant.report("SETTINGS_FROM"), plant.report("SAVE_STATE")), (0, 0));
    let recipes: Vec<u16> = (0..64).map(|n| 1_000 + n).collect();
    for (n, value) in recipes.iter().enumerate() {
        assert_eq!(plant.write_register(setting("RECIPE0_WIDTH") + n as u16, *value), Ok(()));
    }
    plant.set("PLC_BUS", 2);
    plant.set("CAN_RATE", 250);
    plant.set("CAN_NODE", 5);
    assert_eq!(plant.report("SETTINGS_CHANGED"), 1);
    assert_eq!(plant.command("SAVE"), Ok(()));
    plant.pass(500);
    assert_eq!((plant.report("SAVE_STATE"), plant.report("SETTINGS_CHANGED")), (2, 0));
    plant.set("RECIPE15_RELEASE", 7_777);
    assert_eq!(plant.config.plc_bus as u16, 1, "a start setting takes effect at a start");

    let mut plant = plant.restart();
    assert_eq!((plant.report("SETTINGS_FROM"), plant.report("SETTINGS_CHANGED")), (1, 0));
    let there: Vec<u16> = (0..64).map(|n| plant.read(3, setting("RECIPE0_WIDTH") + n)).collect();
    assert_eq!(there, recipes, "changes after the save are lost");
    let Config { plc_bus, can, .. } = plant.config;
    assert_eq!((plc_bus as u16, can.kbit_rate, can.node.node), (2, 250, 5));
}

#[test]
fn restore_applies_stored_settings_and_defaults_those_of_image() {
    let mut delivered = Config::DEFAULT.record();
    delivered[place("DEBOUNCE")] = 9;
    let mut plant = Plant::delivered_with(&delivered, FlashModel::new());
    plant.set("DEBOUNCE", 50);
    assert_eq!(plant.command("RESTORE"), Ok(()));
    assert_eq!(plant.setting("DEBOUNCE"), 9, "only the image's settings exist");
    plant.set("DEBOUNCE", 60);
    assert_eq!(plant.command("SAVE"), Ok(()));
    plant.pass(500);
    plant.set("DEBOUNCE", 70);
    assert_eq!(plant.command("RESTORE"), Ok(()));
    assert_eq!(plant.setting("DEBOUNCE"), 60);
    assert_eq!(plant.command("DEFAULTS"), Ok(()));
    plant.pass(500);
    assert_eq!((plant.setting("DEBOUNCE"), plant.report("SAVE_STATE")), (9, 2));
    let mut plant = Plant::delivered_with(&Config::DEFAULT.record(), plant.0.into_world().flash);
    assert_eq!((plant.setting("DEBOUNCE"), plant.report("SETTINGS_FROM")), (9, 1), "the defaults are stored");
}

#[test]
fn command_registers_accept_only_their_key_and_only_at_rest() {
    let mut plant = Plant::start(FlashModel::new());
    plant.get_ready();
    for name in ["SAVE", "RESTORE", "DEFAULTS"] {
        assert_eq!(plant.read(3, command(name)), 0);
        for wrong in [0, 1, COMMAND_KEY - 1, COMMAND_KEY.swap_bytes(), u16::MAX] {
            assert_eq!(plant.write_register(command(name), wrong), Err(3), "{name} {wrong}");
        }
    }
    let [high, low] = command("SAVE").to_be_bytes();
    let [k1, k0] = COMMAND_KEY.to_be_bytes();
    assert_eq!(
        plant.by_service(|master| master.data(&[16, high, low, 0, 2, 4, k1, k0, k1, k0])),
        Err(3),
        "two commands at once"
    );
    assert_eq!(plant.report("SAVE_STATE"), 0);

    plant.inputs |= Inputs::MOVE;
    plant.pass(20);
    assert!(plant.outputs().contains(Outputs::BUSY));
    for name in ["SAVE", "RESTORE", "DEFAULTS"] {
        assert_eq!(plant.command(name), Err(6), "{name} during a motion");
    }
    plant.pass(2_000);
    // The connection is lost during a motion.
    plant.inputs -= Inputs::MOVE;
    plant.pass(20);
    plant.set("RECIPE0_WIDTH", 60_00);
    plant.inputs |= Inputs::MOVE;
    plant.pass(20);
    assert!(plant.outputs().contains(Outputs::BUSY));
    plant.set_cut(true);
    plant.pass(2_000);
    assert_eq!(plant.outputs(), Outputs::ERROR);
    for name in ["SAVE", "RESTORE", "DEFAULTS"] {
        assert_eq!(plant.command(name), Err(6), "{name} while the fingers may move");
    }
    assert_eq!(plant.write_register(setting("DEBOUNCE"), 3), Err(6));
    plant.set_cut(false);
    plant.pass(2_000);
    // At rest, a lost connection does not matter.
    plant.set_cut(true);
    plant.pass(2_000);
    plant.set("DEBOUNCE", 2);
    plant.set_cut(false);
    plant.pass(2_000);
    // Each operation takes long.
    plant.flash.busy_polls = 20;
    assert_eq!(plant.command("SAVE"), Ok(()));
    assert_eq!(plant.report("SAVE_STATE"), 1);
    assert_eq!(plant.command("SAVE"), Err(6));
    assert_eq!(plant.write_register(setting("DEBOUNCE"), 3), Err(6));
    plant.pass(3_000);
    assert_eq!(plant.report("SAVE_STATE"), 2);
    assert_eq!(plant.flash.erases, [1, 0], "saved only once");
}

#[test]
fn bus_and_port_requests_in_one_turn_are_executed_or_refused() {
    let by_service = |plant: &mut Plant, address: u16, value: u16| {
        let ([a1, a0], [v1, v0]) = (address.to_be_bytes(), value.to_be_bytes());
        plant.service.ask(&[1, 6, a1, a0, v1, v0]);
    };
    for (address, value) in [(command("SAVE"), COMMAND_KEY), (setting("DEBOUNCE"), 7)] {
        let mut plant = Plant::start(FlashModel::new());
        plant.set("DEBOUNCE", 50);
        let ([a1, a0], [k1, k0]) = (command("DEFAULTS").to_be_bytes(), COMMAND_KEY.to_be_bytes());
        plant.modbus.ask(&[1, 6, a1, a0, k1, k0]);
        by_service(&mut plant, address, value);
        plant.pass(1);
        assert_eq!(plant.modbus.answer().map(|answer| answer[1]), Some(6));
        assert_eq!(plant.service.answer().map(|answer| answer[1..3].to_vec()), Some(vec![0x86, 6]));
        plant.pass(500);
        assert_eq!((plant.setting("DEBOUNCE"), plant.report("SAVE_STATE")), (2, 2));
        by_service(&mut plant, address, value);
        plant.pass(5);
        assert_eq!(plant.service.answer().map(|answer| answer[1]), Some(6), "after completion");
    }
}

#[test]
fn save_does_not_delay_a_fast_stop() {
    let ms_to_fast_stop = |save: bool| {
        let mut plant = Plant::start(FlashModel::new());
        plant.get_ready();
        plant.flash.fault = Some(Fault::Stuck);
        if save {
            assert_eq!(plant.command("SAVE"), Ok(()));
        }
        plant.inputs -= Inputs::FAST_STOP_OK;
        let ms = (0..50).find(|_| {
            plant.pass(1);
            plant.far.sent().contains(&CommandId::FastStop)
        });
        assert_eq!(plant.report("SAVE_STATE"), u16::from(save), "the save is still running");
        ms.expect("FAST STOP")
    };
    assert_eq!(ms_to_fast_stop(true), ms_to_fast_stop(false));
}

#[test]
fn power_cut_leaves_old_or_new_settings_and_causes_no_motion() {
    let mut saved = Plant::start(FlashModel::new());
    saved.set("RECIPE0_WIDTH", 1_111);
    saved.set("RECIPE15_RELEASE", 1_111);
    assert_eq!(saved.command("SAVE"), Ok(()));
    saved.pass(500);
    let image = [
        saved.config.recipes[0].width.cast_unsigned(),
        saved.config.recipes[15].release_width.cast_unsigned(),
    ];
    // The first save, and one after it.
    for (flash, from, old) in [(FlashModel::new(), 0, image), (saved.0.into_world().flash, 1, [1_111; 2])] {
        for (tear, cut) in Tear::ALL.into_iter().flat_map(|tear| (0..40).map(move |cut| (tear, cut))) {
            let mut plant = Plant::start(flash.clone());
            plant.set("RECIPE0_WIDTH", 2_222);
            plant.set("RECIPE15_RELEASE", 2_222);
            plant.flash.cut = Some((plant.flash.operations + cut, tear));
            assert_eq!(plant.command("SAVE"), Ok(()));
            plant.pass(100);
            let was_cut = plant.flash.is_off();
            let mut plant = plant.restart();
            plant.pass(50);
            let pair = [plant.setting("RECIPE0_WIDTH"), plant.setting("RECIPE15_RELEASE")];
            let found = (pair, plant.report("SETTINGS_FROM"));
            let permitted = [([2_222; 2], 1), (old, from)];
            assert!(permitted.contains(&found), "{tear:?} at {cut}: {found:?}");
            assert!(was_cut || found == permitted[0], "{tear:?} at {cut}");
            assert!(!plant.has_moved());
        }
    }
}

#[test]
fn unusable_settings_block_motions_until_others_are_stored() {
    let delivered = Config::DEFAULT.record();
    let mut wrong = delivered;
    wrong[place("CAN_RATE")] = 300;
    let mut damaged = FlashModel::with_record(1, &delivered);
    damaged.set(Page::First, 3, None);
    let longer = [&delivered[..], &[1]].concat();
    for (flash, from) in [
        (FlashModel::with_record(2, &delivered), 3),
        (FlashModel::with_record(1, &longer), 3),
        (FlashModel::with_record(1, &wrong), 4),
        (damaged, 5),
    ] {
        let mut plant = Plant::start(flash);
        plant.pass(300);
        plant.inputs |= Inputs::STOP_ACK;
        plant.pass(100);
        plant.inputs -= Inputs::STOP_ACK;
        plant.pass(200);
        assert_eq!(plant.report("SETTINGS_FROM"), from);
        assert_eq!(plant.report("ERROR_CAUSE"), EventCode::SettingsRefused as u16);
        assert_eq!(plant.outputs() & (Outputs::READY | Outputs::ERROR), Outputs::ERROR);
        // By the bus alone, then by both.
        plant.write_image(CommandFlags::empty(), [20_00, 50_00, 40_00]);
        plant.write_image(CommandFlags::HOMING | CommandFlags::JOG_PLUS, [20_00, 50_00, 40_00]);
        plant.pass(200);
        assert!(!plant.has_moved(), "{:?}", plant.far.sent());
        plant.inputs |= Inputs::HOME;
        plant.pass(200);
        assert!(!plant.has_moved(), "{:?}", plant.far.sent());

        // DEFAULTS ends the block. Flags and wires held in the meantime give no edge.
        assert_eq!(plant.command("DEFAULTS"), Ok(()));
        plant.pass(500);
        assert_eq!((plant.report("SAVE_STATE"), plant.report("SETTINGS_FROM")), (2, 1));
        plant.write_image(CommandFlags::HOMING | CommandFlags::JOG_PLUS, [20_00, 50_00, 40_00]);
        plant.pass(500);
        assert!(!plant.has_moved(), "{:?}", plant.far.sent());
        plant.inputs -= Inputs::HOME;
        plant.pass(200);
        plant.inputs |= Inputs::HOME;
        plant.pass(200);
        assert!(plant.far.sent().contains(&CommandId::Homing), "a new edge takes effect");
    }
}

/// Records of released and earlier images: the double words of the flash, and the settings that they hold. A MAP_VERSION with
/// other settings adds a file.
const RECORDED: [&str; 2] = [include_str!("records/map-5.txt"), include_str!("records/map-7.txt")];

#[test]
fn settings_of_each_map_version_are_read_and_stored_again() {
    for recorded in RECORDED {
        let mut flash = FlashModel::new();
        let mut next = 0;
        let mut settings = Vec::new();
        for line in recorded.lines() {
            match line.split(' ').collect::<Vec<_>>()[..] {
                ["flash", "1", word] => {
                    flash.set(Page::First, next, Some(u64::from_str_radix(word, 16).unwrap()));
                    next += 1;
                }
                ["setting", name, value] => settings.push((name, value.parse::<u16>().unwrap())),
                _ => assert!(line.starts_with("# "), "{line}"),
            }
        }
        assert!(next > 20 && settings.len() > 80);
        let mut plant = Plant::start(flash);
        // 1: stored; 2: stored by older firmware.
        let from = if settings.len() == Config::DEFAULT.record().len() { 1 } else { 2 };
        assert_eq!(plant.report("SETTINGS_FROM"), from);
        for (name, value) in &settings {
            assert_eq!(plant.setting(name), *value, "{name}");
        }
        plant.set("DEBOUNCE", 8);
        assert_eq!(plant.command("SAVE"), Ok(()));
        plant.pass(500);
        let mut plant = plant.restart();
        assert_eq!((plant.report("SETTINGS_FROM"), plant.setting("DEBOUNCE")), (1, 8));
        assert_eq!(plant.setting("RECIPE15_RELEASE"), 1_072);
    }
}

#[test]
fn settings_of_map_version_5_take_profibus_ones_from_the_image() {
    let at = |name| place(name);
    let mut delivered = Config::DEFAULT.record();
    delivered[at("PROFIBUS_ADDRESS")] = 9;
    delivered[at("PROFIBUS_RATE")] = 5_000;
    let mut older = Config::DEFAULT.record();
    older[at("CAN_MASTER")] = 0x7E;
    // Registers 100 to 181.
    let mut plant = Plant::delivered_with(&delivered, FlashModel::with_record(1, &older[..82]));
    assert_eq!((plant.setting("CAN_MASTER"), plant.report("SETTINGS_FROM")), (0x7E, 2));
    assert_eq!((plant.setting("PROFIBUS_ADDRESS"), plant.setting("PROFIBUS_RATE")), (9, 5_000));
    assert_eq!(plant.command("SAVE"), Ok(()));
    plant.pass(500);
    let mut plant = plant.restart();
    assert_eq!(
        (plant.report("SETTINGS_FROM"), plant.setting("PROFIBUS_ADDRESS")),
        (1, 9),
        "stored together with the others"
    );
}

#[test]
fn flash_failure_is_reported_and_the_settings_in_ram_stay() {
    let cases =
        [(Fault::Stuck, 0, 1), (Fault::Protected, 0, 2), (Fault::Worn(3), 0, 5), (Fault::Swallows(0), 6, 5)];
    for (fault, from, why) in cases {
        let mut flash = FlashModel::new();
        flash.fault = Some(fault);
        let mut plant = Plant::start(flash);
        plant.set("DEBOUNCE", 7);
        assert_eq!(plant.report("SETTINGS_FROM"), from, "{fault:?}");
        assert_eq!(plant.command("SAVE"), Ok(()));
        plant.pass(1_000);
        assert_eq!(plant.report("SAVE_STATE"), 3, "{fault:?}");
        assert_eq!((plant.setting("DEBOUNCE"), plant.report("SETTINGS_CHANGED")), (7, 1));
        let event = (plant.report("EVENT1_CODE"), plant.report("EVENT1_VALUE"));
        assert_eq!(event, (EventCode::SaveFailed as u16, why), "{fault:?}");
    }
}

#[test]
fn motion_in_the_turn_of_a_store_command_begins_after_it() {
    let mut plant = Plant::start(FlashModel::new());
    plant.get_ready();
    plant.set("RECIPE12_WIDTH", 33_00);
    plant.set("BUS_TIMEOUT", 0);
    plant.set("BUS_RECIPE", 12);
    plant.write_image(CommandFlags::empty(), [44_00, 50_00, 40_00]);
    plant.write_image(CommandFlags::MOVE, [44_00, 50_00, 40_00]);
    plant.write_image(CommandFlags::empty(), [44_00, 50_00, 40_00]);
    plant.pass(2_000);
    assert_eq!(plant.read(4, 3), 33_00, "the settings take effect when written");
    plant.take_sent();
    let [high, low] = command("DEFAULTS").to_be_bytes();
    let [key_high, key_low] = COMMAND_KEY.to_be_bytes();
    plant.modbus.ask(&[1, 6, high, low, key_high, key_low]);
    let mut write = vec![1, 16, 0, 0, 0, 4, 8, CommandFlags::MOVE.bits(), 0];
    write.extend([44_00, 50_00, 40_00].into_iter().flat_map(u16::to_be_bytes));
    plant.modbus.ask(&write);
    plant.pass(1);
    assert!(!plant.has_moved(), "settings never change during a motion");
    plant.pass(2_000);
    assert_eq!(plant.take_motions(), [CommandId::PrePosition]);
    assert_eq!(plant.read(4, 3), 44_00, "by default, no recipe applies to the bus");
}
