//! Bridge and virtual gripper on a CAN bus in virtual time, with a controller that goes bus-off on request.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use bus_slcan::ClassicFrame;
use embedded_can::{Frame, Id, StandardId};
use wsg_bridge_fw::can::{
    BusOffPolicy, CanBus, CanConfig, CanController, DEFAULT_NODE, Health, NodeConfig, Withdrawal,
};
use wsg_bridge_fw::gripper::GripperLink;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::DpBuffers;
use wsg_bridge_fw::plc::canopen::Node;
use wsg_bridge_fw::{BoardId, Config, GripperLine, NoBus, PlcBus, ResetCause, Station};
use wsg_protocol::can::{Endpoint, Reassembler, Segments};
use wsg_protocol::{CommandId, Event, Instant};
use wsg_sim::{MAX_FRAME_LEN, PortId, PortKind, Time, VirtualGripper};

use crate::flash_model::FlashModel;
use crate::serial_gripper::SerialLine;
use crate::wires::Wires;

/// Frames per millisecond on a bus at 500 kbit/s.
const FRAMES_PER_MS: usize = 4;

/// Shared buffers for stations without PROFIBUS.
pub static NO_PROFIBUS: DpBuffers = DpBuffers::new();

/// Number of transmit mailboxes.
const MAILBOXES: usize = 3;

/// Modifies a frame in transit: one frame in, any number out.
pub type Disturbance = Box<dyn FnMut(ClassicFrame) -> Vec<ClassicFrame>>;

/// A typical controller with three mailboxes. It sends the lowest identifier first and queues one frame per
/// identifier. When all mailboxes are full, a more urgent frame displaces the least urgent one.
#[derive(Clone, Debug, Default)]
pub struct Double(Rc<RefCell<DoubleState>>);

#[derive(Debug, Default)]
struct DoubleState {
    mailboxes: Vec<ClassicFrame>,
    received: VecDeque<ClassicFrame>,
    health: Health,
    /// Number of `recover` calls that remain without effect.
    recoveries_in_vain: u32,
    recoveries: u32,
    aborts: u32,
    /// The frame in transmission; it occupies no mailbox.
    on_wire: Option<ClassicFrame>,
    /// Outcome of a withdrawal in progress.
    withdrawal: Option<Withdrawal>,
    withdrawn: u32,
    overrun: bool,
    refuses: bool,
    /// Whether frames remain unacknowledged and stay in the mailboxes.
    unheard: bool,
}

impl Double {
    /// Goes bus-off and ignores this many recovery attempts.
    pub fn go_off(&self, recoveries_in_vain: u32) {
        let mut state = self.0.borrow_mut();
        state.health = Health { is_off: true, is_passive: true, transmit_errors: 255, receive_errors: 3 };
        state.recoveries_in_vain = recoveries_in_vain;
    }

    /// Sets the reported bus state.
    pub fn set_health(&self, health: Health) {
        self.0.borrow_mut().health = health;
    }

    /// Returns the number of recovery requests.
    #[must_use]
    pub fn recoveries(&self) -> u32 {
        self.0.borrow().recoveries
    }

    /// Returns the number of abort requests.
    #[must_use]
    pub fn aborts(&self) -> u32 {
        self.0.borrow().aborts
    }

    /// Returns the frames in the mailboxes.
    #[must_use]
    pub fn waiting(&self) -> Vec<ClassicFrame> {
        self.0.borrow().mailboxes.clone()
    }

    /// Returns the number of frames withdrawn individually.
    #[must_use]
    pub fn withdrawn(&self) -> u32 {
        self.0.borrow().withdrawn
    }

    /// Starts to transmit the most urgent frame and returns it.
    pub fn begin_frame(&self) -> Option<ClassicFrame> {
        let mut state = self.0.borrow_mut();
        state.on_wire = state.take_most_urgent();
        state.on_wire
    }

    /// Ends the transmission. An acknowledged frame is returned; any other is queued again.
    pub fn end_frame(&self, is_acknowledged: bool) -> Option<ClassicFrame> {
        let mut state = self.0.borrow_mut();
        let frame = state.on_wire.take()?;
        let is_withdrawn = state.withdrawal.is_some() && !is_acknowledged;
        if let Some(outcome) = &mut state.withdrawal {
            *outcome = Withdrawal::of(false, is_acknowledged);
        }
        state.withdrawn += u32::from(is_withdrawn);
        if is_acknowledged {
            return Some(frame);
        }
        if !is_withdrawn {
            state.mailboxes.push(frame);
        }
        None
    }

