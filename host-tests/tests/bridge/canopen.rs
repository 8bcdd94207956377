//! A PLC on CAN, in virtual time. The third-party library `canopen-rs` encodes and decodes the master's frames.

use std::ops::{Deref, DerefMut};

use bus_slcan::ClassicFrame;
use canopen_rs::emcy::EmergencyMessage;
use canopen_rs::{Address, DataType as Theirs, NmtCommand, NodeId, Value, nmt, sdo};
use document::hold_file;
use embedded_can::{Frame, StandardId};
use host_tests::addresses;
use host_tests::flash_model::Fault;
use host_tests::serial_gripper::SerialLine;
use host_tests::world::canopen::{self, NODE};
use host_tests::world::plc::PARAMETERS;
use host_tests::world::{BOARD, World};
use wsg_bridge_fw::can::{CanNode, Health, collides_with_canopen};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::plc::canopen::{
    DataType, FAULTS, NmtState, Node, OBJECTS, REPORTS_INDEX, SETTINGS_INDEX, write_eds,
};
use wsg_bridge_fw::registers::{FIRST_REPORT, FIRST_SETTING, MAP_VERSION, REPORTS, SETTINGS};
use wsg_bridge_fw::{Bridge, ControlSource, PlcBus};
use wsg_fieldbus::{CommandFlags as Cmd, GripperFlags, OutputImage};
use wsg_protocol::can::Identifiers;
use wsg_protocol::{CommandId, Instant, SystemFlags};
use wsg_sim::{Config, Part};

/// Default of BUS_TIMEOUT.
const TIMEOUT_MS: u32 = 1_000;

/// A master that also transfers SDOs.
struct Master(canopen::Master);

impl Deref for Master {
    type Target = canopen::Master;

    fn deref(&self) -> &canopen::Master {
        &self.0
    }
}

impl DerefMut for Master {
    fn deref_mut(&mut self) -> &mut canopen::Master {
        &mut self.0
    }
}

impl Master {
    fn new(config: Config) -> Self {
        Self(canopen::Master::of(World::with_node(config, NODE)))
    }

    /// Returns a master of an operational node: connected, FAST STOP acknowledged, homed. The heartbeat is sent
    /// automatically.
    fn homed(part: Option<f32>, time_scale: f32) -> Self {
        let part = part.map(|width| Part::of_width(width).unwrap());
        let mut master = Self::new(Config { part, time_scale, ..Config::default() });
        master.world.can.beats = true;
        master.pass(500);
        master.start();
        master.command(Cmd::empty());
        master.command(Cmd::STOP_ACK);
        master.command(Cmd::HOMING);
        master.until(20_000, |master| {
            master.state() == GripperFlags::IDLE && master.system().contains(SystemFlags::REFERENCED)
        });
        master.command(Cmd::empty());
        master.world.take_motions();
        master
    }

    /// Returns a master like [`homed`](Self::homed), during a MOVE.
    fn moving() -> Self {
        let mut master = Self::homed(None, 1.0);
        master.command(Cmd::MOVE);
        master.until(1_000, |master| master.system().contains(SystemFlags::MOVING));
        master.world.take_sent();
        master
    }

    fn start(&mut self) {
        self.command_node(NmtCommand::StartRemoteNode);
    }

    fn command_node(&mut self, command: NmtCommand) {
        let frame = nmt::encode_command(command, NodeId::new(NODE.node).unwrap());
        self.send(0, &frame);
        self.pass(5);
    }

    /// Writes the output image.
    fn command(&mut self, flags: Cmd) {
        self.image = OutputImage { flags, ..PARAMETERS };
        self.write_image();
    }

    /// Returns codes and error registers of the emergencies received since the last call.
    fn emergencies(&mut self) -> Vec<(u16, u8)> {
        let frames = self.take(0x080);
        let decoded = frames.iter().map(|(_, data)| EmergencyMessage::decode(data).unwrap());
        decoded.map(|message| (message.error_code, message.error_register.0)).collect()
    }

    fn transfer(&mut self, request: &[u8; 8]) -> [u8; 8] {
        self.take(0x580);
        self.send(0x600 | u16::from(NODE.node), request);
        self.pass(5);
        let answers = self.take(0x580);
        assert_eq!(answers.len(), 1, "one answer to {request:02X?}");
        answers[0].1[..].try_into().unwrap()
    }

