//! The bridge as a CANopen device: a PLC side over the predefined connection set (CiA 301, 7.3.5).
//!
//! | what | identifier | bytes |
//! |---|---|---|
//! | output image | RPDO1, 200h + node | CMDFLAGS, IF, WIDTH, SPEED, FORCELIMIT |
//! | input image | TPDO1, 180h + node | GSTATE, OF, SYSSTATE, Status Code |
//! | | TPDO2, 280h + node | WIDTH, Gripping Force |
//!
//! Numbers stand low byte first, as CANopen has them. State, flags and status are in one frame: a PLC sees the end of a
//! motion, its result and the flags that belong to it together.
//!
//! What a master can read and write by SDO is in [`OBJECTS`], and in the tables of the settings and reports of `registers`.
//! Only expedited transfer is served: no object has more than four bytes.
//!
//! A master is watched. Once its heartbeat was heard, the heartbeat has to go on; before that, its RPDO1. When neither
//! comes for BUS_TIMEOUT, the bridge reacts as BUS_REACTION says and becomes pre-operational. The same when the master
//! takes it out of operation, or restarts.

mod config;
mod eds;
mod emergency;
mod objects;
mod sdo;
mod server;

pub use config::NodeConfig;
pub use eds::write_eds;
pub use emergency::{FAULTS, Fault};
pub use objects::{
    BusReport, DataType, INPUT_INDEX, OBJECTS, OUTPUT_INDEX, Object, REPORTS_INDEX, SETTINGS_INDEX,
};

use embedded_can::{Frame, Id, StandardId};
use heapless::Deque;
use wsg_protocol::fieldbus::{CommandFlags, GripperFlags, InputImage, OutputImage};
use wsg_protocol::{Instant, Status, SystemFlags};

use self::emergency::{Cause, Causes, Emergency};
use super::Participant;
use super::bus::MAX_RECEIVED_PER_POLL;
use crate::plc::{PlcEvent, PlcSide, Shown, View};
use crate::registers::{Link, Settings};

/// The state of the device (CiA 301, 7.3.2), by its code in the heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtState {
    /// It has not announced itself yet.
    Initialising = 0,
    /// No PDOs, no SDO.
    Stopped = 4,
    /// All of it.
    Operational = 5,
    /// No PDOs.
    PreOperational = 127,
}

/// What came for the bridge, in order.
#[derive(Clone, Copy, Debug)]
enum Event {
    Image(OutputImage),
    /// The master took the bridge out of operation, or restarted; or the bus is gone.
    Left,
    /// Reset communication, or the node as a whole.
    Reset {
        whole: bool,
    },
}

/// One TPDO.
#[derive(Clone, Copy, Debug)]
struct Tpdo {
    sent: [u8; 8],
    /// None: it is due.
    sent_at: Option<Instant>,
}

impl Tpdo {
    const DUE: Self = Self { sent: [0; 8], sent_at: None };
}

/// What can happen in one turn: each frame is one thing at the most, and then the bus may go.
const EVENTS_MAX: usize = MAX_RECEIVED_PER_POLL + 1;

/// The bridge on a CANopen bus.
#[derive(Debug)]
pub struct Node {
    config: NodeConfig,
    initial: (NodeConfig, Option<Settings>),
    state: NmtState,
    events: Deque<Event, EVENTS_MAX>,
    output: OutputImage,
    shown: InputImage,
    request: Option<[u8; 8]>,
    response: Option<[u8; 8]>,
    /// When the master was heard last; none when it was not, or too long ago.
    heard_at: Option<Instant>,
    /// By its heartbeat, which from then on counts alone.
    has_heartbeat: bool,
    master_silent: bool,
    /// When the own heartbeat was sent.
    beat_at: Option<Instant>,
    tpdos: [Tpdo; 2],
    emergency: Emergency,
    report: BusReport,
}

impl Node {
    /// A device that has not announced itself.
    #[must_use]
    pub const fn new(config: NodeConfig) -> Self {
        Self {
            config,
            initial: (config, None),
            state: NmtState::Initialising,
            events: Deque::new(),
            output: OutputImage::ZERO,
            shown: NOTHING_KNOWN,
            request: None,
            response: None,
            heard_at: None,
            has_heartbeat: false,
            master_silent: false,
            beat_at: None,
            tpdos: [Tpdo::DUE; 2],
            emergency: Emergency::new(),
            report: BusReport::NOTHING,
        }
    }

    /// Its state.
    #[must_use]
    pub const fn state(&self) -> NmtState {
        self.state
    }

    /// Takes what is known of the bus, for the counters that a master reads.
    pub const fn set_report(&mut self, report: BusReport) {
        self.report = report;
    }

