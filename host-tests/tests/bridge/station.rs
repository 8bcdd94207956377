//! A station uses only the lines that its settings select, with the parameters of its settings.

use bus_profibus::{Baud, Character};
use host_tests::addresses::{place, report, setting};
use host_tests::flash_model::FlashModel;
use host_tests::serial_gripper::SerialGripper;
use host_tests::world::World;
use host_tests::world::profibus::sd2;
use wsg_bridge_fw::can::DEFAULT_NODE;
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::plc::canopen::NmtState;
use wsg_bridge_fw::plc::{Action, UartStatus};
use wsg_bridge_fw::registers::{FIRST_SETTING, Record};
use wsg_bridge_fw::{Config, GripperLine, PlcBus, ResetCause};
use wsg_protocol::CommandId;
use wsg_protocol::can::Identifiers;

struct TestRig {
    rig: World,
    /// Identifiers of the frames sent on CAN.
    on_can: Vec<u16>,
}

impl TestRig {
    fn new(config: &Config) -> Self {
        let gripper = SerialGripper::new(wsg_sim::Config::default());
        let mut rig = World::with(*config, gripper, FlashModel::new(), ResetCause::Pin);
        rig.set(Inputs::FAST_STOP_OK, true);
        Self { rig, on_can: Vec::new() }
    }

    /// Advances the time, with the wires at rest.
    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.rig.step();
            if self.rig.config.plc_bus == PlcBus::Profibus {
                self.handle(None, self.rig.now_ms() * 1_000);
            }
            self.on_can.extend(self.rig.can.take_frames().into_iter().map(|(_, id, _)| id));
        }
    }

    fn handle(&mut self, received: Option<Character>, now_us: u32) -> Action {
        let status = UartStatus { received, has_room: true, is_complete: true };
        self.rig.interrupt(status, now_us)
    }

    /// Returns whether this station responds to FDL_Status.
    fn is_on_profibus(&mut self, station: u8) -> bool {
        self.telegram(&[0x10, station, 2, 0x49, station.wrapping_add(2 + 0x49), 0x16])
    }

    /// Sends a telegram at 19 200 bit/s after a silence. Returns whether it is answered.
    fn telegram(&mut self, bytes: &[u8]) -> bool {
        self.rig.skip_ms(1_000);
        let mut now_us = self.rig.now_ms() * 1_000;
        let mut wait_us = None;
        for byte in bytes {
            now_us += 573;
            wait_us = self.handle(Some(Character::Byte(*byte)), now_us).wait_us;
        }
        let Some(wait_us) = wait_us else { return false };
        now_us += wait_us;
        while self.handle(None, now_us).send.is_some() {}
        true
    }

    /// Reads a unit's register over Modbus RTU with FC 3 or 4.
    fn register(&mut self, unit: u8, function: u8, address: u16) -> Option<u16> {
        let [high, low] = address.to_be_bytes();
        self.rig.modbus.ask(&[unit, function, high, low, 0, 1]);
        self.pass(3);
        self.rig.modbus.answered()
    }

    /// Sends a request over the service port.
    fn service(&mut self, request: &[u8]) -> Option<u16> {
        self.rig.service.ask(request);
        self.pass(3);
        self.rig.service.answered()
    }
}

fn with(changes: &[(&str, u16)]) -> Config {
    let mut record: Record = Config::DEFAULT.record();
    for (name, value) in changes {
        record[place(name)] = *value;
    }
    Config::from_record(&record).unwrap()
}

#[test]
fn only_the_lines_that_the_settings_select_are_used() {
    let to_gripper = Identifiers::DEFAULT.controller().transmit.as_raw();
    let boot_up = 0x700 | u16::from(DEFAULT_NODE.node);
    for gripper_line in [GripperLine::Serial, GripperLine::Can] {
        for plc_bus in [PlcBus::Off, PlcBus::Modbus, PlcBus::Canopen, PlcBus::Profibus] {
            let mut rig = TestRig::new(&Config { gripper_line, plc_bus, ..Config::DEFAULT });
            rig.pass(50);
            let is_on_can = gripper_line == GripperLine::Can;
            let is_canopen = plc_bus == PlcBus::Canopen;
            let what = format!("{gripper_line:?}, {plc_bus:?}");
            assert_eq!(rig.rig.take_sent().is_empty(), is_on_can, "{what}");
            assert_eq!(rig.on_can.contains(&to_gripper), is_on_can, "{what}");
            assert_eq!(rig.on_can.contains(&boot_up), is_canopen, "{what}");
            assert_eq!(rig.rig.node().state() == NmtState::PreOperational, is_canopen, "{what}");
            assert_eq!(rig.rig.station().uses_can(), is_on_can || is_canopen, "{what}");
            let is_answered = rig.register(1, 3, FIRST_SETTING).is_some();
            assert_eq!(is_answered, plc_bus == PlcBus::Modbus, "{what}");
            assert_eq!(rig.rig.rate().is_some(), plc_bus == PlcBus::Profibus, "{what}");
        }
    }
}

#[test]
fn service_port_is_available_with_any_settings() {
    for gripper_line in [GripperLine::Serial, GripperLine::Can] {
        for plc_bus in [PlcBus::Off, PlcBus::Modbus, PlcBus::Canopen, PlcBus::Profibus] {
            let changes = [("UNIT", 9), ("BUS_CHAR_TIMEOUT", 0), ("SWAP_BYTES", 1), ("MODBUS_RATE", 12)];
            let config = Config { gripper_line, plc_bus, ..with(&changes) };
            let mut rig = TestRig::new(&config);
            let what = format!("{gripper_line:?}, {plc_bus:?}");
            assert_eq!(rig.service(&[1, 3, 0, 100, 0, 1]), Some(9), "{what}");
            rig.service(&[1, 6, 0, 100, 0, 7]);
            assert_eq!(rig.service(&[1, 3, 0, 100, 0, 1]), Some(7), "{what}");
            assert_eq!(rig.service(&[9, 3, 0, 100, 0, 1]), None, "{what}: the port's address is 1");
        }
    }
}

