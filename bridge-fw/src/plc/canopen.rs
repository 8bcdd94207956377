//! CANopen side: the contents of the PDOs, and the objects for SDO.
//!
//! | what | identifier | bytes |
//! |---|---|---|
//! | output image | RPDO1, 200h + node | CMDFLAGS, IF, WIDTH, SPEED, FORCELIMIT |
//! | input image | TPDO1, 180h + node | GSTATE, OF, SYSSTATE, Status Code |
//! | | TPDO2, 280h + node | WIDTH, Gripping Force |
//!
//! Values are little-endian, as in all of CANopen. State, flags and status share one frame, so a PLC receives the end of a
//! motion, its result and its flags together.
//!
//! [`OBJECTS`] and the tables of settings and reports list the objects for SDO. If the master is silent for BUS_TIMEOUT, the
//! bridge reacts according to BUS_REACTION.
//!
//! `bus_canopen` handles NMT, heartbeats, the SDO server, and the timing of PDOs and emergencies.

mod eds;
mod emergency;
mod objects;

pub use bus_canopen::{DataType, NmtState};
pub use eds::write_eds;
pub use emergency::{FAULTS, Fault};
pub use objects::{INPUT_INDEX, Key, OBJECTS, OUTPUT_INDEX, Object, REPORTS_INDEX, SETTINGS_INDEX};

use bus_canopen::{Device, Event, Profile, Rpdo};
use embedded_can::{Frame, Id};
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::Instant;

use self::objects::Objects;
use super::modbus::BusPort;
use super::side::{BoardId, PlcEvent, PlcSide, Shown};
use super::{Config, Listed, View};
use crate::can::{BusReport, CanNode, MAX_RECEIVED_PER_POLL, NodeConfig, TPDOS};
use crate::register::Link;

/// Maximum events per turn: one for each received frame, and one for the loss of the bus.
const EVENTS_MAX: usize = MAX_RECEIVED_PER_POLL + 1;

static PROFILE: Profile<1, TPDOS> = Profile {
    // The bridge handles all received frames in one turn, so there is always room. `keep` would preserve a FAST STOP
    // otherwise.
    rpdos: [Rpdo { len: 8, keep: [CommandFlags::FASTSTOP.bits(), 0, 0, 0, 0, 0, 0, 0] }],
    tpdos: [8, 4],
    faults: &emergency::CODES,
};

/// The bridge as a node on a CANopen bus.
#[derive(Clone, Debug)]
pub struct Node {
    device: Device<1, TPDOS, EVENTS_MAX>,
    report: BusReport,
    board: BoardId,
}

impl Node {
    /// Creates a device that has not sent its boot-up message.
    #[must_use]
    pub const fn new(config: NodeConfig) -> Self {
        Self { device: Device::new(&PROFILE, config), report: BusReport::NOTHING, board: BoardId::UNKNOWN }
    }

    /// Returns the NMT state.
    #[must_use]
    pub const fn state(&self) -> NmtState {
        self.device.state()
    }

    /// Sets the state of the bus, for the counters that a master reads.
    pub const fn set_report(&mut self, report: BusReport) {
        self.report = report;
    }
}

impl PlcSide for Node {
    /// Maximum events per turn, plus an SDO request, its effect, and a time-out.
    fn max_events_per_turn(&self) -> usize {
        EVENTS_MAX + 3
    }

    // Not inlined: its frame would be on the stack of the other sides, too.
    #[inline(never)]
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        let mut objects = Objects { view, report: &self.report, board: self.board };
        Some(match self.device.poll_event(now.as_millis(), &mut objects)? {
            Event::Rpdo { data, .. } => PlcEvent::Output(output_image(data)),
            Event::Sdo { written: true } => PlcEvent::Configured,
            Event::Sdo { written: false } => PlcEvent::Served,
            Event::Left { master_silent } => PlcEvent::Left { silent: master_silent },
            Event::Reset { application } => {
                if application {
                    view.reset_settings();
                }
                PlcEvent::Configured
            }
        })
    }

    fn show(&mut self, _: Instant, shown: &Shown) {
        let image = &shown.image;
        let [a, b, c, d] = image.system.bits().to_le_bytes();
        let [status, status_high] = image.status.code().to_le_bytes();
        let [w0, w1] = image.width.to_le_bytes();
        let [f0, f1] = image.force.to_le_bytes();
        self.device.show_tpdo(0, [image.state.bits(), image.user, a, b, c, d, status, status_high]);
        self.device.show_tpdo(1, [w0, w1, f0, f1, 0, 0, 0, 0]);
        let faults = emergency::present(image.system, shown.link == Link::Silent);
        self.device.show_faults(faults, [a, b, c, d, shown.error_cause]);
    }
}

impl Listed for Node {
    type Turn<'a> = &'a mut Self;

    // Not inlined: the new device would be on the stack together with the frames of the other sides.
    #[inline(never)]
    fn start(&mut self, config: &Config, board: BoardId) {
        *self = Self::new(config.can.node);
        self.board = board;
    }

    fn over<'a>(&'a mut self, _: &'a mut dyn BusPort) -> &'a mut Self {
        self
    }
}

/// Decodes RPDO1.
fn output_image([flags, user, w0, w1, s0, s1, f0, f1]: [u8; 8]) -> OutputImage {
    OutputImage {
        flags: CommandFlags::from_bits_retain(flags),
        user,
        width: i16::from_le_bytes([w0, w1]),
        speed: u16::from_le_bytes([s0, s1]),
        force_limit: i16::from_le_bytes([f0, f1]),
    }
}

impl<F: Frame> CanNode<F> for Node {
    fn on_frame(&mut self, now: Instant, frame: &F) {
        self.device.on_frame(now.as_millis(), frame);
    }

    fn poll_transmit(&mut self, now: Instant) -> Option<F> {
        self.device.poll_transmit(now.as_millis())
    }

    fn sends(&self, id: Id) -> bool {
        self.device.sends(id)
    }

    fn lost(&mut self) {
        self.device.frames_lost();
    }

    fn bus_changed(&mut self, is_on: bool) {
        if is_on {
            self.device.bus_joined();
        } else {
            self.device.bus_lost();
        }
    }
}
