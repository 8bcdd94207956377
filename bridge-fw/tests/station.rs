//! Tests of a station's turn: what it does for a gripper on CAN beside the bridge's own turn.

use std::collections::VecDeque;

use bus_slcan::ClassicFrame;
use embedded_can::Id;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanController, Health, Withdrawal};
use wsg_bridge_fw::gripper::GripperLink;
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::storage::NoFlash;
use wsg_bridge_fw::{BoardId, Config, GripperLine, NoBus, ResetCause, Station};
use wsg_protocol::can::{HALF_MESSAGE_MS, Identifiers, Reassembler, Segments};
use wsg_protocol::{
    CommandId, DeviceType, Event, FirmwareVersion, FrameEncoder, GripperState, Instant, Reply, SystemFlags,
    SystemInfo, SystemLimits, Value,
};

const INFO: SystemInfo = SystemInfo {
    device: DeviceType::Wsg50,
    hardware_revision: 1,
    firmware: FirmwareVersion::new(4, 0, 0, 0),
    serial_number: 1,
};

const LIMITS: SystemLimits = SystemLimits {
    stroke: 110.0,
    min_speed: 5.0,
    max_speed: 420.0,
    min_acceleration: 100.0,
    max_acceleration: 5_000.0,
    min_force: 5.0,
    nominal_force: 80.0,
    overdrive_force: 120.0,
};

/// What happens to the frames of the bridge.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Bus {
    /// The controller has no room, because frames of others fill the bus.
    Full,
    /// The gripper answers the queries of a new connection.
    Answered,
    /// No node acknowledges a frame, so the controller keeps the first one.
    Unacknowledged,
}

/// A CAN controller and its bus.
#[derive(Debug)]
struct Controller {
    bus: Bus,
    gripper: Reassembler<8>,
    answers: VecDeque<ClassicFrame>,
    holds_frame: bool,
    withdrawals: usize,
}

#[derive(Debug)]
struct Never;

impl embedded_can::Error for Never {
    fn kind(&self) -> embedded_can::ErrorKind {
        embedded_can::ErrorKind::Other
    }
}

impl embedded_can::nb::Can for Controller {
    type Frame = ClassicFrame;
    type Error = Never;

    fn transmit(&mut self, frame: &ClassicFrame) -> nb::Result<Option<ClassicFrame>, Never> {
        let Self { bus, gripper, answers, holds_frame, .. } = self;
        match bus {
            Bus::Full => return Err(nb::Error::WouldBlock),
            Bus::Unacknowledged if *holds_frame => return Err(nb::Error::WouldBlock),
            Bus::Unacknowledged => *holds_frame = true,
            Bus::Answered => gripper.receive(Instant::from_millis(0), frame, |event| {
                let Event::Frame(message) = event else { return };
                let value = match CommandId::from_code(message.id) {
                    CommandId::GetSystemState => Value::GetSystemState(SystemFlags::REFERENCED),
                    CommandId::GetGripperState => Value::GetGripperState(GripperState::Idle),
                    CommandId::GetSystemInfo => Value::GetSystemInfo(INFO),
                    CommandId::GetSystemLimits => Value::GetSystemLimits(LIMITS),
                    _ => return,
                };
                let bytes = FrameEncoder::new(message.id, Reply::success(value));
                let id = Identifiers::DEFAULT.gripper().transmit;
                answers.extend(Segments::new(bytes).filter_map(|segment| segment.frame::<ClassicFrame>(id)));
            }),
        }
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<ClassicFrame, Never> {
        self.answers.pop_front().ok_or(nb::Error::WouldBlock)
    }
}

impl CanController for Controller {
    fn health(&mut self) -> Health {
        Health::default()
    }

    fn withdraw(&mut self, _: Id) -> Withdrawal {
        self.withdrawals += 1;
        if std::mem::take(&mut self.holds_frame) { Withdrawal::Withdrawn } else { Withdrawal::TooLate }
    }

    fn abort(&mut self) {
        self.holds_frame = false;
    }

    fn recover(&mut self) {}
}

struct Rig {
    station: Station<Controller>,
    now_ms: u32,
}

impl Rig {
    fn on(bus: Bus) -> Self {
        let controller = Controller {
            bus,
            gripper: Reassembler::new(Identifiers::DEFAULT.gripper().receive, HALF_MESSAGE_MS),
            answers: VecDeque::new(),
            holds_frame: false,
            withdrawals: 0,
        };
        let buffers = Box::leak(Box::default());
        let mut station = Station::new(CanBus::new(controller, BusOffPolicy::DEFAULT), buffers);
        let record = Config { gripper_line: GripperLine::Can, ..Config::DEFAULT }.record();
        let config = station.load(&record, &NoFlash).unwrap();
        station.start(&config, BoardId::UNKNOWN, ResetCause::PowerOn);
        Self { station, now_ms: 0 }
    }

    /// Runs a turn with these wires. Returns whether it withdraws frames from the controller.
    fn turn(&mut self, inputs: Inputs) -> bool {
        let before = self.controller().withdrawals;
        self.now_ms += 1;
        let mut serial = GripperLink::new(Identifiers::DEFAULT);
        self.station.turn(self.now_ms, inputs, &mut serial, &mut NoBus, &mut NoBus, &mut NoFlash);
        self.controller().withdrawals > before
    }

    fn controller(&mut self) -> &mut Controller {
        self.station.can().controller()
    }
}

/// Otherwise the session's time-outs would not start, and LINK_OK would stay high beyond a second.
#[test]
fn messages_that_the_bus_does_not_take_for_100_ms_are_withdrawn() {
    let mut rig = Rig::on(Bus::Full);
    // FAST STOP is requested, and repeated in bursts.
    let first = (1..400).find(|_| rig.turn(Inputs::empty())).expect("a withdrawal");
    assert!((100..=150).contains(&first), "at {first} ms");
    assert!(rig.station.link().counters().broken > 0);
}

/// Otherwise they would be sent when the gripper returns.
#[test]
fn frames_are_withdrawn_at_once_if_the_gripper_stops_answering() {
    let mut rig = Rig::on(Bus::Answered);
    for _ in 0..200 {
        rig.turn(Inputs::FAST_STOP_OK);
    }
    assert!(rig.station.bridge().is_connected());
    rig.controller().bus = Bus::Unacknowledged;
    for _ in 0..1_000 {
        let withdraws = rig.turn(Inputs::FAST_STOP_OK);
        if !rig.station.bridge().is_connected() {
            assert!(withdraws, "in the turn in which the connection is lost");
            assert!(!rig.controller().holds_frame);
            return;
        }
    }
    panic!("the connection is not lost");
}
