//! Bridge and virtual gripper on a CAN bus in virtual time, with a controller that can be made to go bus-off.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use bus_slcan::ClassicFrame;
use embedded_can::{Frame, Id};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanConfig, CanController, Health, NodeConfig, Withdrawal};
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

/// Frames that a bus at 500 kbit/s carries in a millisecond.
const FRAMES_PER_MS: usize = 4;

/// Of a station without PROFIBUS; all may have the same.
pub static NO_PROFIBUS: DpBuffers = DpBuffers::new();

/// Mailboxes of the controller.
const MAILBOXES: usize = 3;

/// What becomes of a frame on its way: none, one or more frames.
pub type Disturbance = Box<dyn FnMut(ClassicFrame) -> Vec<ClassicFrame>>;

/// A controller as boards may have it: three mailboxes, the lowest identifier first, one frame of an identifier at a time,
/// and when all are taken a more urgent frame takes the place of the least urgent one.
#[derive(Clone, Debug, Default)]
pub struct Double(Rc<RefCell<DoubleState>>);

#[derive(Debug, Default)]
struct DoubleState {
    mailboxes: Vec<ClassicFrame>,
    received: VecDeque<ClassicFrame>,
    health: Health,
    /// How many calls of `recover` do not help.
    recoveries_in_vain: u32,
    recoveries: u32,
    aborts: u32,
    /// The frame that is on the bus now, one of none of the mailboxes.
    on_wire: Option<ClassicFrame>,
    /// What becomes of its withdrawal, once it was asked for.
    withdrawal: Option<Withdrawal>,
    withdrawn: u32,
    overrun: bool,
    refuses: bool,
    /// Nobody acknowledges: frames stay in the mailboxes.
    unheard: bool,
}

impl Double {
    /// Goes bus-off now, and stays so through this many tries to come back.
    pub fn go_off(&self, recoveries_in_vain: u32) {
        let mut state = self.0.borrow_mut();
        state.health = Health { is_off: true, is_passive: true, transmit_errors: 255, receive_errors: 3 };
        state.recoveries_in_vain = recoveries_in_vain;
    }

    /// Sees the bus like this from now on.
    pub fn set_health(&self, health: Health) {
        self.0.borrow_mut().health = health;
    }

    /// How often it was told to come back.
    #[must_use]
    pub fn recoveries(&self) -> u32 {
        self.0.borrow().recoveries
    }

    /// How often it was told to forget what it had to send.
    #[must_use]
    pub fn aborts(&self) -> u32 {
        self.0.borrow().aborts
    }

    /// The frames that wait in its mailboxes.
    #[must_use]
    pub fn waiting(&self) -> Vec<ClassicFrame> {
        self.0.borrow().mailboxes.clone()
    }

    /// How many frames were withdrawn from it one by one.
    #[must_use]
    pub fn withdrawn(&self) -> u32 {
        self.0.borrow().withdrawn
    }

    /// Begins to send the most urgent frame, heard or not, and returns it.
    pub fn begin_frame(&self) -> Option<ClassicFrame> {
        let mut state = self.0.borrow_mut();
        state.on_wire = state.take_most_urgent();
        state.on_wire
    }

    /// Ends that frame, which is returned if it was acknowledged, and repeated otherwise.
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

    /// Loses the next frame for want of room.
    pub fn overrun(&self) {
        self.0.borrow_mut().overrun = true;
    }

    /// Refuses frames, or takes them again.
    pub fn refuse(&self, refuses: bool) {
        self.0.borrow_mut().refuses = refuses;
    }

    /// Nobody is on the bus who acknowledges frames, or somebody is again.
    pub fn set_unheard(&self, unheard: bool) {
        self.0.borrow_mut().unheard = unheard;
    }

    /// The frame that wins on the bus.
    pub fn take_winner(&self) -> Option<ClassicFrame> {
        let mut state = self.0.borrow_mut();
        if state.health.is_off || state.unheard {
            return None;
        }
        state.take_most_urgent()
    }

