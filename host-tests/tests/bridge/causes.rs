//! Provokes every event of the table once, on a station with the PLC on Modbus and on one with the PLC on CANopen. Reads it
//! back over that bus, by EMCY and its error field, and over the service port.

use std::collections::BTreeSet;

use canopen_rs::{Address, DataType, Value, sdo};
use host_tests::addresses::{report, setting};
use host_tests::flash_model::{Fault as FlashFault, FlashModel};
use host_tests::serial_gripper::SerialGripper;
use host_tests::slot_model::{SlotModel, signed};
use host_tests::world::modbus::Master;
use host_tests::world::{BOARD, World, quick, with_part};
use wsg_bridge_fw::can::DEFAULT_NODE;
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::plc::canopen::REPORTS_INDEX;
use wsg_bridge_fw::registers::{COMMAND_KEY, EVENTS, EventCode, FIRST_COMMAND, FIRST_REPORT, REPORTS};
use wsg_bridge_fw::{Config, GripperLine, PlcBus, ResetCause};
use wsg_fieldbus::CommandFlags as Cmd;
use wsg_protocol::frame::MAX_MESSAGE_LEN;
use wsg_protocol::{CommandId, Event, FrameEncoder, FrameParser, Status};
use wsg_sim::{Fault, Finger, Jaw};

/// 10.00 mm, 20.00 mm/s, 40.00 N.
const SLOWLY: [u16; 3] = [10_00, 20_00, 40_00];

/// A station, its gripper, and a PLC that writes its image cyclically.
struct Plant {
    plc_bus: PlcBus,
    rig: Master,
    /// CMDFLAGS, WIDTH, SPEED, FORCELIMIT.
    image: (Cmd, [u16; 3]),
    talks: bool,
    /// Frames sent by the bridge on CAN.
    received: Vec<(u16, Vec<u8>)>,
}

impl Plant {
    fn new(config: Config, gripper: wsg_sim::Config, flash: FlashModel) -> Self {
        Self::of(World::with(config, SerialGripper::new(gripper), flash, ResetCause::Watchdog))
    }

    fn of(world: World) -> Self {
        let mut plant = Self {
            plc_bus: world.config.plc_bus,
            rig: Master::of(world),
            image: (Cmd::empty(), [0; 3]),
            talks: false,
            received: Vec::new(),
        };
        plant.pass(500);
        plant.talks = true;
        plant.deliver(0, &[1, DEFAULT_NODE.node]);
        plant.write(Cmd::empty(), [0; 3]);
        plant
    }

    fn ready(plc_bus: PlcBus) -> Self {
        Self::new(Config { plc_bus, ..Config::DEFAULT }, quick(), FlashModel::new())
    }

    /// Returns a plant with referenced fingers, homed over the bus.
    fn homed_with(plc_bus: PlcBus, gripper: wsg_sim::Config) -> Self {
        let mut plant = Self::new(Config { plc_bus, ..Config::DEFAULT }, gripper, FlashModel::new());
        plant.command(Cmd::HOMING, [0; 3]);
        plant
    }

    fn homed(plc_bus: PlcBus) -> Self {
        Self::homed_with(plc_bus, quick())
    }

    fn with_part(plc_bus: PlcBus) -> Self {
        Self::homed_with(plc_bus, with_part(20.0))
    }

    fn with_fmf(plc_bus: PlcBus) -> Self {
        Self::homed_with(plc_bus, wsg_sim::Config { fingers: [Finger::Fmf; 2], ..quick() })
    }

    /// Returns a plant at the gripper's normal speed.
    fn at_rest(plc_bus: PlcBus) -> Self {
        Self::homed_with(plc_bus, wsg_sim::Config::default())
    }

    /// Returns a plant during a MOVE of the bus.
    fn moving(plc_bus: PlcBus) -> Self {
        let mut plant = Self::at_rest(plc_bus);
        plant.write(Cmd::MOVE, SLOWLY);
        plant.pass(300);
        plant
    }

    fn fail(&mut self, fault: Fault) {
        let now = self.rig.now();
        self.rig.gripper().set_fault(fault, true, now);
        self.pass(100);
    }

