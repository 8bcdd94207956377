//! The whole bridge with a PLC on a CAN bus and on wires, and a gripper on the bus or on RS-232, with arbitrary
//! frames and bus faults.
//!
//! Properties:
//! - the [`Promises`]: commands follow only edges of wires, or of 8-byte RPDOs to an operational device. FAST
//!   STOP is sent as soon as the previous message is complete on the bus, or at once on RS-232. The outputs are true
//! - the watchdog may be fed
//! - the device state follows CANopen's NMT and the master's silence. Without operation or with a disabled RPDO the
//!   bus has no control ([`Device`]). A synchronous RPDO takes effect at SYNC. Remote frames, 29-bit identifiers and
//!   other lengths have no effect
//! - each message to a gripper on the bus is sent at most once, complete and in order. None predates the loss of the
//!   bus or the connection. No motion or acknowledgement predates a stop, except for the spoilt rest of one
//!
//! A case ends when no answer shows whether an SDO changed a setting.

use bus_slcan::ClassicFrame;
use embedded_can::{ExtendedId, Frame as _, Id, StandardId};
use wsg_bridge_fw::can::{
    BusOffPolicy, CanBus, CanController as _, CanNode, DEFAULT_NODE, Health, LinkCounters,
};
use wsg_bridge_fw::gripper::GripperLink;
use wsg_bridge_fw::io::Outputs;
use wsg_bridge_fw::plc::canopen::{NmtState, Node, SETTINGS_INDEX};
use wsg_bridge_fw::{Bridge, BusConfig, Config, ControlSource};
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::can::{Identifiers, Reassembler};
use wsg_protocol::{CommandId, Event, FrameEncoder, Instant, Kind};

use super::can::frames_with;
use super::gripper::PREAMBLE;
use super::input::Input;
use super::tap::Tap;
use super::whole::{self, Ends, FLAGS, PARAMETERS, WholeBridge, pick_answer, pick_edge, pick_image};
use crate::gripper_states::Message;
use crate::operation::{CanEvent, Operation, image};
use crate::promises::Promises;
use crate::world::can::{CanDouble, FRAMES_PER_MS};

const NODE: u16 = DEFAULT_NODE.node as u16;
const NMT: u16 = 0;
const RPDO: u16 = 0x200 | NODE;
const SDO_REQUEST: u16 = 0x600 | NODE;
const SDO_ANSWER: u16 = 0x580 | NODE;
const HEARTBEAT: u16 = 0x700;
const SYNC: u16 = 0x080;
const TO_GRIPPER: u16 = 0x120;
const FROM_GRIPPER: u16 = 0x121;

const IDS: [u16; 10] = [
    NMT,
    RPDO,
    SDO_REQUEST,
    HEARTBEAT | DEFAULT_NODE.master as u16,
    HEARTBEAT | NODE,
    TO_GRIPPER,
    FROM_GRIPPER,
    SDO_ANSWER,
    RPDO + 1,
    SYNC,
];

const NMT_COMMANDS: [u8; 6] = [0x01, 0x02, 0x80, 0x81, 0x82, 0x00];

/// Objects written by a master: settings, its heartbeat time, and some that are not tracked.
const OBJECTS: [(u16, u8); 12] = [
    (SETTINGS_INDEX, TIMEOUT_SUB),
    (SETTINGS_INDEX, TIMEOUT_SUB + 1),
    (SETTINGS_INDEX, DEBOUNCE_SUB),
    MASTER,
    COB_ID,
    TRANSMISSION,
    ERROR_BEHAVIOUR,
    (0x1600, 0),
    (0x1017, 0),
    (0x1800, 3),
    (0x2000, 1),
    (0x2101, 1),
];
/// Subindices of BUS_TIMEOUT and DEBOUNCE.
const TIMEOUT_SUB: u8 = 2;
const DEBOUNCE_SUB: u8 = 7;
const MASTER: (u16, u8) = (0x1016, 1);
const COB_ID: (u16, u8) = (0x1400, 1);
const TRANSMISSION: (u16, u8) = (0x1400, 2);
const ERROR_BEHAVIOUR: (u16, u8) = (0x1029, 1);