    /// Loses the next received frame to an overrun.
    pub fn overrun(&self) {
        self.0.borrow_mut().overrun = true;
    }

    /// Sets whether frames are rejected.
    pub fn refuse(&self, refuses: bool) {
        self.0.borrow_mut().refuses = refuses;
    }

    /// Sets whether frames remain unacknowledged.
    pub fn set_unheard(&self, unheard: bool) {
        self.0.borrow_mut().unheard = unheard;
    }

    /// Removes and returns the frame that wins arbitration.
    pub fn take_winner(&self) -> Option<ClassicFrame> {
        let mut state = self.0.borrow_mut();
        if state.health.is_off || state.unheard {
            return None;
        }
        state.take_most_urgent()
    }

    /// Delivers a frame from the bus.
    pub fn bring(&self, frame: ClassicFrame) {
        let mut state = self.0.borrow_mut();
        if !state.health.is_off {
            state.received.push_back(frame);
        }
    }
}

impl DoubleState {
    fn take_most_urgent(&mut self) -> Option<ClassicFrame> {
        let winner = (0..self.mailboxes.len()).min_by_key(|&at| priority(&self.mailboxes[at]))?;
        Some(self.mailboxes.remove(winner))
    }
}

/// Error of the controller: no room, or a rejected frame.
#[derive(Debug)]
pub struct Trouble;

impl embedded_can::Error for Trouble {
    fn kind(&self) -> embedded_can::ErrorKind {
        embedded_can::ErrorKind::Other
    }
}

impl embedded_can::nb::Can for Double {
    type Frame = ClassicFrame;
    type Error = Trouble;

    fn transmit(&mut self, frame: &ClassicFrame) -> nb::Result<Option<ClassicFrame>, Trouble> {
        let mut state = self.0.borrow_mut();
        if state.refuses {
            return Err(nb::Error::Other(Trouble));
        }
        let mut pending = state.mailboxes.iter().chain(&state.on_wire);
        if pending.any(|pending| priority(pending) <= priority(frame)) {
            return Err(nb::Error::WouldBlock);
        }
        let mut displaced = None;
        if state.mailboxes.len() + usize::from(state.on_wire.is_some()) == MAILBOXES {
            let least = (0..state.mailboxes.len()).max_by_key(|&at| priority(&state.mailboxes[at]));
            displaced = least.map(|at| state.mailboxes.remove(at));
        }
        state.mailboxes.push(*frame);
        Ok(displaced)
    }

    fn receive(&mut self) -> nb::Result<ClassicFrame, Trouble> {
        let mut state = self.0.borrow_mut();
        let frame = state.received.pop_front().ok_or(nb::Error::WouldBlock)?;
        if std::mem::take(&mut state.overrun) { Err(nb::Error::Other(Trouble)) } else { Ok(frame) }
    }
}

impl CanController for Double {
    fn health(&mut self) -> Health {
        self.0.borrow().health
    }

    fn withdraw(&mut self, id: Id) -> Withdrawal {
        let mut state = self.0.borrow_mut();
        if state.on_wire.is_some_and(|frame| frame.id() == id) {
            return *state.withdrawal.insert(Withdrawal::Undecided);
        }
        if let Some(outcome) = state.withdrawal.take() {
            return outcome;
        }
        let Some(at) = state.mailboxes.iter().position(|frame| frame.id() == id) else {
            return Withdrawal::TooLate;
        };
        state.mailboxes.remove(at);
        state.withdrawn += 1;
        Withdrawal::Withdrawn
    }

    fn abort(&mut self) {
        let mut state = self.0.borrow_mut();
        state.mailboxes.clear();
        (state.on_wire, state.withdrawal) = (None, None);
        state.aborts += 1;
    }

    fn recover(&mut self) {
        let mut state = self.0.borrow_mut();
        state.recoveries += 1;
        match state.recoveries_in_vain.checked_sub(1) {
            Some(left) => state.recoveries_in_vain = left,
            None => state.health = Health::default(),
        }
    }
}

fn priority(frame: &ClassicFrame) -> u32 {
    match frame.id() {
        Id::Standard(id) => u32::from(id.as_raw()) << 18,
        Id::Extended(id) => id.as_raw(),
    }
}