    fn upload(&mut self, index: u16, sub: u8, kind: Theirs) -> Result<Value, u32> {
        let answer = self.transfer(&sdo::encode_upload_request(Address::new(index, sub)));
        match sdo::decode_abort(&answer) {
            Ok((_, code)) => Err(code),
            Err(_) => {
                let (address, value) = sdo::decode_upload_expedited_response(&answer, kind).unwrap();
                assert_eq!(address, Address::new(index, sub));
                Ok(value)
            }
        }
    }

    fn read_u16(&mut self, index: u16, sub: u8) -> u16 {
        match self.upload(index, sub, Theirs::Unsigned16) {
            Ok(Value::Unsigned16(value)) => value,
            other => panic!("{index:X}h sub {sub}: {other:?}"),
        }
    }

    fn download(&mut self, index: u16, sub: u8, value: Value) -> Result<(), u32> {
        let address = Address::new(index, sub);
        let answer = self.transfer(&sdo::encode_download_expedited(address, &value).unwrap());
        match sdo::decode_abort(&answer) {
            Ok((_, code)) => Err(code),
            Err(_) => {
                assert_eq!(sdo::decode_download_response(&answer).unwrap(), address);
                Ok(())
            }
        }
    }

    /// Writes to 1010h or 1011h, and waits for the response up to a client's usual time-out.
    fn store(&mut self, object: u16, signature: Value) -> Result<(), u32> {
        self.take(0x580);
        self.send(0x600 | u16::from(NODE.node), &sdo_request(object, signature));
        for _ in 0..500 {
            self.pass(1);
            if let Some((_, answer)) = self.take(0x580).pop() {
                let abort = sdo::decode_abort(answer[..].try_into().unwrap());
                return abort.map_or(Ok(()), |(_, code)| Err(code));
            }
        }
        panic!("no answer")
    }
}

/// Returns a write to subindex 1.
fn sdo_request(index: u16, value: Value) -> [u8; 8] {
    sdo::encode_download_expedited(Address::new(index, 1), &value).unwrap()
}

fn setting(name: &str) -> u8 {
    (1 + addresses::setting(name) - FIRST_SETTING) as u8
}

fn report(name: &str) -> u8 {
    (1 + addresses::report(name) - FIRST_REPORT) as u8
}

fn code_of(meaning: &str) -> u16 {
    FAULTS.iter().find(|fault| fault.meaning.contains(meaning)).expect("a fault of this meaning").code
}

#[test]
fn all_edges_within_one_millisecond_take_effect() {
    let mut master = Master::homed(None, 10.0);
    let id = 0x200 | u16::from(NODE.node);
    let image = |flags: Cmd| [flags.bits(), 0, 0xD0, 0x07, 0x88, 0x13, 0xA0, 0x0F];
    // Four frames are received within a millisecond.
    for flags in [Cmd::MOVE, Cmd::empty(), Cmd::FASTSTOP, Cmd::empty()] {
        master.send(id, &image(flags));
    }
    master.until(500, |master| master.system().contains(SystemFlags::FAST_STOP));
}

#[test]
fn nmt_stop_and_resets_stop_a_motion() {
    for command in [
        NmtCommand::StopRemoteNode,
        NmtCommand::EnterPreOperational,
        NmtCommand::ResetNode,
        NmtCommand::ResetCommunication,
    ] {
        let mut master = Master::moving();
        master.command_node(command);
        master.pass(20);
        assert!(master.world.take_sent().contains(&CommandId::Stop), "{command:?}");
    }
}

#[test]
fn settings_are_restored_by_node_reset_not_communication_reset() {
    let recipe = setting("RECIPE2_WIDTH");
    for (command, width) in [(NmtCommand::ResetCommunication, 1_234), (NmtCommand::ResetNode, 1_000)] {
        let mut master = Master::new(Config::default());
        master.pass(500);
        master.download(SETTINGS_INDEX, recipe, Value::Unsigned16(1_234)).unwrap();
        master.download(0x1017, 0, Value::Unsigned16(50)).unwrap();
        master.take(0x700);
        master.command_node(command);
        assert_eq!(master.take(0x700)[0].1, [0], "boot-up after {command:?}");
        assert_eq!(master.read_u16(SETTINGS_INDEX, recipe), width, "{command:?}");
        assert_eq!(master.read_u16(0x1017, 0), NODE.heartbeat_ms);
    }
}