/// A node that is not the PLC.
const OTHER_NODE: u16 = 5;

/// Maximum number of frames per turn; a turn processes more.
const BURST: usize = 8;

/// Reference model of the CANopen device.
struct Device {
    state: NmtState,
    master: u16,
    received_ms: Option<u32>,
    has_heartbeat: bool,
    /// Whether the master's heartbeat is monitored.
    watches: bool,
    /// Whether the RPDO is enabled, its transmission type, and the image that waits for SYNC.
    is_enabled: bool,
    transmission: u8,
    waiting: Option<OutputImage>,
    /// State entered when the bus or the master is lost during operation.
    behaviour: NmtState,
    timeout_ms: u32,
    debounce_ms: u32,
    /// Events in this turn: images, loss of control, a reset.
    events: Vec<BusEvent>,
    /// The pending SDO request.
    request: Option<[u8; 8]>,
}

enum BusEvent {
    Image(OutputImage),
    Left,
    Reset { whole: bool },
}

pub(super) struct Model {
    bridge: Bridge,
    bus: CanBus<CanDouble>,
    double: CanDouble,
    /// The gripper's link, when it is on the bus.
    link: Tap<GripperLink>,
    is_on_rs_232: bool,
    node: Node,
    /// Messages that have not been sent, with the times of their queueing.
    queued: Vec<(Message, u32)>,
    /// Reassembles sent messages.
    left: Reassembler<8>,
    /// Whether the controller was requested to discard frames, or rejected some.
    is_troubled: bool,
    /// Whether a message was withdrawn, so that its rest may be sent spoilt.
    is_spoilt: bool,
    /// The message withdrawn in the previous turn.
    withdrawn: Option<CommandId>,
    /// Whether the link withdraws all of its messages.
    takes_all_back: bool,
    was_connected: bool,
    /// Whether the first frame since the last turn is lost.
    overrun: bool,
    delivered: Vec<ClassicFrame>,
    /// Whether the bus was lost in the previous turn.
    was_lost: bool,
    device: Device,
    ends: Ends,
}

/// The first byte also puts the gripper on RS-232 (bit 1). Each further op is a byte with parameter bytes: wires,
/// time, frames, gripper replies, PLC commands, faults. Without bit 7 a millisecond passes after it.
pub fn bridge_can(data: &[u8]) {
    whole::run::<Model>(data);
}

fn standard(id: u16) -> StandardId {
    StandardId::new(id % 0x800).unwrap_or(StandardId::ZERO)
}

/// Returns the 29-bit identifier with the same arbitration as the 11-bit one, or with the same number.
fn extended(id: u16) -> ExtendedId {
    let raw = if id & 0x800 == 0 { u32::from(id) } else { u32::from(id & 0x7FF) << 18 };
    ExtendedId::new(raw).unwrap_or(ExtendedId::ZERO)
}

impl Device {
    fn new() -> Self {
        Self {
            state: NmtState::Initialising,
            master: DEFAULT_NODE.master.into(),
            received_ms: None,
            has_heartbeat: false,
            watches: true,
            is_enabled: true,
            transmission: 255,
            waiting: None,
            behaviour: NmtState::PreOperational,
            timeout_ms: BusConfig::DEFAULT.timeout_ms.into(),
            debounce_ms: Config::DEFAULT.wires.debounce_ms,
            events: Vec::new(),
            request: None,
        }
    }

