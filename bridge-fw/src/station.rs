//! A bridge with everything that a board can connect it to, of which its configuration chooses.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_protocol::Instant;

use crate::bridge::Bridge;
use crate::can::{BusReport, CanBus, CanController, CanNode, LinkCounters, Node, NullNode};
use crate::config::{BoardId, Config, GripperLine, PlcBus};
use crate::gripper::GripperLink;
use crate::io::{Inputs, Outputs};
use crate::plc::{BusPort, DpBuffers, Modbus, ModbusLine, NoBus, PlcEvent, PlcSide, Profibus, Shown, View};
use crate::registers::{Record, ResetCause, WrongSetting};
use crate::storage::NorFlash;
use crate::stored_settings::StoredSettings;

/// What runs on a board: the bridge, and whoever is on its lines.
///
/// The gripper is on RS-232 or on CAN. The PLC is on the wires in any case, and on Modbus RTU, on PROFIBUS or on CAN (CANopen)
/// beside them. The service port is there whatever the configuration says. [`run`](crate::run::run) calls [`turn`](Self::turn) at least
/// once a millisecond.
pub struct Station<C: CanController> {
    gripper_line: GripperLine,
    plc_bus: PlcBus,
    bridge: Bridge,
    modbus: Modbus,
    profibus: Profibus,
    service: Modbus,
    settings: StoredSettings,
    can: CanBus<C>,
    link: GripperLink,
    node: Node,
}

impl<C: CanController> Station<C> {
    /// A station as [`Config::DEFAULT`] says. `can` is used only where somebody is on CAN, and `profibus` where the PLC is on
    /// PROFIBUS.
    pub const fn new(can: CanBus<C>, profibus: &'static DpBuffers) -> Self {
        let config = Config::DEFAULT;
        Self {
            gripper_line: config.gripper_line,
            plc_bus: config.plc_bus,
            bridge: Bridge::new(config),
            modbus: Modbus::new(&config),
            profibus: Profibus::new(profibus),
            service: Modbus::service(),
            settings: StoredSettings::new(),
            can,
            link: GripperLink::new(config.can.gripper),
            node: Node::new(config.can.node),
        }
    }

    /// Returns the configuration to start with: the one that is stored in flash, or where there is none, or none that can be used,
    /// the one that the image was `delivered` with.
    ///
    /// # Errors
    /// [`WrongSetting`] if the image was delivered with settings that no bridge can have. Nothing must be moved then: other
    /// recipes were asked for.
    #[inline(never)]
    pub fn load(&mut self, delivered: &Record, flash: &impl NorFlash) -> Result<Config, WrongSetting> {
        self.settings.load(delivered, flash)
    }

    /// Takes the configuration, what it runs on, and why the MCU was reset. Before the first turn alone.
    // Apart: what is built anew here would be on the stack through every turn of the main loop.
    #[inline(never)]
    pub fn start(&mut self, config: &Config, board: BoardId, reset_cause: ResetCause) {
        self.gripper_line = config.gripper_line;
        self.plc_bus = config.plc_bus;
        self.bridge.set_reset_cause(reset_cause);
        self.bridge.configure(config, self.settings.from());
        self.modbus = Modbus::new(config);
        self.profibus.start(config.profibus);
        self.link = GripperLink::new(config.can.gripper);
        self.node = Node::new(config.can.node);
        self.node.set_board(board);
    }