#[test]
fn two_resets_in_one_turn_are_both_executed() {
    let recipe = setting("RECIPE2_WIDTH");
    for specifiers in [[0x81, 0x82], [0x82, 0x81]] {
        let mut master = Master::new(Config::default());
        master.pass(500);
        master.download(SETTINGS_INDEX, recipe, Value::Unsigned16(1_234)).unwrap();
        for specifier in specifiers {
            let frame = ClassicFrame::new(StandardId::ZERO, &[specifier, NODE.node]).unwrap();
            master.world.can.double.deliver(frame);
        }
        master.pass(5);
        assert_eq!(master.read_u16(SETTINGS_INDEX, recipe), 1_000, "{specifiers:02X?}");
    }
}

#[test]
fn fast_stop_and_its_end_are_reported() {
    let mut master = Master::homed(None, 10.0);
    master.emergencies();
    master.command(Cmd::FASTSTOP);
    master.pass(100);
    assert_eq!(master.emergencies(), [(code_of("FAST STOP"), 0x81)]);
    let Ok(Value::Unsigned8(register)) = master.upload(0x1001, 0, Theirs::Unsigned8) else { panic!() };
    assert_eq!(register, 0x81);
    master.command(Cmd::empty());
    master.command(Cmd::STOP_ACK);
    master.pass(100);
    assert_eq!(master.emergencies(), [(0, 0)]);
}

#[test]
fn each_fault_sets_the_bit_of_its_class_in_the_error_register() {
    for fault in FAULTS {
        // CiA 301, 7.2.7.1 and 7.5.2.2.
        let bit = match (fault.code >> 12, fault.code) {
            (0x2, _) => 1,
            (0x3, _) => 2,
            (0x4, _) => 3,
            (0x8, _) | (_, 0xFF02) => 4,
            _ => 7,
        };
        assert_eq!(fault.register, 1 << bit, "{}", fault.meaning);
    }
}

#[test]
fn bus_off_ends_operation_until_the_master_starts_it_again() {
    let mut master = Master::homed(None, 10.0);
    master.emergencies();
    master.world.can.double.go_off(0);
    master.pass(2);
    assert_eq!(master.world.node().state(), NmtState::PreOperational);
    master.pass(2_000);
    let codes: Vec<u16> = master.emergencies().into_iter().map(|(code, _)| code).collect();
    assert!(codes.contains(&0x8140), "{codes:04X?}");
    assert_eq!(master.read_u16(0x2002, 4), 1);
    assert_eq!(master.read_u16(REPORTS_INDEX, report("CAN_BUS_OFFS")), 1);
    assert_eq!(master.read_u16(REPORTS_INDEX, report("CAN_STATE")), 0, "the bus has recovered");
    assert_eq!(master.take(0x700).last().map(|(_, state)| state.clone()), Some(vec![0x7F]));
    master.command(Cmd::MOVE);
    master.pass(100);
    assert_eq!(master.world.take_motions(), []);
    master.start();
    master.command(Cmd::empty());
    master.command(Cmd::STOP_ACK);
    master.command(Cmd::MOVE);
    master.pass(100);
    assert_eq!(master.world.take_motions(), [CommandId::PrePosition]);
}

#[test]
fn bus_off_immediately_stops_bus_commanded_gripper_on_rs_232() {
    for (flags, is_commander) in [(Cmd::MOVE, true), (Cmd::JOG_MINUS, true), (Cmd::empty(), false)] {
        let delivered = wsg_bridge_fw::Config { plc_bus: PlcBus::Canopen, ..wsg_bridge_fw::Config::DEFAULT };
        let mut rig = World::homed(delivered, Config::default());
        let double = rig.can.double.clone();
        let mut pass = |ms: u32, frames: &[(u16, &[u8])]| {
            for (id, data) in frames {
                double.deliver(ClassicFrame::new(StandardId::new(*id).unwrap(), data).unwrap());
            }
            rig.pass(ms);
            rig.take_sent()
        };
        pass(10, &[]);
        pass(10, &[(0, &[1, NODE.node])]);
        let rpdo = 0x200 | u16::from(NODE.node);
        let image = [flags.bits(), 0, 0xD0, 0x07, 0x88, 0x13, 0xA0, 0x0F];
        pass(5, &[(rpdo, &[0; 8])]);
        let sent = pass(50, &[(rpdo, &image)]);
        assert_eq!(sent.contains(&CommandId::PrePosition), is_commander, "{flags:?}: {sent:?}");
        // After as many frames as a turn handles.
        for _ in 0..24 {
            double.deliver(ClassicFrame::new(StandardId::new(rpdo).unwrap(), &image).unwrap());
        }
        double.go_off(0);
        let sent = pass(10, &[]);
        assert_eq!(sent.contains(&CommandId::Stop), is_commander, "{flags:?}: {sent:?}");
    }
}