    fn receive(&mut self, now_ms: u32, frame: &ClassicFrame) {
        let Id::Standard(id) = frame.id() else { return };
        if frame.is_remote_frame() {
            return;
        }
        let operational = self.state == NmtState::Operational;
        match (id.as_raw(), frame.data()) {
            (NMT, &[command, whom]) if u16::from(whom) == NODE || whom == 0 => self.command(command),
            (RPDO, &[flags, user, w0, w1, s0, s1, f0, f1]) if operational && self.is_enabled => {
                if !self.has_heartbeat {
                    self.received_ms = Some(now_ms);
                }
                let image = OutputImage {
                    flags: CommandFlags::from_bits_retain(flags),
                    user,
                    width: i16::from_le_bytes([w0, w1]),
                    speed: u16::from_le_bytes([s0, s1]),
                    force_limit: i16::from_le_bytes([f0, f1]),
                };
                if self.transmission <= 240 && !image.flags.contains(CommandFlags::FASTSTOP) {
                    self.waiting = Some(image);
                } else {
                    self.waiting = None;
                    self.events.push(BusEvent::Image(image));
                }
            }
            (SYNC, &[] | &[_]) if operational => self.events.extend(self.waiting.take().map(BusEvent::Image)),
            (SDO_REQUEST, data) if operational || self.state == NmtState::PreOperational => {
                self.request = data.try_into().ok().or(self.request);
            }
            (id, _) if id == HEARTBEAT | self.master && !self.watches => {}
            // A boot-up message counts as a restart if the master was seen before.
            (id, &[0]) if id == HEARTBEAT | self.master && self.received_ms.is_some() => self.fall_back(),
            (id, &[0]) if id == HEARTBEAT | self.master => {}
            (id, &[_]) if id == HEARTBEAT | self.master => {
                (self.received_ms, self.has_heartbeat) = (Some(now_ms), true);
            }
            _ => {}
        }
    }

    fn command(&mut self, command: u8) {
        let state = match command {
            0x01 => NmtState::Operational,
            0x02 => NmtState::Stopped,
            0x80 => NmtState::PreOperational,
            0x81 | 0x82 => {
                self.enter(NmtState::Initialising);
                self.events.push(BusEvent::Reset { whole: command == 0x81 });
                return;
            }
            _ => return,
        };
        if self.state != NmtState::Initialising {
            self.enter(state);
        }
    }

    fn enter(&mut self, state: NmtState) {
        if self.state == NmtState::Operational && state != NmtState::Operational {
            self.events.push(BusEvent::Left);
            self.waiting = None;
        }
        self.state = state;
    }

    /// Ends control from the bus, whether or not the device is operational.
    fn fall_back(&mut self) {
        if self.state == NmtState::Operational {
            self.events.push(BusEvent::Left);
            self.end_operation();
        }
        self.forget_master();
    }

    fn end_operation(&mut self) {
        self.state = self.behaviour;
        self.waiting = None;
    }

    /// Processes the loss of the bus, which ends its control.
    fn lose_bus(&mut self) {
        self.fall_back();
        self.request = None;
    }

    /// Resets everything except state and settings.
    fn reset(&mut self) {
        let new = Self::new();
        (self.master, self.watches, self.request) = (new.master, new.watches, None);
        (self.is_enabled, self.transmission, self.behaviour) =
            (new.is_enabled, new.transmission, new.behaviour);
        self.forget_master();
    }

    fn forget_master(&mut self) {
        (self.received_ms, self.has_heartbeat) = (None, false);
    }

