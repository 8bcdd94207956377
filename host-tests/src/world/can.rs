//! A CAN bus in virtual time: the bridge's controller, which goes bus-off on request, a gripper, and a PLC.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use bus_slcan::ClassicFrame;
use embedded_can::{Frame, Id, StandardId};
use wsg_bridge_fw::can::{
    BusOffPolicy, CanConfig, CanController, DEFAULT_NODE, Health, NodeConfig, Withdrawal,
};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::{Config, GripperLine, PlcBus};
use wsg_protocol::can::{Endpoint, Identifiers, Reassembler, Segments};
use wsg_protocol::{CommandId, Event, Instant};
use wsg_sim::{MAX_FRAME_LEN, PortKind, Time};

use super::World;
use crate::serial_gripper::SerialGripper;

/// Frames per millisecond on a bus at 500 kbit/s.
pub(crate) const FRAMES_PER_MS: usize = 4;

/// Number of transmit mailboxes.
const MAILBOXES: usize = 3;

/// Modifies a frame in transit: one frame in, any number out.
pub type Disturbance = Box<dyn FnMut(ClassicFrame) -> Vec<ClassicFrame>>;

/// A typical controller with three mailboxes. It sends the lowest identifier first and queues one frame per
/// identifier. When all mailboxes are full, a more urgent frame displaces the least urgent one.
#[derive(Clone, Debug, Default)]
pub struct CanDouble(Rc<RefCell<DoubleState>>);

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

impl CanDouble {
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