    /// Resets only the bridge.
    fn reset(mut self) -> Self {
        self.rig.restart_bridge(ResetCause::Watchdog);
        Self::of(self.rig.into_world())
    }

    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            if self.talks && (self.rig.now_ms() + 1).is_multiple_of(50) {
                self.send_image();
            }
            self.rig.step();
            self.received.extend(self.rig.can.take_frames().into_iter().map(|(_, id, data)| (id, data)));
        }
    }

    fn deliver(&mut self, id: u16, data: &[u8]) {
        if self.plc_bus == PlcBus::Canopen {
            self.rig.can.send(id, data);
        }
    }

    fn send_image(&mut self) {
        let (flags, numbers) = self.image;
        match self.plc_bus {
            PlcBus::Canopen => {
                let mut data = vec![flags.bits(), 0];
                data.extend(numbers.into_iter().flat_map(u16::to_le_bytes));
                self.deliver(0x200 | u16::from(DEFAULT_NODE.node), &data);
            }
            _ => {
                let mut request = vec![1, 16, 0, 0, 0, 4, 8, flags.bits(), 0];
                request.extend(numbers.into_iter().flat_map(u16::to_be_bytes));
                self.rig.modbus.ask(&request);
            }
        }
    }

    /// Writes the output image over the bus.
    fn write(&mut self, flags: Cmd, numbers: [u16; 3]) {
        self.image = (flags, numbers);
        self.send_image();
        self.pass(5);
    }

    /// Gives an edge, and waits for the end of the command.
    fn command(&mut self, flags: Cmd, numbers: [u16; 3]) {
        self.write(flags, numbers);
        self.write(Cmd::empty(), numbers);
        for _ in 0..2_000 {
            if self.rig.by_service(Master::status) != Status::CmdPending.code() {
                return;
            }
            self.pass(10);
        }
        panic!("the command did not end");
    }

    fn cut(&mut self) {
        self.rig.set_cut(true);
    }

    /// Writes a register over the service port.
    fn set(&mut self, address: u16, value: u16) {
        assert_eq!(self.rig.by_service(|rig| rig.set_register(address, value)), Ok(()), "accepted");
    }

    /// Sends an image over the service port, in one block.
    fn begin_update(&mut self) {
        self.rig.flash.slot = Some(SlotModel::new());
        self.pass(2);
        let image = signed(64, BOARD.name, [0; 3]);
        let len = image.len() as u8;
        let request = [&[21, 7 + len, 6, 0, 1, 0, 0, 0, len / 2], &image[..]].concat();
        self.rig.by_service(|rig| assert_eq!(rig.ask(&request), request));
    }

    /// Reads reports over the PLC's bus.
    fn over_bus(&mut self, first: u16, count: u8) -> Vec<u16> {
        if self.plc_bus == PlcBus::Canopen {
            let sub = u8::try_from(first - FIRST_REPORT + 1).unwrap();
            let kind = DataType::Unsigned16;
            let values = (sub..sub + count).map(|sub| self.upload(REPORTS_INDEX, sub, kind));
            return values.map(|value| u16::try_from(value).unwrap()).collect();
        }
        // Wait for the end of an image in transmission.
        let talks = std::mem::take(&mut self.talks);
        self.pass(5);
        let values = self.rig.input(first, count).expect("the registers exist");
        self.talks = talks;
        values
    }

    /// Reads an object with an SDO upload.
    fn upload(&mut self, index: u16, sub: u8, kind: DataType) -> u32 {
        let node = u16::from(DEFAULT_NODE.node);
        self.received.retain(|(id, _)| *id != 0x580 | node);
        self.deliver(0x600 | node, &sdo::encode_upload_request(Address::new(index, sub)));
        self.pass(5);
        let answer = self.received.iter().find(|(id, _)| *id == 0x580 | node).expect("an SDO answer");
        let answer: &[u8; 8] = answer.1[..].try_into().unwrap();
        match sdo::decode_upload_expedited_response(answer, kind).unwrap().1 {
            Value::Unsigned8(value) => value.into(),
            Value::Unsigned16(value) => value.into(),
            Value::Unsigned32(value) => value,
            other => panic!("{index:X}h sub {sub}: {other:?}"),
        }
    }

    /// Returns code and cause of each EMCY.
    fn emergencies(&self) -> Vec<(u16, u8)> {
        let id = 0x080 | u16::from(DEFAULT_NODE.node);
        let frames = self.received.iter().filter(|(other, _)| *other == id);
        frames.map(|(_, data)| (u16::from_le_bytes([data[0], data[1]]), data[7])).collect()
    }

    /// Returns code and cause of each entry of 1003h.
    fn error_field(&mut self) -> Vec<(u16, u8)> {
        let count = self.upload(0x1003, 0, DataType::Unsigned8);
        let entries = (1..=count).map(|sub| self.upload(0x1003, sub as u8, DataType::Unsigned32));
        entries.map(|entry| (entry as u16, (entry >> 16) as u8)).collect()
    }
}