    /// Applies an SDO request according to the device's answer. Returns whether its effect is known.
    fn configure(&mut self, now_ms: u32, sent: &[ClassicFrame]) -> bool {
        let Some([specifier, low, high, sub, a, b, c, d]) = self.request.take() else { return true };
        let object = (u16::from_le_bytes([low, high]), sub);
        let is_followed = matches!(
            object,
            MASTER | COB_ID | TRANSMISSION | ERROR_BEHAVIOUR | (SETTINGS_INDEX, TIMEOUT_SUB | DEBOUNCE_SUB)
        );
        if specifier >> 5 != 1 || !is_followed {
            // Other settings are not tracked, although some affect the wires.
            return specifier >> 5 != 1 || object.0 != SETTINGS_INDEX;
        }
        let answer = sent.iter().rev().find(|frame| frame.id() == Id::Standard(standard(SDO_ANSWER)));
        match answer.map(|frame| frame.data()) {
            Some(&[0x60, x, y, z, ..]) if [x, y, z] == [low, high, sub] => {
                let value = u16::from_le_bytes([a, b]).into();
                match object {
                    (SETTINGS_INDEX, DEBOUNCE_SUB) => self.debounce_ms = value,
                    MASTER => {
                        self.watches = value != 0 && c != 0;
                        if self.watches {
                            self.timeout_ms = value;
                        }
                        if !self.watches || self.master == u16::from(c) {
                            self.received_ms = self.received_ms.map(|_| now_ms);
                            self.has_heartbeat &= self.watches;
                        } else {
                            self.master = c.into();
                            self.forget_master();
                        }
                    }
                    COB_ID => self.enable(d & 0x80 == 0),
                    TRANSMISSION if a == self.transmission => {}
                    TRANSMISSION => (self.transmission, self.waiting) = (a, None),
                    ERROR_BEHAVIOUR => {
                        self.behaviour = match a {
                            0 => NmtState::PreOperational,
                            1 => NmtState::Operational,
                            _ => NmtState::Stopped,
                        };
                    }
                    _ => self.timeout_ms = value,
                }
                true
            }
            Some(&[0x80, x, y, z, ..]) => [x, y, z] == [low, high, sub],
            _ => false,
        }
    }

    /// Enables or disables the RPDO; a disabled one has no control.
    fn enable(&mut self, is_enabled: bool) {
        if self.is_enabled && !is_enabled && self.state == NmtState::Operational {
            self.events.push(BusEvent::Left);
            self.received_ms = self.received_ms.filter(|_| self.has_heartbeat);
        }
        self.waiting = self.waiting.take().filter(|_| is_enabled == self.is_enabled);
        self.is_enabled = is_enabled;
    }
}

impl Model {
    fn new(is_on_rs_232: bool) -> Self {
        let double = CanDouble::default();
        Self {
            bridge: Bridge::new(Config::DEFAULT),
            bus: CanBus::new(double.clone(), BusOffPolicy::DEFAULT),
            double,
            link: Tap::new(GripperLink::new(Identifiers::DEFAULT), None),
            is_on_rs_232,
            node: Node::new(DEFAULT_NODE),
            queued: Vec::new(),
            left: Reassembler::new(standard(TO_GRIPPER), u32::MAX / 2),
            is_troubled: false,
            is_spoilt: false,
            withdrawn: None,
            takes_all_back: false,
            was_connected: false,
            overrun: false,
            delivered: Vec::new(),
            was_lost: false,
            device: Device::new(),
            ends: Ends::new(&Config::DEFAULT, None),
        }
    }

    fn put(&mut self, frame: Option<ClassicFrame>) {
        let Some(frame) = frame else { return };
        if self.delivered.len() >= BURST {
            self.pass(1);
        }
        if self.double.health().is_off {
            return;
        }
        self.double.deliver(frame);
        self.delivered.push(frame);
    }

    fn put_data(&mut self, id: u16, data: &[u8]) {
        self.put(ClassicFrame::new(standard(id), data));
    }

    fn put_rpdo(&mut self, image: &OutputImage) {
        let [flags, user, w1, w0, s1, s0, f1, f0] = image.to_bytes();
        self.put_data(RPDO, &[flags, user, w0, w1, s0, s1, f0, f1]);
    }