/// Bridge and gripper on a CAN bus, and a PLC on wires driven by the test.
pub struct CanRig {
    station: Station<Double>,
    flash: FlashModel,
    double: Double,
    /// Frames sent to the PLC with their times, and the PLC's queued frames.
    to_plc: Vec<(u32, ClassicFrame)>,
    from_plc: VecDeque<ClassicFrame>,
    gripper: VirtualGripper<1>,
    port: PortId,
    endpoint: Endpoint,
    from_gripper: VecDeque<ClassicFrame>,
    now_ms: u32,
    inputs: Inputs,
    outputs: Outputs,
    /// Reassembles messages from the bridge.
    seen: Reassembler<128>,
    sent: Vec<CommandId>,
    /// Whether the PLC sends its heartbeat every 200 ms.
    pub beats: bool,
    /// Disturbance on the way to the gripper.
    pub to_gripper: Option<Disturbance>,
    /// Disturbance on the way to the bridge.
    pub to_bridge: Option<Disturbance>,
}

/// Board identity of the rig.
pub const BOARD: BoardId = BoardId { name: "rig", serial: 0x1234_5678 };

impl CanRig {
    /// Creates a rig with all PLC wires low.
    ///
    /// # Panics
    /// Never: a new gripper accepts a client, and the default settings are valid.
    #[must_use]
    pub fn new(config: wsg_sim::Config, policy: BusOffPolicy) -> Self {
        Self::with(config, policy, Config { plc_bus: PlcBus::Off, ..Config::DEFAULT })
    }

    fn with(config: wsg_sim::Config, policy: BusOffPolicy, bridge: Config) -> Self {
        let identifiers = bridge.can.gripper;
        let mut gripper = VirtualGripper::with_ports(config);
        let port = gripper.connect(PortKind::Can).expect("a new gripper accepts a client");
        let double = Double::default();
        let mut station = Station::new(CanBus::new(double.clone(), policy), &NO_PROFIBUS);
        let flash = FlashModel::new();
        station.load(&Config::DEFAULT.record(), &flash).expect("the default settings are valid");
        station.start(&Config { gripper_line: GripperLine::Can, ..bridge }, BOARD, ResetCause::Unknown);
        Self {
            station,
            flash,
            double,
            to_plc: Vec::new(),
            from_plc: VecDeque::new(),
            gripper,
            port,
            endpoint: identifiers.gripper(),
            from_gripper: VecDeque::new(),
            now_ms: 0,
            inputs: Inputs::empty(),
            outputs: Outputs::empty(),
            seen: Reassembler::new(identifiers.gripper().receive, 1_000),
            sent: Vec::new(),
            beats: false,
            to_gripper: None,
            to_bridge: None,
        }
    }

    /// Creates a rig that is READY and REFERENCED.
    ///
    /// # Panics
    /// Panics when homing fails.
    #[must_use]
    pub fn homed(config: wsg_sim::Config, policy: BusOffPolicy) -> Self {
        let mut rig = Self::new(config, policy);
        rig.get_homed();
        rig
    }

    /// Creates a rig with a PLC on the bus and FAST_STOP_OK high.
    #[must_use]
    pub fn with_node(config: wsg_sim::Config, node: NodeConfig) -> Self {
        let can = CanConfig { node, ..CanConfig::DEFAULT };
        let bridge = Config { plc_bus: PlcBus::Canopen, can, ..Config::DEFAULT };
        let mut rig = Self::with(config, BusOffPolicy::DEFAULT, bridge);
        rig.set(Inputs::FAST_STOP_OK, true);
        rig
    }

    /// Returns the bridge's CANopen node; it is silent without a PLC on the bus.
    #[must_use]
    pub const fn node(&self) -> &Node {
        self.station.node()
    }

    /// Queues a frame from the PLC on the bus.
    pub fn say(&mut self, frame: ClassicFrame) {
        self.from_plc.push_back(frame);
    }

    /// Queues a data frame from the PLC on the bus.
    ///
    /// # Panics
    /// Panics when the identifier has more than 11 bits, or the data more than 8 bytes.
    pub fn send(&mut self, id: u16, data: &[u8]) {
        let id = StandardId::new(id).expect("11 bits");
        self.say(ClassicFrame::new(id, data).expect("up to 8 bytes"));
    }