/// Expected reports on an event.
struct Expected {
    code: EventCode,
    command: Option<CommandId>,
    value: u16,
    /// Event of ERROR_CAUSE; `None`: ERROR is low.
    error: Option<EventCode>,
    /// Code and ERROR_CAUSE of the EMCY, if CANopen has one for the event.
    emergency: Option<(u16, Option<EventCode>)>,
}

impl Expected {
    const fn with_error(self, error: Option<EventCode>) -> Self {
        Self { error, ..self }
    }
}

/// An event's reports, a station with its PLC on a bus, and what provokes the event on it.
type Case = (Expected, fn(PlcBus) -> Plant, fn(&mut Plant));

const UPDATE_CHECK: u16 = FIRST_COMMAND + 3;
const UPDATE_RESTART: u16 = FIRST_COMMAND + 4;

const MOVED: Option<CommandId> = Some(CommandId::PrePosition);
const FAST_STOP: u16 = 0xFF01;

/// A FAST STOP of the bridge. EMCY reports it with its cause.
const fn fast_stop(code: EventCode, command: Option<CommandId>, value: u16) -> Expected {
    Expected { code, command, value, error: Some(code), emergency: Some((FAST_STOP, Some(code))) }
}

/// A fault with an EMCY of this code. ERROR may have another cause.
const fn fault(code: EventCode, emergency: u16, error: EventCode) -> Expected {
    Expected { emergency: Some((emergency, Some(error))), error: Some(error), ..refusal(code, None, 0) }
}

/// A refused or failed command. It is not a fault, so there is no EMCY.
const fn refusal(code: EventCode, command: Option<CommandId>, value: u16) -> Expected {
    Expected { code, command, value, error: Some(code), emergency: None }
}