    /// Delivers a message from the gripper, `spoilt` in its frames or bytes.
    fn deliver_message(&mut self, message: &[u8], spoilt: Option<u8>) {
        let (fault, at) = spoilt.map_or((u8::MAX, 0), |how| (how % 8, usize::from(how >> 4)));
        if !self.is_on_rs_232 {
            for frame in frames_with(message, fault, at) {
                self.put_data(FROM_GRIPPER, &frame);
            }
            return;
        }
        let mut bytes = message.to_vec();
        let at = at % bytes.len();
        match fault {
            0 => drop(bytes.remove(at)),
            1 => bytes.insert(at, bytes[at]),
            2 => bytes.truncate(at),
            3 => bytes[at] ^= 0x10,
            _ => {}
        }
        self.ends.line.link.deliver(&bytes);
    }

    fn happen(&mut self, event: &CanEvent) {
        let now_ms = self.ends.now_ms;
        match *event {
            CanEvent::Data(id, _) | CanEvent::Extended(id, _) | CanEvent::Remote(id, _) => {
                if id % 0x800 == FROM_GRIPPER {
                    self.ends.gripper.forge(now_ms, &PREAMBLE);
                }
            }
            CanEvent::Message { ref bytes, .. } => self.ends.gripper.forge(now_ms, bytes),
            CanEvent::Heartbeat { .. } => {}
            _ => self.ends.gripper.fault(now_ms),
        }
        match *event {
            CanEvent::Data(id, ref data) => self.put_data(id, data),
            CanEvent::Extended(id, ref data) => self.put(ClassicFrame::new(extended(id), data)),
            CanEvent::Remote(id, count) => self.put(ClassicFrame::new_remote(standard(id), count)),
            CanEvent::Heartbeat { of_plc, state } => {
                let node = if of_plc { self.device.master } else { OTHER_NODE };
                self.put_data(HEARTBEAT | node, &[state]);
            }
            CanEvent::Message { ref bytes, spoilt } => self.deliver_message(bytes, Some(spoilt)),
            CanEvent::BusOff(turns) => self.double.go_off(turns),
            CanEvent::Overrun => {
                self.double.overrun();
                self.overrun = true;
            }
            CanEvent::Unacknowledged(is_unheard) => self.double.set_unheard(is_unheard),
            CanEvent::Rejects(rejects) => {
                self.double.refuse(rejects);
                self.is_troubled = true;
            }
            CanEvent::Passive(transmit_errors) => {
                let health = Health { is_passive: true, transmit_errors, ..self.double.health() };
                self.double.set_health(health);
            }
            CanEvent::Retry => self.bus.retry(Instant::from_millis(now_ms)),
            CanEvent::Recovers => {
                self.double.set_health(Health::default());
                self.double.set_unheard(false);
                self.double.refuse(false);
            }
        }
    }

    /// Runs the bridge's turn. Returns its outputs and the messages to a gripper on the bus.
    fn turn_bridge(&mut self, now: Instant) -> (Outputs, Vec<Message>) {
        let aborts = self.double.aborts();
        let Self { bus, link: Tap { link, .. }, bridge, node, is_on_rs_232, .. } = self;
        let mut counters = LinkCounters::default();
        bus.listen(now, &mut (!*is_on_rs_232).then_some(&mut *link), node);
        if !*is_on_rs_232 {
            let took_back = takes_back(link);
            link.expire(now);
            self.takes_all_back |= takes_back(link) && !took_back;
            bridge.set_link_lost(bus.is_lost());
            if let Some(id) = self.withdrawn.take() {
                bridge.withdrawn(id);
            }
            counters = link.counters();
        }
        let report = bus.report(counters);
        node.set_report(report);
        bridge.set_can_reports(report.registers());
        self.forget_if(aborts);

        let Self { link, bridge, node, ends: Ends { now_ms, wires, line, .. }, .. } = self;
        let outputs = match self.is_on_rs_232 {
            true => bridge.poll(*now_ms, *wires, line.turn(), node),
            false => bridge.poll(*now_ms, *wires, link.turn(), node),
        };
        let messages = link.take_messages();
        self.queued.extend(messages.iter().cloned().map(|message| (message, *now_ms)));

        let (aborts, connected) = (self.double.aborts(), self.bridge.is_connected());
        let Self { bus, link: Tap { link, .. }, bridge, node, is_on_rs_232, .. } = self;
        if !*is_on_rs_232 {
            link.set_connected(connected);
            self.takes_all_back |= std::mem::replace(&mut self.was_connected, connected) && !connected;
            if bridge.has_overtaken() {
                link.withdraw();
            }
        }
        let mut sent = vec![];
        let mut ear = Ear { node, sent: &mut sent };
        bus.talk(now, &mut (!*is_on_rs_232).then_some(&mut *link), &mut ear);
        self.withdrawn = link.take_withdrawn();
        let has_them_back = !takes_back(link);
        self.forget_if(aborts);
        if let Some(id) = self.withdrawn {
            let of_it = self.queued.iter().rposition(|(message, _)| message.id == id);
            self.queued.remove(of_it.expect("only queued messages are withdrawn"));
            self.is_spoilt = true;
        }
        if self.takes_all_back && has_them_back {
            self.forget();
        }
        self.follow(&sent);
        (outputs, messages)
    }