    fn forget_master(&mut self) {
        (self.heard_at, self.has_heartbeat) = (None, false);
    }

    /// NMT: what the master does with the device.
    fn command(&mut self, specifier: u8) {
        let state = match specifier {
            0x01 => NmtState::Operational,
            0x02 => NmtState::Stopped,
            0x80 => NmtState::PreOperational,
            0x81 | 0x82 => {
                self.leave();
                self.state = NmtState::Initialising;
                self.push(Event::Reset { whole: specifier == 0x81 });
                return;
            }
            _ => return,
        };
        if self.state == NmtState::Initialising {
            // It has not announced itself again yet.
            return;
        }
        if state == NmtState::Operational {
            self.master_silent = false;
            if self.state != state {
                self.tpdos = [Tpdo::DUE; 2];
            }
        } else {
            self.leave();
        }
        self.state = state;
    }

    /// Nobody commands over the bus any more.
    fn leave(&mut self) {
        if self.state == NmtState::Operational {
            self.push(Event::Left);
        }
    }

    /// Leaves operation by itself, and waits for a master that starts it again.
    fn fall_back(&mut self) {
        self.leave();
        if self.state == NmtState::Operational {
            self.state = NmtState::PreOperational;
        }
        self.forget_master();
    }

    fn push(&mut self, event: Event) {
        if self.events.push_back(event).is_ok() {
            return;
        }
        // The bridge takes what comes in one turn, so this does not happen. If it did, no FAST STOP would be lost.
        let (Some(Event::Image(last)), Event::Image(image)) = (self.events.back_mut(), event) else { return };
        let fast_stop = last.flags & CommandFlags::FASTSTOP;
        *last = OutputImage { flags: image.flags | fast_stop, ..image };
    }

    fn take_rpdo(&mut self, now: Instant, data: &[u8]) {
        if self.state != NmtState::Operational {
            return;
        }
        let &[flags, user, w0, w1, s0, s1, f0, f1] = data else {
            self.emergency.happened(Cause::PdoLength);
            return;
        };
        let image = OutputImage {
            flags: CommandFlags::from_bits_retain(flags),
            user,
            width: i16::from_le_bytes([w0, w1]),
            speed: u16::from_le_bytes([s0, s1]),
            force_limit: i16::from_le_bytes([f0, f1]),
        };
        self.output = image;
        if !self.has_heartbeat {
            self.heard_at = Some(now);
        }
        self.push(Event::Image(image));
    }

    fn take_heartbeat(&mut self, now: Instant, data: &[u8]) {
        match data {
            // A boot-up: a master that restarts does not know what it has commanded.
            [0] if self.heard_at.is_some() => self.fall_back(),
            [0] => {}
            [_] => (self.heard_at, self.has_heartbeat) = (Some(now), true),
            _ => {}
        }
    }

    /// The next frame that is due: its identifier without the node-ID, and its data.
    fn due(&mut self, now: Instant) -> Option<(u16, [u8; 8], usize)> {
        if self.state == NmtState::Initialising {
            self.state = NmtState::PreOperational;
            self.beat_at = Some(now);
            return Some((0x700, [0; 8], 1));
        }
        if self.state != NmtState::Stopped {
            if let Some(code) = self.emergency.next() {
                let [low, high] = code.to_le_bytes();
                let [a, b, c, d] = self.shown.system.bits().to_le_bytes();
                let [status, _] = self.shown.status.code().to_le_bytes();
                return Some((0x080, [low, high, self.emergency.register(), a, b, c, d, status], 8));
            }
            if let Some(response) = self.response.take() {
                return Some((0x580, response, 8));
            }
        }
        if self.state == NmtState::Operational {
            for number in [0, 1] {
                if let Some(data) = self.due_tpdo(now, number) {
                    return Some(data);
                }
            }
        }
        let period = u32::from(self.config.heartbeat_ms);
        if period > 0 && self.beat_at.is_none_or(|at| now.since(at) >= period) {
            self.beat_at = Some(now);
            return Some((0x700, [self.state as u8, 0, 0, 0, 0, 0, 0, 0], 1));
        }
        None
    }

    fn due_tpdo(&mut self, now: Instant, number: usize) -> Option<(u16, [u8; 8], usize)> {
        let (base, data, len) = match number {
            0 => (0x180, state_bytes(&self.shown), 8),
            _ => (0x280, measured_bytes(&self.shown), 4),
        };
        let inhibit_ms = u32::from(self.config.inhibit.get(number)?.div_ceil(10));
        let event_ms = u32::from(*self.config.event_ms.get(number)?);
        let tpdo = self.tpdos.get_mut(number)?;
        let is_due = tpdo.sent_at.is_none_or(|at| {
            let passed = now.since(at);
            (tpdo.sent != data && passed >= inhibit_ms) || (event_ms > 0 && passed >= event_ms)
        });
        if !is_due {
            return None;
        }
        *tpdo = Tpdo { sent: data, sent_at: Some(now) };
        Some((base, data, len))
    }
}