const CASES: &[Case] = {
    use EventCode as E;
    &[
        (refusal(E::Start, None, ResetCause::Watchdog as u16).with_error(None), Plant::ready, |_| {}),
        (fast_stop(E::Wire, MOVED, 0), Plant::moving, |plant| {
            plant.rig.inputs -= Inputs::FAST_STOP_OK;
            plant.pass(200);
        }),
        (fast_stop(E::BusFlag, MOVED, 0), Plant::moving, |plant| {
            plant.write(Cmd::FASTSTOP, SLOWLY);
            plant.pass(200);
        }),
        (fast_stop(E::ParameterChanged, MOVED, 11_00), Plant::moving, |plant| {
            plant.write(Cmd::MOVE, [11_00, 20_00, 40_00]);
            plant.pass(200);
        }),
        (fast_stop(E::OutsideLimits, None, 60_000), Plant::homed, |plant| {
            plant.write(Cmd::GRIP, [20_00, 60_000, 40_00]);
            plant.pass(200);
        }),
        (fast_stop(E::PlcSilent, MOVED, 0), Plant::moving, |plant| {
            plant.command(Cmd::STOP_ACK, SLOWLY);
            plant.set(setting("BUS_REACTION"), 2);
            plant.write(Cmd::MOVE, [60_00, 20_00, 40_00]);
            plant.talks = false;
            plant.pass(1_500);
        }),
        (fast_stop(E::StopFailed, None, Status::Timeout.code()), Plant::moving, |plant| {
            plant.cut();
            plant.write(Cmd::STOP_ACK, SLOWLY);
            plant.pass(200);
        }),
        (fast_stop(E::ConnectionLost, MOVED, 0), Plant::at_rest, |plant| {
            plant.write(Cmd::JOG_MINUS, SLOWLY);
            plant.pass(300);
            plant.cut();
            plant.pass(1_500);
        }),
        (fault(E::GripperFastStop, FAST_STOP, E::GripperFastStop), Plant::with_fmf, |plant| {
            plant.fail(Fault::MotorCurrent)
        }),
        (fault(E::CurrFault, 0x2000, E::GripperFastStop), Plant::with_fmf, |plant| {
            plant.fail(Fault::MotorCurrent)
        }),
        (fault(E::TempFault, 0x4200, E::TempFault), Plant::with_fmf, |plant| {
            plant.fail(Fault::OverTemperature)
        }),
        (fault(E::PowerFault, 0x3000, E::PowerFault), Plant::with_fmf, |plant| {
            plant.fail(Fault::SupplyOutOfRange)
        }),
        (fault(E::FingerFault, 0x7000, E::FingerFault), Plant::with_fmf, |plant| {
            plant.fail(Fault::FingerShortCircuit(Jaw::One))
        }),
        (fault(E::GripperSilent, 0xFF02, E::GripperSilent), Plant::homed, |plant| {
            plant.cut();
            plant.pass(3_000);
        }),
        (refusal(E::NotConnected, None, 0).with_error(Some(E::GripperSilent)), Plant::homed, |plant| {
            plant.cut();
            plant.pass(3_000);
            plant.write(Cmd::empty(), SLOWLY);
            plant.write(Cmd::MOVE, SLOWLY);
        }),
        (refusal(E::FastStopLasts, None, 0).with_error(Some(E::BusFlag)), Plant::homed, |plant| {
            plant.write(Cmd::FASTSTOP, SLOWLY);
            plant.pass(50);
            plant.write(Cmd::empty(), SLOWLY);
            plant.write(Cmd::MOVE, SLOWLY);
        }),
        (refusal(E::MotionRuns, MOVED, 0), Plant::moving, |plant| {
            plant.write(Cmd::MOVE | Cmd::RELEASE, SLOWLY);
        }),
        (refusal(E::NotReady, None, 0), Plant::homed, |plant| {
            // The fingers stop before the end of BUSY.
            plant.set(setting("MIN_BUSY"), 10_000);
            plant.rig.pulse(Inputs::MOVE);
            plant.pass(3_000);
            plant.rig.pulse(Inputs::MOVE);
        }),
        (refusal(E::PartHeld, None, 0), Plant::with_part, |plant| {
            plant.command(Cmd::GRIP, [20_00, 50_00, 40_00]);
            plant.write(Cmd::MOVE, [20_00, 50_00, 40_00]);
        }),
        (refusal(E::NotIdle, None, 0), Plant::homed, |plant| {
            plant.command(Cmd::GRIP, [20_00, 50_00, 40_00]);
            plant.write(Cmd::MOVE, [20_00, 50_00, 40_00]);
        }),
        (refusal(E::Refused, MOVED, Status::NotInitialized.code()), Plant::ready, |plant| {
            plant.write(Cmd::MOVE, [20_00, 50_00, 40_00]);
            plant.pass(100);
        }),
        (refusal(E::Unanswered, MOVED, 0).with_error(Some(E::GripperSilent)), Plant::moving, |plant| {
            plant.cut();
            plant.pass(3_000);
        }),
        (
            refusal(E::Withdrawn, Some(CommandId::ReleasePart), 0).with_error(Some(E::GripperSilent)),
            Plant::with_part,
            |plant| {
                // Only the reply to a Stop reaches the bridge. The connection is lost for lack of reports while a motion
                // waits for the reply to the Acknowledge that follows the Stop after an error.
                plant.command(Cmd::MOVE, [10_00, 50_00, 40_00]);
                let mut parser = FrameParser::<MAX_MESSAGE_LEN>::new();
                plant.rig.far.to_bridge = Some(Box::new(move |bytes| {
                    let mut through = Vec::new();
                    for byte in bytes.drain(..) {
                        if let Some(Event::Frame(frame)) = parser.push(byte)
                            && frame.id == CommandId::Stop.code()
                        {
                            through.extend(FrameEncoder::new(frame.id, frame.payload));
                        }
                    }
                    *bytes = through;
                }));
                for flags in [Cmd::STOP_ACK, Cmd::empty(), Cmd::RELEASE] {
                    plant.write(flags, [20_00, 50_00, 40_00]);
                }
                plant.pass(3_000);
            },
        ),
        (refusal(E::MovedAtStart, None, 0), |bus| Plant::moving(bus).reset(), |_| {}),
        (
            Expected { error: None, emergency: Some((0x8130, None)), ..refusal(E::BusSilent, None, 1) },
            Plant::moving,
            |plant| {
                plant.talks = false;
                plant.pass(2_000);
            },
        ),
        (
            fault(E::BusOff, 0x8140, E::GripperSilent),
            |plc_bus| {
                // CAN needs a participant: a gripper that does not answer.
                let config = Config { plc_bus, gripper_line: GripperLine::Can, ..Config::DEFAULT };
                Plant::new(config, quick(), FlashModel::new())
            },
            |plant| {
                plant.rig.can.double.go_off(0);
                plant.pass(1_000);
            },
        ),
        (
            refusal(E::SettingsRefused, None, 3),
            |plc_bus| {
                let config = Config { plc_bus, ..Config::DEFAULT };
                Plant::new(config, quick(), FlashModel::with_record(u16::MAX, &config.record()))
            },
            |_| {},
        ),
        (refusal(E::UpdateRuns, None, 0), Plant::homed, Plant::begin_update),
        (fast_stop(E::UpdateRestart, None, 0), Plant::homed, |plant| {
            plant.begin_update();
            for command in [UPDATE_CHECK, UPDATE_RESTART] {
                plant.set(command, COMMAND_KEY);
                plant.pass(200);
            }
        }),
        // 1: no boot loader.
        (refusal(E::UpdateRefused, None, 1).with_error(None), Plant::homed, |plant| {
            let refused = plant.rig.by_service(|rig| rig.set_register(UPDATE_RESTART, COMMAND_KEY));
            assert_eq!(refused, Err(1));
        }),
        // 2: write-protected.
        (refusal(E::SaveFailed, None, 2).with_error(None), Plant::homed, |plant| {
            plant.rig.flash.fault = Some(FlashFault::Protected);
            plant.set(FIRST_COMMAND, COMMAND_KEY);
            plant.pass(1_000);
        }),
    ]
};