    /// Applies received frames and time to the reference model.
    fn follow(&mut self, sent: &[ClassicFrame]) {
        let ends = &mut self.ends;
        let received = if self.is_on_rs_232 { ends.line.take_received() } else { self.link.take_received() };
        ends.begin_turn(&received);
        let commands = self.bridge.control_source() == ControlSource::Bus;
        let Ends { now_ms, promises: Promises { requests, .. }, is_over, .. } = ends;
        let (now_ms, device) = (*now_ms, &mut self.device);
        let was_lost = std::mem::replace(&mut self.was_lost, self.bus.is_lost());
        if self.was_lost && !was_lost {
            device.lose_bus();
        }
        let mut reset = false;
        for event in std::mem::take(&mut device.events) {
            match event {
                BusEvent::Image(image) => requests.take_image(image, None),
                BusEvent::Left => requests.lose_bus(commands),
                BusEvent::Reset { whole } => {
                    reset = true;
                    if whole {
                        let new = Device::new();
                        (device.timeout_ms, device.debounce_ms) = (new.timeout_ms, new.debounce_ms);
                    }
                }
            }
        }
        if reset {
            device.reset();
        }
        *is_over = !device.configure(now_ms, sent);
        if device.events.drain(..).any(|event| matches!(event, BusEvent::Left)) {
            requests.lose_bus(commands);
        }
        let is_silent = |received_ms| device.timeout_ms > 0 && now_ms - received_ms >= device.timeout_ms;
        if device.received_ms.is_some_and(is_silent) {
            device.forget_master();
            if device.state == NmtState::Operational {
                device.end_operation();
                requests.lose_bus(commands);
            }
        }
        if device.state == NmtState::Initialising && self.node.state() == NmtState::PreOperational {
            // The device has sent its boot-up message.
            device.state = NmtState::PreOperational;
        }
        if !*is_over {
            assert_eq!(self.node.state(), device.state);
        }
        requests.debounce_ms = device.debounce_ms;
    }

    /// Discards the queue if the controller was requested to abort.
    fn forget_if(&mut self, aborts_before: u32) {
        if self.double.aborts() != aborts_before {
            self.forget();
        }
    }

    fn forget(&mut self) {
        self.queued.clear();
        self.left.reset();
        self.is_troubled = true;
        self.takes_all_back = false;
    }