#[test]
fn error_counters_are_those_of_the_controller() {
    let mut master = Master::homed(None, 10.0);
    master.world.can.double.set_health(Health {
        is_off: false,
        is_passive: true,
        transmit_errors: 130,
        receive_errors: 9,
    });
    master.pass(5);
    for (name, value) in [("CAN_STATE", 0x80), ("CAN_TEC", 130), ("CAN_REC", 9)] {
        assert_eq!(master.read_u16(REPORTS_INDEX, report(name)), value, "{name}");
    }
    for (sub, value) in [(1, 0x80), (2, 130), (3, 9)] {
        assert_eq!(master.upload(0x2002, sub, Theirs::Unsigned8), Ok(Value::Unsigned8(value)));
    }
}

#[test]
fn sdo_abort_states_the_reason() {
    const VALUE: u32 = 0x0609_0030;
    let mut master = Master::homed(None, 1.0);
    let reaction = setting("BUS_REACTION");
    assert_eq!(master.download(SETTINGS_INDEX, reaction, Value::Unsigned16(3)), Err(VALUE));
    assert_eq!(master.download(SETTINGS_INDEX, 0, Value::Unsigned8(1)), Err(0x0601_0002));
    assert_eq!(
        master.download(0x2000, 1, Value::Unsigned8(1)),
        Err(0x0800_0021),
        "commands by SDO are not allowed"
    );
    assert_eq!(master.upload(SETTINGS_INDEX, SETTINGS.len() as u8 + 1, Theirs::Unsigned16), Err(0x0609_0011));
    let past_the_reports = REPORTS.len() as u8 + 1;
    assert_eq!(master.download(REPORTS_INDEX, past_the_reports, Value::Unsigned16(1)), Err(0x0609_0011));

    master.command(Cmd::MOVE);
    master.until(1_000, |master| master.system().contains(SystemFlags::MOVING));
    assert_eq!(master.download(SETTINGS_INDEX, reaction, Value::Unsigned16(0)), Err(0x0800_0022));
    assert_eq!(
        master.download(SETTINGS_INDEX, reaction, Value::Unsigned16(3)),
        Err(VALUE),
        "reported with priority"
    );
}

/// Objects of CiA 301 (7.5.2): index, subindices, type, write access.
const COMMUNICATION_PROFILE: [(u16, std::ops::RangeInclusive<u8>, DataType, bool); 46] = {
    use DataType::{Domain, Text, U8, U16, U32};
    [
        (0x1000, 0..=0, U32, false),
        (0x1001, 0..=0, U8, false),
        (0x1003, 0..=0, U8, true),
        (0x1003, 1..=8, U32, false),
        (0x1005, 0..=0, U32, true),
        (0x1008, 0..=0, Text, false),
        (0x1009, 0..=0, Text, false),
        (0x100A, 0..=0, Text, false),
        (0x1010, 0..=0, U8, false),
        (0x1010, 1..=1, U32, true),
        (0x1011, 0..=0, U8, false),
        (0x1011, 1..=1, U32, true),
        (0x1014, 0..=0, U32, true),
        (0x1015, 0..=0, U16, true),
        (0x1016, 0..=0, U8, false),
        (0x1016, 1..=1, U32, true),
        (0x1017, 0..=0, U16, true),
        (0x1018, 0..=0, U8, false),
        (0x1018, 1..=4, U32, false),
        (0x1029, 0..=0, U8, false),
        (0x1029, 1..=1, U8, true),
        (0x1200, 0..=0, U8, false),
        (0x1200, 1..=2, U32, false),
        (0x1400, 0..=0, U8, false),
        (0x1400, 1..=1, U32, true),
        (0x1400, 2..=2, U8, true),
        (0x1600, 0..=0, U8, true),
        (0x1600, 1..=5, U32, true),
        (0x1800, 0..=0, U8, false),
        (0x1800, 1..=1, U32, true),
        (0x1800, 2..=2, U8, true),
        (0x1800, 3..=3, U16, true),
        (0x1800, 5..=5, U16, true),
        (0x1801, 0..=0, U8, false),
        (0x1801, 1..=1, U32, true),
        (0x1801, 2..=2, U8, true),
        (0x1801, 3..=3, U16, true),
        (0x1801, 5..=5, U16, true),
        (0x1A00, 0..=0, U8, true),
        (0x1A00, 1..=4, U32, true),
        (0x1A01, 0..=0, U8, true),
        (0x1A01, 1..=2, U32, true),
        (0x1F50, 0..=0, U8, false),
        (0x1F50, 1..=1, Domain, true),
        (0x1F51, 0..=0, U8, false),
        (0x1F51, 1..=1, U8, true),
    ]
};