#[test]
fn settings_of_the_record_apply_from_the_start() {
    let mut rig = TestRig::new(&with(&[("UNIT", 5), ("MODBUS_RATE", 1_152), ("RECIPE2_WIDTH", 33_00)]));
    rig.pass(10);
    assert_eq!(rig.register(1, 3, FIRST_SETTING), None, "address of another unit");
    assert_eq!(rig.register(5, 3, FIRST_SETTING), Some(5));
    assert_eq!(rig.register(5, 3, setting("RECIPE2_WIDTH")), Some(33_00));
    assert_eq!(rig.register(5, 4, report("BUS_RATE")), Some(1_152));
    assert_eq!(rig.register(5, 4, report("RESET_CAUSE")), Some(ResetCause::Pin as u16));
}

#[test]
fn request_ends_after_the_silence_of_the_records_rate() {
    for (rate, silence_us) in [(96, 4_011), (192, 2_006), (384, 1_750)] {
        let mut rig = TestRig::new(&with(&[("MODBUS_RATE", rate), ("BUS_CHAR_TIMEOUT", 0)]));
        let mut is_answered_after = |silence_us: u32| {
            rig.rig.modbus.ask(&[1, 3, 0, FIRST_SETTING as u8, 0, 1]);
            // The turn adds a millisecond.
            rig.rig.modbus.silence_us = silence_us - 1_000;
            rig.pass(1);
            rig.rig.modbus.answered().is_some()
        };
        assert!(!is_answered_after(silence_us - 10) && is_answered_after(silence_us), "{rate}00 bit/s");
    }
}

#[test]
fn identifiers_and_nodes_of_the_record_are_used_on_the_bus() {
    let changes = [("GRIPPER_LINE", 1), ("PLC_BUS", 2), ("CAN_ID", 0x140), ("CAN_NODE", 5)];
    let mut rig = TestRig::new(&with(&changes));
    rig.pass(50);
    rig.on_can.sort_unstable();
    rig.on_can.dedup();
    assert!(rig.on_can.starts_with(&[0x140]) && rig.on_can.contains(&0x705), "{:x?}", rig.on_can);
}

#[test]
fn address_and_rate_of_the_record_are_used_on_profibus() {
    let changes = [("PLC_BUS", 3), ("PROFIBUS_ADDRESS", 9), ("PROFIBUS_RATE", 192)];
    let mut rig = TestRig::new(&with(&changes));
    rig.pass(1_000);
    assert_eq!(rig.rig.rate(), Some(Baud::K19_2), "no other rate is tried");
    assert!(!rig.is_on_profibus(7) && rig.is_on_profibus(9));
}

#[test]
fn service_port_reports_the_state_of_profibus() {
    let mut rig = TestRig::new(&with(&[("PLC_BUS", 3), ("PROFIBUS_RATE", 192)]));
    rig.pass(10);
    let first = report("PROFIBUS_STATE");
    let reports = |rig: &mut TestRig| {
        rig.pass(2);
        [0, 1, 2, 3].map(|n| {
            let [high, low] = (first + n).to_be_bytes();
            rig.service(&[1, 4, high, low, 0, 1]).unwrap()
        })
    };
    assert_eq!(reports(&mut rig), [1, 192, 0, 0], "no telegrams received");
    assert!(rig.is_on_profibus(7));
    assert_eq!(reports(&mut rig), [2, 192, 1, 0]);
    assert!(!rig.telegram(&[0x10, 7, 2, 0x49, 0x53, 0x16]), "a wrong checksum");
    assert_eq!(reports(&mut rig), [2, 192, 1, 1]);
    assert!(rig.telegram(&sd2(&[0x87, 0x82, 0x6D, 61, 62, 0x80, 0, 0, 11, 0x55, 0x55, 0])));
    assert_eq!(reports(&mut rig), [3, 192, 2, 1]);
    assert!(rig.telegram(&sd2(&[0x87, 0x82, 0x5D, 62, 62, 0xA7, 0x9B])));
    assert_eq!(reports(&mut rig), [4, 192, 3, 1]);
    rig.pass(6_000);
    assert_eq!(reports(&mut rig)[0], 1, "no more telegrams");
    let mut rig = TestRig::new(&Config::DEFAULT);
    assert_eq!(reports(&mut rig), [0; 4], "another bus");
}

#[test]
fn wires_are_debounced_with_the_time_of_the_record() {
    for (debounce_ms, bounds) in [(2, 2..10), (200, 200..210)] {
        let mut rig = TestRig::new(&with(&[("DEBOUNCE", debounce_ms)])).rig;
        rig.get_ready();
        // The only effect of a further STOP/ACK is a Stop.
        rig.pass(500);
        rig.take_sent();
        rig.set(Inputs::STOP_ACK, true);
        let stopped = (0..500).find(|_| {
            rig.step();
            rig.take_sent().contains(&CommandId::Stop)
        });
        assert!(stopped.is_some_and(|ms| bounds.contains(&ms)), "after {debounce_ms} ms: {stopped:?}");
    }
}
