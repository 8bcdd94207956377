//! A bridge with all connections of a board. The configuration selects the used ones.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_protocol::Instant;

use crate::bridge::Bridge;
use crate::can::{CanBus, CanController, LinkCounters};
use crate::gripper::{GripperLine, GripperLink};
use crate::io::{Inputs, Outputs};
use crate::plc::canopen::Node;
use crate::plc::{BoardId, BusPort, Config, DpBuffers, Modbus, PlcSide, Record, Sides, WrongSetting};
use crate::register::ResetCause;
use crate::storage::NorFlash;
use crate::stored_settings::StoredSettings;

/// The application of a board: the bridge and the devices on its lines.
///
/// The gripper is on RS-232 or on CAN. The PLC is always on the wires, and optionally on Modbus RTU, PROFIBUS or CAN
/// (CANopen). The service port is always active. [`run`](crate::run::run) calls [`turn`](Self::turn) at least once a
/// millisecond.
#[derive(Clone)]
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
    /// Creates a station with [`Config::DEFAULT`]. It uses `can` only if gripper or PLC are on CAN, and `profibus` only if
    /// the PLC is on PROFIBUS.
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

    /// Creates a station like [`new`](Self::new), for a board without PROFIBUS.
    // loom's cells are not `Sync`, so a static cannot hold them.
    #[cfg(not(all(loom, test)))]
    pub const fn without_profibus(can: CanBus<C>) -> Self {
        static NO_PROFIBUS: DpBuffers = DpBuffers::new();
        Self::new(can, &NO_PROFIBUS)
    }

    /// Returns the configuration for the start: the one stored in flash, or the `delivered` one if there is no usable one.
    ///
    /// # Errors
    /// [`WrongSetting`] if the delivered settings are invalid. Then no motion is allowed, because the intended recipes are
    /// unknown.
    #[inline(never)]
    pub fn load(&mut self, delivered: &Record, flash: &impl NorFlash) -> Result<Config, WrongSetting> {
        self.settings.set_delivered(|| *delivered);
        self.settings.load(flash)
    }

    /// Applies the configuration, the board's identity and the reset cause. Called only before the first turn.
    // Not inlined: its temporaries would stay on the stack during every turn of the main loop.
    #[inline(never)]
    pub fn start(&mut self, config: &Config, board: BoardId, reset_cause: ResetCause) {
        self.gripper_line = config.gripper_line;
        self.bridge.set_reset_cause(reset_cause);
        self.bridge.configure(config, self.settings.from());
        self.sides.start(config, board);
        self.start_link(config);
    }

    // Not inlined, so that its frame adds no stack to the frames of the sides.
    #[inline(never)]
    fn start_link(&mut self, config: &Config) {
        self.link = GripperLink::new(config.can.gripper);
    }

    /// Same as [`load`](Self::load), without the delivered settings on the stack.
    #[inline(never)]
    pub(crate) fn load_delivered(
        &mut self,
        delivered: fn() -> Record,
        flash: &impl NorFlash,
    ) -> Result<Config, WrongSetting> {
        self.settings.set_delivered(delivered);
        self.settings.load(flash)
    }

    /// Runs one turn of the main loop: handles the input of lines and wires, sends due data, and returns the output levels
    /// for the PLC. Never waits. `service` is a separate line for Modbus RTU with [`BusConfig::SERVICE`].
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
        // After transmitting: the wires do not wait for it, and the PLC's bus reads the changes in the next turn.
        self.bridge.serve(now_ms, &mut self.service.over(service));
        let now = Instant::from_millis(now_ms);
        self.settings.turn(now, &mut self.bridge, flash);
        if let Some(slot) = flash.slot() {
            self.bridge.update(now, slot);
        }
        outputs
    }

    /// Runs one turn like [`turn`](Self::turn) for a gateway, which has no wires, no service port and no CAN: the PLC is on
    /// `side`, and the gripper on `line`, regardless of PLC_BUS and GRIPPER_LINE. The outputs are for inspection.
    pub fn turn_of_gateway<L: Read + ReadReady + Write + WriteReady, P: PlcSide>(
        &mut self,
        now_ms: u32,
        line: &mut L,
        side: &mut P,
        flash: &mut impl NorFlash,
    ) -> Outputs {
        let outputs = self.bridge.poll(now_ms, Inputs::FAST_STOP_OK, line, side);
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

    /// Receives from CAN before the bridge's turn, if CAN is used.
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
            // Before the bridge's turn, so that it does not continue with data from a lost bus.
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

    /// Transmits on CAN after the bridge's turn, if CAN is used.
    fn talk(&mut self, now: Instant) {
        if !self.uses_can() {
            return;
        }
        let Self { bridge, can, link, sides, gripper_line, .. } = self;
        let mut link = matches!(gripper_line, GripperLine::Can).then_some(link);
        if let Some(link) = &mut link {
            // Before sending: earlier frames must not reach a gripper after a lost connection or a later stop.
            link.set_connected(bridge.is_connected());
            if bridge.has_overtaken() {
                link.withdraw();
            }
        }
        can.talk(now, &mut link, &mut sides.on_can());
    }

    /// Returns whether the gripper or the PLC is on CAN.
    pub const fn uses_can(&self) -> bool {
        matches!(self.gripper_line, GripperLine::Can) || self.sides.bus().is_on_can()
    }

    /// Returns the bridge.
    pub const fn bridge(&mut self) -> &mut Bridge {
        &mut self.bridge
    }

    /// Returns the CAN bus.
    pub const fn can(&mut self) -> &mut CanBus<C> {
        &mut self.can
    }

    /// Returns the gripper's link on the CAN bus.
    pub const fn link(&self) -> &GripperLink {
        &self.link
    }

    /// Returns the bridge's CANopen node.
    pub const fn node(&self) -> &Node {
        self.sides.node()
    }
}
