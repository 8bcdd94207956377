//! What is on the CAN bus, by the features of the build: the gripper, the PLC, or both.

#[cfg(not(feature = "can-over-slcan"))]
use crate::can1 as controller;
#[cfg(feature = "can-over-slcan")]
use crate::slcan_uart as controller;

use wsg_bridge_fw::Bridge;
#[cfg(all(feature = "can-plc", not(feature = "can-gripper")))]
use wsg_bridge_fw::can::LinkCounters;
#[cfg(not(all(feature = "can-gripper", feature = "can-plc")))]
use wsg_bridge_fw::can::Nobody;
#[cfg(feature = "can-plc")]
use wsg_bridge_fw::can::Node;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, CanConfig};
#[cfg(feature = "can-gripper")]
use wsg_bridge_fw::can::{GripperLink, turn_with_gripper};
use wsg_bridge_fw::io::{Inputs, Outputs};
#[cfg(not(feature = "can-plc"))]
use wsg_bridge_fw::plc::PlcSide;
use wsg_protocol::Instant;

/// The bus and who is on it.
pub(crate) struct Can {
    bus: CanBus<controller::Controller>,
    #[cfg(feature = "can-gripper")]
    link: GripperLink,
    #[cfg(feature = "can-plc")]
    node: Node,
    #[cfg(not(all(feature = "can-gripper", feature = "can-plc")))]
    nobody: Nobody,
}

impl Can {
    pub(crate) const fn new() -> Self {
        Self {
            bus: CanBus::new(controller::new(), BusOffPolicy::DEFAULT),
            #[cfg(feature = "can-gripper")]
            link: GripperLink::new(CanConfig::BUILT.gripper),
            #[cfg(feature = "can-plc")]
            node: Node::new(CanConfig::BUILT.node),
            #[cfg(not(all(feature = "can-gripper", feature = "can-plc")))]
            nobody: Nobody,
        }
    }

    /// Starts the controller. The clock runs, the pins are set up.
    pub(crate) fn start(&mut self) {
        controller::start(self.bus.controller());
    }

    /// One turn of the main loop: the gripper on the bus, the PLC on Modbus.
    #[cfg(all(feature = "can-gripper", not(feature = "can-plc")))]
    pub(crate) fn turn(
        &mut self,
        bridge: &mut Bridge,
        now_ms: u32,
        inputs: Inputs,
        plc: &mut impl PlcSide,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        let Self { bus, link, nobody } = self;
        let outputs = turn_with_gripper(now, bridge, bus, link, nobody, |bridge, link, _, _| {
            bridge.poll(now_ms, inputs, link, plc)
        });
        controller::rearm(bus.controller());
        outputs
    }

    /// One turn of the main loop: the gripper on its serial line, the PLC on the bus.
    #[cfg(all(feature = "can-plc", not(feature = "can-gripper")))]
    pub(crate) fn turn(
        &mut self,
        bridge: &mut Bridge,
        now_ms: u32,
        inputs: Inputs,
        gripper_line: &mut crate::uart::GripperLine,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        let Self { bus, node, nobody } = self;
        bus.listen(now, nobody, node);
        let report = bus.report(LinkCounters::default());
        node.set_report(report);
        bridge.set_can_reports(report.registers());
        let outputs = bridge.poll(now_ms, inputs, gripper_line, node);
        bus.talk(now, nobody, node);
        controller::rearm(bus.controller());
        outputs
    }

    /// One turn of the main loop: both on the bus.
    #[cfg(all(feature = "can-gripper", feature = "can-plc"))]
    pub(crate) fn turn(&mut self, bridge: &mut Bridge, now_ms: u32, inputs: Inputs) -> Outputs {
        let now = Instant::from_millis(now_ms);
        let Self { bus, link, node } = self;
        let outputs = turn_with_gripper(now, bridge, bus, link, node, |bridge, link, node, report| {
            node.set_report(*report);
            bridge.poll(now_ms, inputs, link, node)
        });
        controller::rearm(bus.controller());
        outputs
    }
}

/// Whether a frame may wait to be heard.
pub(crate) fn has_received() -> bool {
    controller::has_received()
}