    /// [`load`](Self::load), with the delivered settings on the stack for its time alone.
    #[inline(never)]
    pub(crate) fn load_delivered(
        &mut self,
        delivered: fn() -> Record,
        flash: &impl NorFlash,
    ) -> Result<Config, WrongSetting> {
        self.load(&delivered(), flash)
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
        let Self { bridge, can, link, node, profibus, .. } = self;
        let mut on_port = match self.plc_bus {
            PlcBus::Modbus => OnPort::Modbus(self.modbus.over(modbus)),
            PlcBus::Profibus => {
                bridge.set_profibus_reports(profibus.reports());
                OnPort::Profibus(profibus)
            }
            PlcBus::Off | PlcBus::Canopen => OnPort::Nothing(NoBus),
        };
        match (self.gripper_line, self.plc_bus) {
            (GripperLine::Serial, PlcBus::Off | PlcBus::Modbus | PlcBus::Profibus) => {
                bridge.poll(now_ms, inputs, serial, &mut on_port)
            }
            (GripperLine::Serial, PlcBus::Canopen) => {
                can.listen(now, &mut NullNode, node);
                let report = can.report(LinkCounters::default());
                bridge.set_can_reports(report.registers());
                node.set_report(report);
                let outputs = bridge.poll(now_ms, inputs, serial, node);
                can.talk(now, &mut NullNode, node);
                outputs
            }
            (GripperLine::Can, PlcBus::Off | PlcBus::Modbus | PlcBus::Profibus) => {
                listen(now, bridge, can, link, &mut NullNode);
                let outputs = bridge.poll(now_ms, inputs, link, &mut on_port);
                talk(now, bridge, can, link, &mut NullNode);
                outputs
            }
            (GripperLine::Can, PlcBus::Canopen) => {
                let report = listen(now, bridge, can, link, node);
                node.set_report(report);
                let outputs = bridge.poll(now_ms, inputs, link, node);
                talk(now, bridge, can, link, node);
                outputs
            }
        }
    }

    /// Whether somebody is on CAN.
    pub const fn uses_can(&self) -> bool {
        matches!(self.gripper_line, GripperLine::Can) || matches!(self.plc_bus, PlcBus::Canopen)
    }

    /// Whether the PLC is on PROFIBUS: then the handler of its line is to run after each turn.
    pub const fn uses_profibus(&self) -> bool {
        matches!(self.plc_bus, PlcBus::Profibus)
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
        &self.node
    }
}

/// The bus on the serial port of the PLC. One type for both, so that the bridge's turn is not in the image for each.
enum OnPort<'a> {
    Nothing(NoBus),
    Modbus(ModbusLine<'a>),
    Profibus(&'a mut Profibus),
}

impl PlcSide for OnPort<'_> {
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        match self {
            Self::Nothing(side) => PlcSide::receive(side, now, view),
            Self::Modbus(side) => side.receive(now, view),
            Self::Profibus(side) => side.receive(now, view),
        }
    }

    fn show(&mut self, now: Instant, shown: &Shown) {
        match self {
            Self::Nothing(side) => side.show(now, shown),
            Self::Modbus(side) => side.show(now, shown),
            Self::Profibus(side) => side.show(now, shown),
        }
    }
}

/// What comes before the bridge's turn where the gripper is on the bus.
fn listen<C: CanController>(
    now: Instant,
    bridge: &mut Bridge,
    can: &mut CanBus<C>,
    link: &mut GripperLink,
    other: &mut impl CanNode<C::Frame>,
) -> BusReport {
    can.listen(now, link, other);
    link.expire(now);
    // Before the bridge's turn: what a bus that is lost carried must not be gone on with.
    bridge.set_link_lost(can.is_lost());
    if let Some(id) = link.take_withdrawn() {
        bridge.withdrawn(id);
    }
    let report = can.report(link.counters());
    bridge.set_can_reports(report.registers());
    report
}

/// What comes behind it.
fn talk<C: CanController>(
    now: Instant,
    bridge: &Bridge,
    can: &mut CanBus<C>,
    link: &mut GripperLink,
    other: &mut impl CanNode<C::Frame>,
) {
    // Before anything is sent: no frame of before may reach a gripper that was lost, or was told to stop since.
    link.set_connected(bridge.is_connected());
    if bridge.has_overtaken() {
        link.withdraw();
    }
    can.talk(now, link, other);
}