    /// Brings a frame from the bus.
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

/// The controller had no room, or refuses.
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

/// Bridge and gripper on a bus, and a PLC on wires that a test plays.
pub struct CanBench {
    station: Station<Double>,
    flash: FlashModel,
    double: Double,
    /// What a PLC on the bus hears, and what it says next.
    to_plc: Vec<(u32, ClassicFrame)>,
    from_plc: VecDeque<ClassicFrame>,
    gripper: VirtualGripper<1>,
    port: PortId,
    endpoint: Endpoint,
    from_gripper: VecDeque<ClassicFrame>,
    now_ms: u32,
    inputs: Inputs,
    outputs: Outputs,
    /// Finds messages in what the bridge sends.
    seen: Reassembler<128>,
    sent: Vec<CommandId>,
    /// On the way to the gripper.
    pub to_gripper: Option<Disturbance>,
    /// On the way to the bridge.
    pub to_bridge: Option<Disturbance>,
}

/// What a bench runs on.
pub const BOARD: BoardId = BoardId { name: "bench", serial: 0x1234_5678 };

impl CanBench {
    /// A bench with all wires of the PLC low.
    ///
    /// # Panics
    /// Never: a new gripper takes a client, and the delivered settings are good ones.
    #[must_use]
    pub fn new(config: wsg_sim::Config, policy: BusOffPolicy) -> Self {
        Self::with(config, policy, Config { plc_bus: PlcBus::Off, ..Config::DEFAULT })
    }

    fn with(config: wsg_sim::Config, policy: BusOffPolicy, bridge: Config) -> Self {
        let identifiers = bridge.can.gripper;
        let mut gripper = VirtualGripper::with_ports(config);
        let port = gripper.connect(PortKind::Can).expect("a new gripper takes a client");
        let double = Double::default();
        let mut station = Station::new(CanBus::new(double.clone(), policy), &NO_PROFIBUS);
        let flash = FlashModel::new();
        station.load(&Config::DEFAULT.record(), &flash).expect("the delivered settings are good ones");
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
            to_gripper: None,
            to_bridge: None,
        }
    }

    /// A bench that is READY and REFERENCED.
    ///
    /// # Panics
    /// When it does not become so.
    #[must_use]
    pub fn homed(config: wsg_sim::Config, policy: BusOffPolicy) -> Self {
        let mut bench = Self::new(config, policy);
        bench.get_homed();
        bench
    }

    /// A bench with a PLC on the bus, and wires that let it: FAST_STOP_OK high.
    #[must_use]
    pub fn with_node(config: wsg_sim::Config, node: NodeConfig) -> Self {
        let can = CanConfig { node, ..CanConfig::DEFAULT };
        let bridge = Config { plc_bus: PlcBus::Canopen, can, ..Config::DEFAULT };
        let mut bench = Self::with(config, BusOffPolicy::DEFAULT, bridge);
        bench.set(Inputs::FAST_STOP_OK, true);
        bench
    }

    /// The bridge as a device on the bus; silent on a bench without a PLC there.
    #[must_use]
    pub const fn node(&self) -> &Node {
        self.station.node()
    }

    /// The PLC on the bus says this, after what it has said before.
    pub fn say(&mut self, frame: ClassicFrame) {
        self.from_plc.push_back(frame);
    }

    /// What the PLC has heard since this was last asked, with the moment in milliseconds.
    pub fn take_heard(&mut self) -> Vec<(u32, ClassicFrame)> {
        std::mem::take(&mut self.to_plc)
    }

    /// The controller.
    #[must_use]
    pub fn double(&self) -> &Double {
        &self.double
    }

    /// The bus, as the bridge sees it.
    #[must_use]
    pub fn bus(&mut self) -> &mut CanBus<Double> {
        self.station.can()
    }

    /// The gripper's link.
    #[must_use]
    pub fn link(&self) -> &GripperLink {
        self.station.link()
    }

    /// The gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.gripper
    }

    /// The flash.
    pub fn flash(&mut self) -> &mut FlashModel {
        &mut self.flash
    }

    /// The moment, in milliseconds.
    #[must_use]
    pub fn now_ms(&self) -> u32 {
        self.now_ms
    }

    /// Messages of the bridge that were broken when they left it.
    #[must_use]
    pub fn broken(&self) -> u16 {
        let counters = self.seen.counters();
        counters.miscut + counters.bad_checksum + counters.oversize + counters.expired
    }

    /// One turn of the main loop.
    fn turn(&mut self) {
        let Self { station, now_ms, inputs, flash, .. } = self;
        let line = &mut SerialLine::with_room(0);
        self.outputs = station.turn(*now_ms, *inputs, line, &mut NoBus, &mut NoBus, flash);
    }

    /// Ends the frame that the controller has [begun](Double::begin_frame).
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

impl Wires for CanBench {
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
            // A frame that left makes an interrupt, and that a turn of the main loop.
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

impl std::fmt::Debug for CanBench {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CanBench")
            .field("now_ms", &self.now_ms)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}