    /// Returns the frames sent to the PLC since the last call: time in milliseconds, identifier and data.
    ///
    /// # Panics
    /// Panics when a frame has 29 bits.
    pub fn take_heard(&mut self) -> Vec<(u32, u16, Vec<u8>)> {
        let heard = std::mem::take(&mut self.to_plc).into_iter().map(|(at, frame)| {
            let Id::Standard(id) = frame.id() else { panic!("{frame:?}") };
            (at, id.as_raw(), frame.data().to_vec())
        });
        heard.collect()
    }

    /// Returns the controller.
    #[must_use]
    pub fn double(&self) -> &Double {
        &self.double
    }

    /// Returns the bridge's view of the bus.
    #[must_use]
    pub fn bus(&mut self) -> &mut CanBus<Double> {
        self.station.can()
    }

    /// Returns the link to the gripper.
    #[must_use]
    pub fn link(&self) -> &GripperLink {
        self.station.link()
    }

    /// Returns the gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.gripper
    }

    /// Returns the flash.
    pub fn flash(&mut self) -> &mut FlashModel {
        &mut self.flash
    }

    /// Returns the current time in milliseconds.
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.now_ms
    }

    /// Returns the number of broken messages sent by the bridge.
    #[must_use]
    pub fn broken(&self) -> u16 {
        let counters = self.seen.counters();
        counters.miscut + counters.bad_checksum + counters.oversize + counters.expired
    }

    /// Runs one turn of the main loop.
    fn turn(&mut self) {
        let Self { station, now_ms, inputs, flash, .. } = self;
        let line = &mut SerialLine::with_room(0);
        self.outputs = station.turn(*now_ms, *inputs, line, &mut NoBus, &mut NoBus, flash);
    }

    /// Ends the transmission [begun](Double::begin_frame) by the controller.
    pub fn end_frame(&mut self, is_acknowledged: bool) {
        if let Some(frame) = self.double.end_frame(is_acknowledged) {
            self.to_plc.push((self.now_ms, frame));
            self.reach_gripper(frame);
        }
    }

    fn reach_gripper(&mut self, frame: ClassicFrame) {
        let (now, time) = (Instant::from_millis(self.now_ms), Time::from_millis(self.now_ms.into()));
        let Self { seen, sent, .. } = self;
        seen.receive(now, &frame, |event| {
            if let Event::Frame(message) = event {
                sent.push(CommandId::from_code(message.id));
            }
        });
        for frame in disturbed(&mut self.to_gripper, frame) {
            if frame.id() == Id::Standard(self.endpoint.receive) {
                self.gripper.receive(self.port, time, frame.data());
            }
        }
    }
}

impl Wires for CanRig {
    fn inputs(&mut self) -> &mut Inputs {
        &mut self.inputs
    }

    fn outputs(&self) -> Outputs {
        self.outputs
    }

    fn take_sent(&mut self) -> Vec<CommandId> {
        std::mem::take(&mut self.sent)
    }

    fn step(&mut self) {
        if self.beats && self.now_ms.is_multiple_of(200) {
            self.send(0x700 | u16::from(DEFAULT_NODE.master), &[5]);
        }
        self.now_ms += 1;
        self.turn();
        let time = Time::from_millis(self.now_ms.into());
        for _ in 0..FRAMES_PER_MS {
            if let Some(frame) = self.double.take_winner() {
                self.to_plc.push((self.now_ms, frame));
                self.reach_gripper(frame);
            } else if let Some(frame) = self.from_plc.pop_front() {
                self.double.bring(frame);
            } else if let Some(frame) = self.from_gripper.pop_front() {
                let frames = disturbed(&mut self.to_bridge, frame);
                frames.into_iter().for_each(|frame| self.double.bring(frame));
            }
            // A transmitted frame raises an interrupt, which wakes the main loop.
            self.turn();
        }
        self.gripper.advance(time);
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(message) = self.gripper.transmit(self.port, &mut buffer) {
            let segments = Segments::new(message.iter().copied());
            self.from_gripper
                .extend(segments.filter_map(|segment| segment.frame::<ClassicFrame>(self.endpoint.transmit)));
        }
    }
}

fn disturbed(disturbance: &mut Option<Disturbance>, frame: ClassicFrame) -> Vec<ClassicFrame> {
    match disturbance {
        Some(disturb) => disturb(frame),
        None => vec![frame],
    }
}

impl std::fmt::Debug for CanRig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CanRig")
            .field("now_ms", &self.now_ms)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}