#[test]
fn communication_profile_has_standard_types_and_access() {
    let standard: Vec<(u16, u8, DataType, bool)> = COMMUNICATION_PROFILE
        .into_iter()
        .flat_map(|(index, subs, kind, writable)| subs.map(move |sub| (index, sub, kind, writable)))
        .collect();
    let ours: Vec<(u16, u8, DataType, bool)> = OBJECTS
        .iter()
        .filter(|object| object.index < 0x2000)
        .map(|object| (object.index, object.sub, object.kind, object.writable))
        .collect();
    assert_eq!(ours, standard);
}

#[test]
fn every_object_is_read_and_written_by_its_type_and_access() {
    let mut master = Master::new(Config::default());
    master.pass(500);
    let registers = |index, count: usize, writable| {
        (1..=count as u8).map(move |sub| (index, sub, DataType::U16, writable))
    };
    let objects = OBJECTS.iter().map(|object| (object.index, object.sub, object.kind, object.writable));
    let objects = objects.chain(registers(SETTINGS_INDEX, SETTINGS.len(), true)).chain(registers(
        REPORTS_INDEX,
        REPORTS.len(),
        false,
    ));
    for (index, sub, kind, writable) in objects {
        let what = format!("{index:X}h sub {sub}");
        let (theirs, longer) = match kind {
            DataType::Text => {
                assert_eq!(master.download(index, sub, Value::Unsigned32(0)), Err(0x0601_0002), "{what}");
                continue;
            }
            DataType::Domain => {
                assert_eq!(master.upload(index, sub, Theirs::Unsigned32), Err(0x0601_0001), "{what}");
                continue;
            }
            DataType::I16 => (Theirs::Integer16, Value::Unsigned32(0)),
            DataType::U8 => (Theirs::Unsigned8, Value::Unsigned16(0)),
            DataType::U16 => (Theirs::Unsigned16, Value::Unsigned32(0)),
            DataType::U32 => (Theirs::Unsigned32, Value::Unsigned16(0)),
        };
        let value = match master.upload(index, sub, theirs) {
            Ok(value) => value,
            Err(abort) => {
                assert_eq!((index, abort), (0x1003, 0x0800_0024), "{what}: no entry yet");
                Value::Unsigned32(0)
            }
        };
        let written = match (index, writable) {
            // These require a signature.
            (0x1010 | 0x1011, true) => Err(0x0800_0020),
            // Without a boot loader.
            (0x1F51, true) => Err(0x0800_0021),
            (_, true) => Ok(()),
            (_, false) => Err(0x0601_0002),
        };
        assert_eq!(master.download(index, sub, value), written, "{what}: the same value");
        let refused = if writable { Err(0x0607_0010) } else { Err(0x0601_0002) };
        assert_eq!(master.download(index, sub, longer), refused, "{what}: another length");
        if !OBJECTS.iter().any(|object| (object.index, object.sub) == (index, sub + 1)) && index < 0x2100 {
            let missing = if sub == 3 && matches!(index, 0x1800 | 0x1801) { sub + 1 } else { 200 };
            assert_eq!(master.upload(index, missing, theirs), Err(0x0609_0011), "{what}");
        }
    }
    assert_eq!(master.read_u16(REPORTS_INDEX, report("MAP_VERSION")), MAP_VERSION, "report {FIRST_REPORT}");
    let mut subindices: Vec<(u16, u8)> = OBJECTS.iter().map(|object| (object.index, object.sub)).collect();
    let count = subindices.len();
    subindices.sort_unstable();
    subindices.dedup();
    assert_eq!(subindices.len(), count, "no object twice");
}

