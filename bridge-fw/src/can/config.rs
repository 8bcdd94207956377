//! What is fixed about CAN when the bridge starts: the bus's rate, and who the bridge is on it.

use wsg_protocol::can::Identifiers;

use crate::register::setting_rows;

/// TPDOs of the bridge.
pub(crate) const TPDOS: usize = 2;

/// The bridge as a CANopen device at power-up. What a master can change has an object
/// by SDO.
pub type NodeConfig = bus_canopen::Config<TPDOS>;

/// Node 10h, master 7Fh, a heartbeat twice a second. State and status 2 ms apart at the least, width and force 20 ms,
/// which change all the time while the fingers move; both every 100 ms without a change. Ten emergencies a second at the most.
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
    /// The rate in kbit/s: 125, 250, 500 or 1000.
    pub kbit_rate: u16,
    /// The identifiers that the gripper listens to and sends on.
    pub gripper: Identifiers,
    /// The bridge as a CANopen device.
    pub node: NodeConfig,
}

impl CanConfig {
    /// 500 kbit/s, the gripper on 120h and 121h, node 10h.
    pub const DEFAULT: Self = Self { kbit_rate: 500, gripper: Identifiers::DEFAULT, node: DEFAULT_NODE };
}

setting_rows! { CanConfig:
    178 "CAN_RATE" "kbit/s" (125, 1_000) "the rate of CAN: 125, 250, 500 or 1000"
        kbit_rate: |it| it, |value| matches!(value, 125 | 250 | 500 | 1_000).then_some(value);
    179 "CAN_ID" "" (0, 0x7FE)
        "the identifier that the gripper listens to; it sends on the next one. None of both may be one of CANopen's"
        gripper: |it| it.base(), |value| Identifiers::from_base(value).filter(|it| !collides_with_canopen(*it));
    180 "CAN_NODE" "" (1, 127) "the bridge's node-ID; not CAN_MASTER's"
        node.node: |it| it as u16, |value| Some(value as u8);
    181 "CAN_MASTER" "" (1, 127) "the node-ID of the CANopen master, whose heartbeat is watched"
        node.master: |it| it as u16, |value| Some(value as u8);
    together 180: |it| it.node.is_valid();
}

/// Whether the gripper's identifiers are among those that CANopen uses, on this device or another.
#[must_use]
pub fn collides_with_canopen(gripper: Identifiers) -> bool {
    let pair = gripper.controller();
    [pair.transmit, pair.receive].into_iter().any(|id| bus_canopen::is_reserved(id.as_raw()))
}