    /// Sends one millisecond's frames; the gripper receives complete messages.
    fn leave(&mut self) {
        let mut left = vec![];
        for _ in 0..FRAMES_PER_MS {
            let Some(frame) = self.double.take_winner() else { break };
            let (is_troubled, is_spoilt) = (self.is_troubled, &mut self.is_spoilt);
            self.left.receive(Instant::from_millis(self.ends.now_ms), &frame, |event| match event {
                Event::Frame(message) => left.push(Message::from(message)),
                broken => {
                    let is_spoilt = std::mem::take(is_spoilt);
                    assert!(is_troubled || is_spoilt, "a broken message was sent: {broken:?}");
                }
            });
        }
        for message in left {
            let place = self.queued.iter().position(|(queued, _)| *queued == message);
            let place = place.expect("a message is sent once and only while valid");
            assert!(place == 0 || self.is_troubled, "messages are sent in order");
            let is_stopped =
                self.queued.iter().skip(place + 1).any(|(later, _)| later.id.kind() == Kind::Stop);
            let is_overtaken = is_stopped && matches!(message.id.kind(), Kind::Motion | Kind::Acknowledge);
            assert!(!is_overtaken, "{} was sent after a later stop was queued", message.id);
            let (_, reported_ms) = self.queued.drain(..=place).next_back().unwrap_or((message.clone(), 0));
            let late = message.id.kind() == Kind::Motion && self.ends.now_ms - reported_ms > LATE_MS;
            assert!(
                !late,
                "{} was sent {} ms after it was queued",
                message.id,
                self.ends.now_ms - reported_ms
            );
            self.ends.gripper.receive(self.ends.now_ms, &message);
        }
    }
}

impl WholeBridge for Model {
    const NAME: &'static str = "bridge_can";
    const CONNECTS_MS: u32 = 30;

    fn start(choice: u8) -> Self {
        Self::new(choice & 2 != 0)
    }

    fn ends(&mut self) -> &mut Ends {
        &mut self.ends
    }

    fn write_zeros(&mut self) {
        self.put_data(NMT, &[0x01, NODE as u8]);
        self.pass(8);
        self.put_rpdo(&image(CommandFlags::empty(), PARAMETERS[0]));
    }

    fn deliver(&mut self, bytes: &[u8]) {
        self.deliver_message(bytes, None);
    }

    /// Frames transmitted in this turn are processed after it.
    fn turn(&mut self) {
        self.ends.now_ms += 1;
        let now_ms = self.ends.now_ms;
        let lost = usize::from(self.overrun && !self.delivered.is_empty());
        self.overrun &= self.delivered.is_empty();
        for frame in self.delivered.drain(..).skip(lost) {
            self.device.receive(now_ms, &frame);
        }
        let (outputs, messages) = self.turn_bridge(Instant::from_millis(now_ms));
        assert!(self.bridge.may_feed_watchdog(now_ms));
        if self.ends.is_over {
            return;
        }
        if self.is_on_rs_232 {
            self.ends.end_turn(&self.bridge, outputs, Some(1));
            // The device's frames are transmitted as well.
            return self.leave();
        }
        let cut_off = self.double.is_blocked() || self.bus.is_lost();
        let max_delay_ms = if cut_off { None } else { Some(FAST_STOP_MS) };
        if cut_off {
            self.ends.gripper.fault(now_ms);
        }
        self.ends.promises.end_inputs(max_delay_ms);
        for message in messages {
            self.ends.send(message.id, Some(&message));
        }
        self.ends.judge(&self.bridge, outputs);
        self.leave();
        for answer in self.ends.gripper.transmit(now_ms) {
            self.deliver_message(&answer, None);
        }
    }