/// Signatures for 1010h and 1011h.
const SAVE: Value = Value::Unsigned32(0x6576_6173);
const LOAD: Value = Value::Unsigned32(0x6461_6F6C);

#[test]
fn settings_are_stored_by_1010h_and_defaults_by_1011h() {
    let mut master = Master::new(Config::default());
    master.pass(500);
    let sub = setting("DEBOUNCE");
    for (object, signature, wrong) in [(0x1010, SAVE, LOAD), (0x1011, LOAD, SAVE)] {
        assert_eq!(master.upload(object, 1, Theirs::Unsigned32), Ok(Value::Unsigned32(1)), "on command");
        assert_eq!(master.download(object, 1, wrong), Err(0x0800_0020));
        assert_eq!(master.download(SETTINGS_INDEX, sub, Value::Unsigned16(9)), Ok(()));
        assert_eq!(master.store(object, signature), Ok(()));
        assert_eq!(master.read_u16(REPORTS_INDEX, report("SAVE_STATE")), 2, "stored before the response");
        assert_eq!(master.read_u16(REPORTS_INDEX, report("SETTINGS_CHANGED")), 0);
        let is_delivered = object == 0x1011;
        assert_eq!(master.read_u16(SETTINGS_INDEX, sub), if is_delivered { 2 } else { 9 });
    }
}

#[test]
fn failed_or_late_save_is_reported_by_its_sdo() {
    let mut master = Master::new(Config::default());
    master.pass(500);
    let slow = 20;
    master.world.flash.busy_polls = slow;
    master.send(0x600 | u16::from(NODE.node), &sdo_request(0x1010, SAVE));
    master.pass(slow);
    assert_eq!(master.take(0x580), [], "the save is running");
    assert_eq!(
        master.store(0x1010, SAVE),
        Err(0x0800_0022),
        "a new request cancels the first one's response"
    );
    master.pass(3_000);
    assert_eq!(master.take(0x580), []);
    assert_eq!(master.read_u16(REPORTS_INDEX, report("SAVE_STATE")), 2);
    for fault in [Fault::Protected, Fault::Stuck, Fault::Swallows(0)] {
        for (object, signature) in [(0x1010, SAVE), (0x1011, LOAD)] {
            let mut master = Master::new(Config::default());
            master.pass(500);
            master.world.flash.fault = Some(fault);
            let sub = setting("DEBOUNCE");
            assert_eq!(master.download(SETTINGS_INDEX, sub, Value::Unsigned16(9)), Ok(()));
            assert_eq!(master.store(object, signature), Err(0x0606_0000), "{object:X}h, {fault:?}");
            // A later write is independent of the failed save.
            assert_eq!(master.download(SETTINGS_INDEX, sub, Value::Unsigned16(9)), Ok(()));
        }
    }
}

#[test]
fn names_and_serial_number_are_from_the_board() {
    let mut master = Master::new(Config::default());
    master.pass(500);
    for (index, text) in
        [(0x1008, "WSG gripper bridge"), (0x1009, BOARD.name), (0x100A, env!("CARGO_PKG_VERSION"))]
    {
        let [low, high] = u16::to_le_bytes(index);
        let begun = master.transfer(&[0x40, low, high, 0, 0, 0, 0, 0]);
        assert_eq!(begun, [0x41, low, high, 0, text.len() as u8, 0, 0, 0]);
        let mut read = Vec::new();
        for toggle in [0, 0x10].into_iter().cycle() {
            let segment = master.transfer(&[0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]);
            read.extend_from_slice(&segment[1..8 - usize::from(segment[0] >> 1 & 7)]);
            if segment[0] & 1 != 0 {
                break;
            }
        }
        assert_eq!(read, text.as_bytes());
    }
    assert_eq!(master.upload(0x1018, 4, Theirs::Unsigned32), Ok(Value::Unsigned32(BOARD.serial)));
}

#[test]
fn grip_cycle_with_sync() {
    let mut master = Master::homed(Some(20.0), 10.0);
    master.download(0x1400, 2, Value::Unsigned8(1)).unwrap();
    master.command(Cmd::GRIP);
    master.pass(100);
    assert_eq!(master.world.take_motions(), [], "not without a SYNC");
    master.send(0x080, &[]);
    master.until(10_000, |master| master.state() == GripperFlags::HOLDING);
    assert_eq!(master.world.take_motions(), [CommandId::GripPart]);
    // A FAST STOP does not wait for SYNC.
    master.command(Cmd::FASTSTOP);
    assert!(master.world.take_sent().contains(&CommandId::FastStop));
}