#[test]
fn every_event_is_provoked_and_read_over_each_interface() {
    let mut provoked = BTreeSet::new();
    for (expected, start, provoke) in CASES {
        for plc_bus in [PlcBus::Modbus, PlcBus::Canopen] {
            let mut plant = start(plc_bus);
            provoke(&mut plant);
            assert_reports(expected, &mut plant, plc_bus);
        }
        provoked.insert(expected.code as u8);
    }
    let missing: Vec<&str> = EVENTS
        .iter()
        .filter(|event| !provoked.contains(&(event.code as u8)))
        .map(|event| event.name)
        .collect();
    assert!(missing.is_empty(), "never provoked: {missing:?}");
}

/// Asserts that this bus and the service port report the event identically.
fn assert_reports(expected: &Expected, plant: &mut Plant, plc_bus: PlcBus) {
    let what = format!("{:?} with {plc_bus:?}", expected.code);
    let (first, last) = (report("ERROR_CAUSE"), report("EVENT16_AGE"));
    let count = (last - first + 1) as u8;
    let by_service = plant.rig.by_service(|rig| rig.input(first, count)).unwrap();
    let by_bus = plant.over_bus(first, count);
    let is_age = |at: usize| REPORTS[usize::from(first - FIRST_REPORT) + at].name.ends_with("_AGE");
    for (at, pair) in by_service.iter().zip(&by_bus).enumerate() {
        assert!(is_age(at) || pair.0 == pair.1, "{what}: register {}: {pair:?}", usize::from(first) + at);
    }

    let at = |name: &str| usize::from(report(name) - first);
    let event = [expected.code as u16, expected.command.map_or(0, |id| id.code().into()), expected.value];
    let ring = by_bus[at("EVENT1_CODE")..].chunks_exact(4).take_while(|event| event[0] != 0);
    let ring: Vec<_> = ring.map(|event| event[..3].to_vec()).collect();
    assert!(ring.contains(&event.to_vec()), "{what}: {ring:?}");
    assert_eq!(usize::from(by_bus[at("EVENTS")]), ring.len(), "{what}: {ring:?}");
    let error = expected.error.map_or(0, |code| code as u16);
    assert_eq!(by_bus[at("ERROR_CAUSE")], error, "{what}: {ring:?}");
    if matches!(expected.emergency, Some((FAST_STOP, _))) {
        assert_eq!(by_bus[at("FAST_STOP_CAUSE")..][..3], event, "{what}");
    }
    if let (PlcBus::Canopen, Some((code, cause))) = (plc_bus, expected.emergency) {
        let emergency = (code, cause.map_or(0, |code| code as u8));
        let emergencies = plant.emergencies();
        assert!(emergencies.contains(&emergency), "{what}: {emergencies:04X?}");
        let field = plant.error_field();
        assert!(field.contains(&emergency), "{what}: {field:04X?}");
    }
}