    fn decode(op: u8, input: &mut Input<'_>, script: &mut Vec<Operation>) {
        let event = match op % 16 {
            3 => {
                let (kind, any) = (input.byte(), u16::from_le_bytes(input.array()));
                let id = if kind & 0x80 == 0 { input.pick(&IDS) } else { any };
                let count = usize::from(kind % 9);
                match kind >> 4 & 3 {
                    0 => CanEvent::Remote(id, count),
                    1 => CanEvent::Extended(id, input.bytes(count).to_vec()),
                    _ => CanEvent::Data(id, input.bytes(count).to_vec()),
                }
            }
            4 => return script.push(Operation::Write(pick_image(input))),
            5 => return script.extend(pick_edge(input).map(Operation::Write)),
            8 => CanEvent::Data(NMT, vec![input.pick(&NMT_COMMANDS), input.pick(&[NODE as u8, 0, 5])]),
            9 => {
                let of_plc = input.pick(&[true, false]);
                CanEvent::Heartbeat { of_plc, state: input.pick(&[5, 0, 127]) }
            }
            10 => CanEvent::Data(SDO_REQUEST, pick_sdo(input)),
            11 => return script.push(pick_answer(input)),
            12 => {
                let (id, count, spoilt) = (input.byte(), usize::from(input.byte() % 24), input.byte());
                let bytes = FrameEncoder::new(id, input.bytes(count)).collect();
                CanEvent::Message { bytes, spoilt }
            }
            13 => match input.byte() % 8 {
                0 => CanEvent::BusOff(u32::from(input.byte() % 3)),
                1 => CanEvent::Overrun,
                2 | 3 => CanEvent::Unacknowledged(input.byte() & 1 != 0),
                4 => CanEvent::Rejects(input.byte() & 1 != 0),
                5 => CanEvent::Passive(input.byte()),
                6 => CanEvent::Retry,
                _ => CanEvent::Recovers,
            },
            _ => {
                let flags = input.pick(&FLAGS).bits();
                let count = usize::from(input.byte() % 9);
                CanEvent::Data(RPDO, [flags, 0, 0xD0, 0x07, 0x88, 0x13, 0xA0, 0x0F][..count].to_vec())
            }
        };
        script.push(Operation::Can(event));
    }

    fn execute(&mut self, operation: &Operation) {
        match operation {
            Operation::Write(image) => self.put_rpdo(image),
            Operation::Can(event) => self.happen(event),
            other => whole::cannot(other),
        }
    }
}

/// Returns an SDO request.
fn pick_sdo(input: &mut Input<'_>) -> Vec<u8> {
    let (index, sub) = input.pick(&OBJECTS);
    let ([low, high], value) = (index.to_le_bytes(), input.byte());
    let specifier = input.pick(&[0x2B, 0x22, 0x23, 0x40, 0x2F, 0x80, 0x00]);
    let [a, b, c, d] = match (index, sub) {
        MASTER => [value, 0, input.pick(&[0x7F, 5, 0]), 0],
        COB_ID => [NODE as u8, 0x02, 0, input.pick(&[0x80, 0x00, 0xC0, 0x20])],
        TRANSMISSION => [input.pick(&[1, 255, 0, 254, 252]), 0, 0, 0],
        ERROR_BEHAVIOUR => [value % 4, 0, 0, 0],
        (0x1600, 0) => [input.pick(&[0, 5, 4]), 0, 0, 0],
        _ => [value, 0, 0, 0],
    };
    vec![specifier, low, high, sub, a, b, c, d]
}

fn takes_back(link: &GripperLink) -> bool {
    CanNode::<ClassicFrame>::takes_back(link).is_some()
}

/// Maximum wait of a FAST STOP for the previous message, in milliseconds.
const FAST_STOP_MS: u32 = 5;

/// Maximum wait of a message for the bus, in milliseconds.
const LATE_MS: u32 = 1_000;

/// Records the frames of the device.
struct Ear<'a> {
    node: &'a mut Node,
    sent: &'a mut Vec<ClassicFrame>,
}

impl CanNode<ClassicFrame> for Ear<'_> {
    fn on_frame(&mut self, now: Instant, frame: &ClassicFrame) {
        self.node.on_frame(now, frame);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<ClassicFrame> {
        let frame = self.node.poll_transmit(now);
        self.sent.extend(frame);
        frame
    }

    fn sends(&self, id: Id) -> bool {
        CanNode::<ClassicFrame>::sends(self.node, id)
    }

    fn lost(&mut self) {
        CanNode::<ClassicFrame>::lost(self.node);
    }

    fn bus_changed(&mut self, is_on: bool) {
        CanNode::<ClassicFrame>::bus_changed(self.node, is_on);
    }
}
