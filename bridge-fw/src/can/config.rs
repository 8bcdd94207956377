//! CAN configuration that is fixed at the start: the rate of the bus, and the bridge's identity on it.

use wsg_protocol::can::Identifiers;

use crate::register::setting_rows;

/// Number of TPDOs of the bridge.
pub(crate) const TPDOS: usize = 2;

/// The bridge as a CANopen device at power-up. Values that a master can change have an object for SDO.
pub type NodeConfig = bus_canopen::Config<TPDOS>;

/// Node 10h, master 7Fh, two heartbeats per second, and at most ten emergencies per second. Without a change, both TPDOs are
/// sent every 100 ms. The inhibit time is 2 ms for state and status, and 20 ms for width and force, which change continuously
/// while the fingers move.
pub const DEFAULT_NODE: NodeConfig = NodeConfig {
    node: 0x10,
    master: 0x7F,
    heartbeat_ms: 500,
    emergency_inhibit: 1_000,
    inhibit: [20, 200],
    event_ms: [100, 100],
};

/// The CAN bus at power-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanConfig {
    /// Rate in kbit/s: 125, 250, 500 or 1000.
    pub kbit_rate: u16,
    /// Identifiers to and from the gripper.
    pub gripper: Identifiers,
    /// The bridge as a CANopen device.
    pub node: NodeConfig,
}

impl CanConfig {
    /// 500 kbit/s, the gripper on 120h and 121h, node 10h.
    pub const DEFAULT: Self = Self { kbit_rate: 500, gripper: Identifiers::DEFAULT, node: DEFAULT_NODE };
}

setting_rows! { CanConfig:
    178 "CAN_RATE" "kbit/s" (125, 1_000) "rate of CAN: 125, 250, 500 or 1000"
        kbit_rate: |it| it, |value| matches!(value, 125 | 250 | 500 | 1_000).then_some(value);
    179 "CAN_ID" "" (0, 0x7FE)
        "identifier to the gripper, which sends on the next one; neither may be a CANopen identifier"
        gripper: |it| it.base(), |value| Identifiers::from_base(value).filter(|it| !collides_with_canopen(*it));
    180 "CAN_NODE" "" (1, 127) "CANopen node-ID of the bridge; must differ from CAN_MASTER"
        node.node: |it| it as u16, |value| Some(value as u8);
    181 "CAN_MASTER" "" (1, 127) "node-ID of the CANopen master, whose heartbeat is monitored"
        node.master: |it| it as u16, |value| Some(value as u8);
    together 180: |it| it.node.is_valid();
}

/// Returns whether CANopen reserves one of the gripper's identifiers, for this device or another.
#[must_use]
pub fn collides_with_canopen(gripper: Identifiers) -> bool {
    let pair = gripper.controller();
    [pair.transmit, pair.receive].into_iter().any(|id| bus_canopen::is_reserved(id.as_raw()))
}