#[test]
fn pdo_mappings_match_the_transmitted_objects() {
    for (mapping, len) in [(0x1600, 64), (0x1A00, 64), (0x1A01, 32)] {
        let mut master = Master::new(Config::default());
        master.pass(500);
        let Ok(Value::Unsigned8(count)) = master.upload(mapping, 0, Theirs::Unsigned8) else { panic!() };
        let mut bits = 0;
        for sub in 1..=count {
            let Ok(Value::Unsigned32(entry)) = master.upload(mapping, sub, Theirs::Unsigned32) else {
                panic!()
            };
            let object = OBJECTS
                .iter()
                .find(|object| u32::from(object.index) == entry >> 16 && object.sub == (entry >> 8) as u8)
                .expect("a mapped object exists");
            assert!(object.mappable && u32::from(object.kind.len()) * 8 == entry & 0xFF);
            bits += entry & 0xFF;
        }
        assert_eq!(bits, len, "{mapping:X}h");
    }
}

#[test]
fn consumer_heartbeat_selects_the_master_and_sets_bus_timeout() {
    let mut master = Master::new(Config::default());
    master.pass(500);
    let Ok(value) = master.upload(0x1016, 1, Theirs::Unsigned32) else { panic!() };
    assert_eq!(value, Value::Unsigned32(u32::from(NODE.master) << 16 | TIMEOUT_MS));
    let changed = Value::Unsigned32(5 << 16 | 300);
    master.download(0x1016, 1, changed).unwrap();
    assert_eq!(master.read_u16(SETTINGS_INDEX, setting("BUS_TIMEOUT")), 300);
    assert_eq!(master.upload(0x1016, 1, Theirs::Unsigned32), Ok(changed));
}

#[test]
fn traffic_of_the_node_does_not_delay_messages_to_the_gripper() {
    // The node sends all of its frames at maximum rate.
    let mut master = Master::homed(Some(20.0), 10.0);
    for (index, id) in [(0x1800, 0x4000_0190), (0x1801, 0x4000_0290)] {
        master.download(index, 1, Value::Unsigned32(0x8000_0000 | id)).unwrap();
        master.download(index, 3, Value::Unsigned16(0)).unwrap();
        master.download(index, 5, Value::Unsigned16(1)).unwrap();
        master.download(index, 1, Value::Unsigned32(id)).unwrap();
    }
    master.download(0x1017, 0, Value::Unsigned16(1)).unwrap();
    master.command(Cmd::GRIP);
    master.until(10_000, |master| master.state() == GripperFlags::HOLDING);
    assert_eq!(master.world.can.broken(), 0);
    assert_eq!(master.world.can_bus().counters().refused, 0);
}

#[test]
fn own_frames_are_the_frames_that_the_node_sends() {
    let node = Node::new(NODE);
    let sends = |id: u16| CanNode::<ClassicFrame>::sends(&node, StandardId::new(id).unwrap().into());
    let own = u16::from(NODE.node);
    for base in [0x080, 0x180, 0x280, 0x580, 0x700] {
        assert!(sends(base + own), "{base:#x}");
    }
    for foreign in [0, 0x120, 0x121, 0x181 + own] {
        assert!(!sends(foreign), "{foreign:#x}");
    }
}

#[test]
fn rejected_frames_are_sent_again() {
    const PDOS: [u16; 2] = [0x180, 0x280];
    let mut master = Master::homed(None, 10.0);
    master.pass(200);
    master.take(0x180);
    while master.take(0x180).is_empty() {
        master.pass(1);
    }
    // The controller rejects the next frames. Without a change, they are due 100 ms after these, and again every 100 ms.
    master.world.can.double.refuse(true);
    for pdo in PDOS {
        master.take(pdo);
    }
    master.pass(120);
    assert_eq!(PDOS.map(|pdo| master.take(pdo).len()), [0, 0]);
    master.world.can.double.refuse(false);
    master.pass(5);
    assert_eq!(PDOS.map(|pdo| master.take(pdo).len()), [1, 1]);
}