    /// Returns whether frames are rejected or remain unacknowledged.
    #[must_use]
    pub fn is_blocked(&self) -> bool {
        let state = self.0.borrow();
        state.refuses || state.unheard
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
    pub fn deliver(&self, frame: ClassicFrame) {
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

impl embedded_can::nb::Can for CanDouble {
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

impl CanController for CanDouble {
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

/// Bytes of the longest message to the gripper.
const MESSAGE_LEN: usize = 128;

/// The bus: the bridge's controller, a gripper, and a PLC.
pub struct CanLine {
    /// The bridge's controller.
    pub double: CanDouble,
    /// Frames sent to the PLC with their times, and the PLC's queued frames.
    to_plc: Vec<(u32, ClassicFrame)>,
    from_plc: VecDeque<ClassicFrame>,
    /// The gripper's identifiers and queued frames.
    endpoint: Endpoint,
    from_gripper: VecDeque<ClassicFrame>,
    /// Reassembles messages from the bridge.
    seen: Reassembler<MESSAGE_LEN>,
    sent: Vec<CommandId>,
    /// Whether the PLC sends its heartbeat every 200 ms.
    pub beats: bool,
    /// Disturbance on the way to the gripper.
    pub to_gripper: Option<Disturbance>,
    /// Disturbance on the way to the bridge.
    pub to_bridge: Option<Disturbance>,
}

impl CanLine {
    pub(super) fn new(double: CanDouble, gripper: Identifiers) -> Self {
        Self {
            double,
            to_plc: Vec::new(),
            from_plc: VecDeque::new(),
            endpoint: gripper.gripper(),
            from_gripper: VecDeque::new(),
            seen: Reassembler::new(gripper.gripper().receive, 1_000),
            sent: Vec::new(),
            beats: false,
            to_gripper: None,
            to_bridge: None,
        }
    }

    /// Queues a frame from the PLC on the bus.
    pub fn queue(&mut self, frame: ClassicFrame) {
        self.from_plc.push_back(frame);
    }

    /// Queues a data frame from the PLC on the bus.
    ///
    /// # Panics
    /// Panics when the identifier has more than 11 bits, or the data more than 8 bytes.
    pub fn send(&mut self, id: u16, data: &[u8]) {
        let id = StandardId::new(id).expect("11 bits");
        self.queue(ClassicFrame::new(id, data).expect("up to 8 bytes"));
    }

    /// Returns the frames sent by the bridge since the last call: time in milliseconds, identifier and data.
    ///
    /// # Panics
    /// Panics when a frame has 29 bits.
    pub fn take_frames(&mut self) -> Vec<(u32, u16, Vec<u8>)> {
        let frames = std::mem::take(&mut self.to_plc).into_iter().map(|(at, frame)| {
            let Id::Standard(id) = frame.id() else { panic!("{frame:?}") };
            (at, id.as_raw(), frame.data().to_vec())
        });
        frames.collect()
    }

    /// Returns the number of broken messages sent by the bridge.
    #[must_use]
    pub fn broken(&self) -> u16 {
        let counters = self.seen.counters();
        counters.miscut + counters.bad_checksum + counters.oversize + counters.expired
    }

    pub(super) fn take_sent(&mut self) -> Vec<CommandId> {
        std::mem::take(&mut self.sent)
    }

    /// Sends the PLC's heartbeat when it is due.
    pub(super) fn beat(&mut self, now_ms: u32) {
        if self.beats && now_ms.is_multiple_of(200) {
            self.send(0x700 | u16::from(DEFAULT_NODE.master), &[5]);
        }
    }

    /// Carries one frame: the bridge's, the PLC's, or the gripper's.
    pub(super) fn carry_frame<W>(&mut self, now_ms: u32, gripper: &mut SerialGripper<W>) {
        if let Some(frame) = self.double.take_winner() {
            self.deliver_to_gripper(now_ms, gripper, frame);
        } else if let Some(frame) = self.from_plc.pop_front() {
            self.double.deliver(frame);
        } else if let Some(frame) = self.from_gripper.pop_front() {
            let frames = disturbed(&mut self.to_bridge, frame);
            frames.into_iter().for_each(|frame| self.double.deliver(frame));
        }
    }

    /// Delivers a frame of the bridge.
    fn deliver_to_gripper<W>(&mut self, now_ms: u32, gripper: &mut SerialGripper<W>, frame: ClassicFrame) {
        self.to_plc.push((now_ms, frame));
        let Self { seen, sent, .. } = self;
        seen.receive(Instant::from_millis(now_ms), &frame, |event| {
            if let Event::Frame(message) = event {
                sent.push(CommandId::from_code(message.id));
            }
        });
        for frame in disturbed(&mut self.to_gripper, frame) {
            if frame.id() == Id::Standard(self.endpoint.receive) && gripper.kind == PortKind::Can {
                let now = Time::from_millis(now_ms.into());
                gripper.gripper.receive(gripper.port, now, frame.data());
            }
        }
    }

    /// Queues the frames that the gripper has to send.
    pub(super) fn fetch<W>(&mut self, gripper: &mut SerialGripper<W>) {
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(message) = gripper.gripper.transmit(gripper.port, &mut buffer) {
            let segments = Segments::new(message.iter().copied());
            self.from_gripper
                .extend(segments.filter_map(|segment| segment.frame::<ClassicFrame>(self.endpoint.transmit)));
        }
    }
}

impl Clone for CanLine {
    /// Only a bus without traffic can be cloned: a controller is shared by its clones.
    fn clone(&self) -> Self {
        assert!(self.to_plc.is_empty() && self.from_plc.is_empty() && self.from_gripper.is_empty());
        Self::new(self.double.clone(), Identifiers::DEFAULT)
    }
}

/// A bridge with its gripper on CAN.
pub const GRIPPER_ON_CAN: Config =
    Config { gripper_line: GripperLine::Can, plc_bus: PlcBus::Off, ..Config::DEFAULT };

impl World {
    /// Creates a world with gripper and PLC on CAN, and FAST_STOP_OK high.
    #[must_use]
    pub fn with_node(gripper: wsg_sim::Config, node: NodeConfig) -> Self {
        let can = CanConfig { node, ..CanConfig::DEFAULT };
        let mut world = Self::new(Config { plc_bus: PlcBus::Canopen, can, ..GRIPPER_ON_CAN }, gripper);
        world.set(Inputs::FAST_STOP_OK, true);
        world
    }

    /// Creates a world that is READY and REFERENCED, with a gripper on a CAN bus that recovers according to `policy`.
    #[must_use]
    pub fn homed_on_can(gripper: wsg_sim::Config, policy: BusOffPolicy) -> Self {
        let mut world = Self::with_policy(GRIPPER_ON_CAN, gripper, policy);
        world.get_homed();
        world
    }

    /// Ends the transmission [begun](CanDouble::begin_frame) by the controller.
    pub fn end_frame(&mut self, is_acknowledged: bool) {
        if let Some(frame) = self.can.double.end_frame(is_acknowledged) {
            self.can.deliver_to_gripper(self.now_ms, &mut self.far, frame);
        }
    }
}

fn disturbed(disturbance: &mut Option<Disturbance>, frame: ClassicFrame) -> Vec<ClassicFrame> {
    match disturbance {
        Some(disturb) => disturb(frame),
        None => vec![frame],
    }
}