impl PlcSide for Node {
    /// What can come in one turn, and an SDO request and a time-out.
    const MAX_EVENTS_PER_TURN: usize = EVENTS_MAX + 2;

    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        let initial = self.initial.1.get_or_insert_with(|| view.settings.clone());
        match self.events.pop_front() {
            Some(Event::Image(image)) => return Some(PlcEvent::Output(image)),
            Some(Event::Left) => return Some(PlcEvent::Left { silent: false }),
            Some(Event::Reset { whole }) => {
                if whole {
                    *view.settings = initial.clone();
                }
                // Behind a reset nothing but another counts before the device has announced itself: that stays.
                *self = Self {
                    initial: self.initial.clone(),
                    events: core::mem::take(&mut self.events),
                    report: self.report,
                    ..Self::new(self.initial.0)
                };
                return Some(PlcEvent::Configured);
            }
            None => {}
        }
        if let Some(request) = self.request.take() {
            let is_configured = self.answer(&request, view);
            return Some(if is_configured { PlcEvent::Configured } else { PlcEvent::Served });
        }
        let timeout_ms = view.settings.timeout_ms();
        let is_silent = timeout_ms > 0 && self.heard_at.is_some_and(|at| now.since(at) >= timeout_ms);
        if !is_silent {
            return None;
        }
        self.master_silent = true;
        self.forget_master();
        if self.state == NmtState::Operational {
            self.state = NmtState::PreOperational;
        }
        Some(PlcEvent::Left { silent: true })
    }

    fn show(&mut self, _: Instant, shown: &Shown) {
        self.shown = shown.image;
        let gripper_silent = shown.link == Link::Silent;
        let master_silent = self.master_silent;
        self.emergency.see(&Causes { system: shown.image.system, gripper_silent, master_silent });
    }
}

/// What is shown before the bridge has shown anything.
const NOTHING_KNOWN: InputImage = InputImage {
    state: GripperFlags::empty(),
    user: 0,
    system: SystemFlags::empty(),
    width: 0,
    force: 0,
    status: Status::Success,
};

/// TPDO1.
fn state_bytes(image: &InputImage) -> [u8; 8] {
    let [a, b, c, d] = image.system.bits().to_le_bytes();
    let [low, high] = image.status.code().to_le_bytes();
    [image.state.bits(), image.user, a, b, c, d, low, high]
}

/// TPDO2.
fn measured_bytes(image: &InputImage) -> [u8; 8] {
    let [w0, w1] = image.width.to_le_bytes();
    let [f0, f1] = image.force.to_le_bytes();
    [w0, w1, f0, f1, 0, 0, 0, 0]
}

impl<F: Frame> Participant<F> for Node {
    fn hear(&mut self, now: Instant, frame: &F) {
        let Id::Standard(id) = frame.id() else { return };
        if frame.is_remote_frame() {
            return;
        }
        let (id, data) = (id.as_raw(), frame.data());
        let node = u16::from(self.config.node);
        if id == 0 {
            if let &[specifier, whom] = data
                && (whom == 0 || whom == self.config.node)
            {
                self.command(specifier);
            }
        } else if id == 0x200 | node {
            self.take_rpdo(now, data);
        } else if id == 0x600 | node {
            if matches!(self.state, NmtState::PreOperational | NmtState::Operational) {
                self.request = <[u8; 8]>::try_from(data).ok().or(self.request);
            }
        } else if id == 0x700 | u16::from(self.config.master) {
            self.take_heartbeat(now, data);
        }
    }

    fn say(&mut self, now: Instant) -> Option<F> {
        let (base, data, len) = self.due(now)?;
        let id = StandardId::new(base | u16::from(self.config.node))?;
        F::new(id, data.get(..len)?)
    }

    fn sends(&self, id: Id) -> bool {
        matches!(id, Id::Standard(id) if id.as_raw() & 0x7F == u16::from(self.config.node))
    }

    fn lost(&mut self) {
        // What is cyclic comes again at once. A client of SDO asks again by itself.
        self.tpdos = [Tpdo::DUE; 2];
        self.beat_at = None;
    }

    fn bus_changed(&mut self, is_on: bool) {
        self.response = None;
        self.request = None;
        if is_on {
            self.emergency.happened(Cause::BusOff);
            self.tpdos = [Tpdo::DUE; 2];
            self.beat_at = None;
        } else {
            // What CiA 301 has a device do unless its master asks for something else (1029h). Nobody could stop it any more.
            self.fall_back();
        }
    }
}
