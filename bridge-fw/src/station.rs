//! A bridge with everything that a board can connect it to, of which its configuration chooses.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_protocol::Instant;

use crate::bridge::Bridge;
use crate::can::{CanBus, CanController, LinkCounters};
use crate::gripper::{GripperLine, GripperLink};
use crate::io::{Inputs, Outputs};
use crate::plc::canopen::Node;
use crate::plc::{BoardId, BusPort, Config, DpBuffers, Modbus, PlcBus, Record, Sides, WrongSetting};
use crate::register::ResetCause;
use crate::storage::NorFlash;
use crate::stored_settings::StoredSettings;

/// What runs on a board: the bridge, and whoever is on its lines.
///
/// The gripper is on RS-232 or on CAN. The PLC is on the wires in any case, and on Modbus RTU, on PROFIBUS or on CAN (CANopen)
/// beside them. The service port is there whatever the configuration says. [`run`](crate::run::run) calls [`turn`](Self::turn) at least
/// once a millisecond.
pub struct Station<C: CanController> {
    gripper_line: GripperLine,
    bridge: Bridge,
    sides: Sides,
    service: Modbus,
    settings: StoredSettings,
    can: CanBus<C>,
    link: GripperLink,
}

impl<C: CanController> Station<C> {
    /// A station as [`Config::DEFAULT`] says. `can` is used only where somebody is on CAN, and `profibus` where the PLC is on
    /// PROFIBUS.
    pub const fn new(can: CanBus<C>, profibus: &'static DpBuffers) -> Self {
        let config = Config::DEFAULT;
        Self {
            gripper_line: config.gripper_line,
            sides: Sides::new(&config, profibus),
            bridge: Bridge::new(config),
            service: Modbus::service(),
            settings: StoredSettings::new(),
            can,
            link: GripperLink::new(config.can.gripper),
        }
    }

    /// A station as [`new`](Self::new), for a board without PROFIBUS.
    pub const fn without_profibus(can: CanBus<C>) -> Self {
        static NO_PROFIBUS: DpBuffers = DpBuffers::new();
        Self::new(can, &NO_PROFIBUS)
    }

    /// Returns the configuration to start with: the one that is stored in flash, or where there is none, or none that can be used,
    /// the one that the image was `delivered` with.
    ///
    /// # Errors
    /// [`WrongSetting`] if the image was delivered with settings that no bridge can have. Nothing must be moved then: other
    /// recipes were asked for.
    #[inline(never)]
    pub fn load(&mut self, delivered: &Record, flash: &impl NorFlash) -> Result<Config, WrongSetting> {
        self.settings.set_delivered(|| *delivered);
        self.settings.load(flash)
    }

    /// Takes the configuration, what it runs on, and why the MCU was reset. Before the first turn alone.
    // Apart: what is built anew here would be on the stack through every turn of the main loop.
    #[inline(never)]
    pub fn start(&mut self, config: &Config, board: BoardId, reset_cause: ResetCause) {
        self.gripper_line = config.gripper_line;
        self.bridge.set_reset_cause(reset_cause);
        self.bridge.configure(config, self.settings.from());
        self.sides.start(config, board);
        self.start_link(config);
    }

    // Apart, as above: the frames of the sides would be on the stack beside it.
    #[inline(never)]
    fn start_link(&mut self, config: &Config) {
        self.link = GripperLink::new(config.can.gripper);
    }

    /// [`load`](Self::load), with the delivered settings not on the stack meanwhile.
    #[inline(never)]
    pub(crate) fn load_delivered(
        &mut self,
        delivered: fn() -> Record,
        flash: &impl NorFlash,
    ) -> Result<Config, WrongSetting> {
        self.settings.set_delivered(delivered);
        self.settings.load(flash)
    }

    /// One turn of the main loop: takes what the lines and wires brought, sends what is due, and returns the levels of the
    /// wires to the PLC. Never waits. `service` is a line of its own for Modbus RTU, by [`BusConfig::SERVICE`].
    ///
    /// [`BusConfig::SERVICE`]: crate::BusConfig::SERVICE
    pub fn turn<L: Read + ReadReady + Write + WriteReady>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        serial: &mut L,
        modbus: &mut dyn BusPort,
        service: &mut dyn BusPort,
        flash: &mut impl NorFlash,
    ) -> Outputs {
        let outputs = self.poll(now_ms, inputs, serial, modbus);
        // Behind what leaves: no wire waits for it, and the PLC's bus finds in the next turn what it changed.
        self.bridge.serve(now_ms, &mut self.service.over(service));
        self.settings.turn(Instant::from_millis(now_ms), &mut self.bridge, flash);
        outputs
    }

    fn poll<L: Read + ReadReady + Write + WriteReady>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        serial: &mut L,
        modbus: &mut dyn BusPort,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        self.listen(now);
        let Self { bridge, link, sides, .. } = self;
        let side = &mut sides.over(modbus);
        let outputs = match self.gripper_line {
            GripperLine::Serial => bridge.poll(now_ms, inputs, serial, side),
            GripperLine::Can => bridge.poll(now_ms, inputs, link, side),
        };
        self.talk(now);
        outputs
    }

    /// What comes before the bridge's turn where somebody is on CAN.
    fn listen(&mut self, now: Instant) {
        if !self.uses_can() {
            return;
        }
        let Self { bridge, can, link, sides, gripper_line, .. } = self;
        let mut node = sides.on_can();
        let mut link = matches!(gripper_line, GripperLine::Can).then_some(link);
        can.listen(now, &mut link, &mut node);
        let mut counters = LinkCounters::default();
        if let Some(link) = link {
            link.expire(now);
            // Before the bridge's turn: what a bus that is lost carried must not be gone on with.
            bridge.set_link_lost(can.is_lost());
            if let Some(id) = link.take_withdrawn() {
                bridge.withdrawn(id);
            }
            counters = link.counters();
        }
        let report = can.report(counters);
        bridge.set_can_reports(report.registers());
        if let Some(node) = node {
            node.set_report(report);
        }
    }

    /// What comes behind it.
    fn talk(&mut self, now: Instant) {
        if !self.uses_can() {
            return;
        }
        let Self { bridge, can, link, sides, gripper_line, .. } = self;
        let mut link = matches!(gripper_line, GripperLine::Can).then_some(link);
        if let Some(link) = &mut link {
            // Before anything is sent: no frame of before may reach a gripper that was lost, or was told to stop since.
            link.set_connected(bridge.is_connected());
            if bridge.has_overtaken() {
                link.withdraw();
            }
        }
        can.talk(now, &mut link, &mut sides.on_can());
    }

    /// Whether somebody is on CAN.
    pub const fn uses_can(&self) -> bool {
        matches!(self.gripper_line, GripperLine::Can) || self.sides.bus().is_on_can()
    }

    /// Whether the PLC is on PROFIBUS: then the handler of its line is to run after each turn.
    pub const fn uses_profibus(&self) -> bool {
        matches!(self.sides.bus(), PlcBus::Profibus)
    }

    /// The bridge.
    pub const fn bridge(&mut self) -> &mut Bridge {
        &mut self.bridge
    }

    /// The CAN bus.
    pub const fn can(&mut self) -> &mut CanBus<C> {
        &mut self.can
    }

    /// The gripper's link on it.
    pub const fn link(&self) -> &GripperLink {
        &self.link
    }

    /// The bridge as a device on it.
    pub const fn node(&self) -> &Node {
        self.sides.node()
    }
}