#[test]
fn all_frames_of_one_turn_are_served_in_it() {
    let mut bridge = Bridge::new(wsg_bridge_fw::Config::DEFAULT);
    let mut node = Node::new(NODE);
    let mut turn = |now_ms, frames: &[ClassicFrame]| {
        for frame in frames {
            node.on_frame(Instant::from_millis(now_ms), frame);
        }
        bridge.poll(now_ms, Inputs::empty(), &mut SerialLine::with_room(0), &mut node);
        while CanNode::<ClassicFrame>::poll_transmit(&mut node, Instant::from_millis(now_ms)).is_some() {}
        bridge.control_source()
    };
    let frame = |id, data: &[u8]| ClassicFrame::new(StandardId::new(id).unwrap(), data).unwrap();
    let rpdo = |flags: Cmd| frame(0x200 + u16::from(NODE.node), &[flags.bits(), 0, 0, 0, 0, 0, 0, 0]);
    turn(1, &[]);
    turn(2, &[frame(0, &[1, NODE.node]), rpdo(Cmd::empty())]);
    // The bus delivers at most 24 frames per turn.
    let mut burst = vec![rpdo(Cmd::empty()); 23];
    burst.push(rpdo(Cmd::HOMING));
    assert_eq!(turn(3, &burst), ControlSource::Bus);
}

#[test]
fn default_identifiers_do_not_collide_but_reserved_ones_do() {
    assert!(NODE.is_valid() && !collides_with_canopen(Identifiers::DEFAULT));
    let collides = |n| collides_with_canopen(Identifiers::from_base(n).unwrap());
    let (free, taken): (Vec<u16>, Vec<u16>) = (0..=0x7FE).partition(|&n| !collides(n));
    assert!([0x001, 0x07E, 0x101, 0x17F, 0x681, 0x6FF].iter().all(|n| free.contains(n)), "{free:03X?}");
    assert!([0x000, 0x07F, 0x080, 0x100, 0x180, 0x210, 0x600, 0x700].iter().all(|n| taken.contains(n)));
}

#[test]
fn eds_file_matches_the_tables() {
    let mut made = String::new();
    write_eds(&mut made, &NODE).unwrap();
    hold_file("docs/wsg-bridge.eds", &made);
}

/// The heartbeat consumer (CiA 301, 7.2.8.3) or, without one, RPDO1 monitors the master. BUS_TIMEOUT is the time-out of both.
#[test]
fn silent_master_times_out_despite_other_can_traffic() {
    let (node, of_master) = (u16::from(NODE.node), 0x700 | u16::from(NODE.master));
    let frame = |id: u16, data: &[u8]| ClassicFrame::new(StandardId::new(id).unwrap(), data).unwrap();
    let traffic = [
        ("the heartbeat of another node", frame(of_master - 1, &[5])),
        ("a heartbeat of two bytes", frame(of_master, &[5, 5])),
        (
            "a remote request of a heartbeat",
            ClassicFrame::new_remote(StandardId::new(of_master).unwrap(), 1).unwrap(),
        ),
        ("an RPDO of another node", frame(0x200 | (node + 1), &[0; 8])),
        ("an RPDO of seven bytes", frame(0x200 | node, &[0; 7])),
        ("a SYNC", frame(0x080, &[])),
        ("an NMT command for another node", frame(0x000, &[1, NODE.node + 1])),
        ("an SDO request", frame(0x600 | node, &sdo::encode_upload_request(Address::new(0x1000, 0)))),
    ];
    for beats in [true, false] {
        for (what, frame) in &traffic {
            let mut master = Master::homed(None, 1.0);
            if !beats {
                // Without the heartbeat received so far.
                master.world.can.beats = false;
                master.pass(2 * TIMEOUT_MS);
                master.start();
                master.command(Cmd::empty());
            }
            master.command(Cmd::MOVE);
            master.until(1_000, |master| master.system().contains(SystemFlags::MOVING));
            if beats {
                master.send(of_master, &[5]);
                master.world.can.beats = false;
            } else {
                master.command(Cmd::MOVE);
            }
            master.world.take_sent();
            let mut pass = |ms: u32| {
                for _ in 0..ms / 10 {
                    master.world.can.queue(*frame);
                    master.pass(10);
                }
                (master.world.node().state(), master.world.take_sent().contains(&CommandId::Stop))
            };
            assert_eq!(pass(TIMEOUT_MS - 20), (NmtState::Operational, false), "too early with {what}");
            assert_eq!(pass(40), (NmtState::PreOperational, true), "with {what}, heartbeat: {beats}");
        }
    }
}
