//! What is fixed about CAN when the bridge starts: the bus's rate, and who the bridge is on it.

use wsg_protocol::can::Identifiers;

/// TPDOs of the bridge.
pub(crate) const TPDOS: usize = 2;

/// The bridge as a CANopen device at power-up. What a master can change has an object
/// ([`OBJECTS`](crate::can::OBJECTS)).
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

/// Whether the gripper's identifiers are among those that CANopen uses, on this device or another.
#[must_use]
pub fn collides_with_canopen(gripper: Identifiers) -> bool {
    let pair = gripper.controller();
    [pair.transmit, pair.receive].into_iter().any(|id| bus_canopen::is_reserved(id.as_raw()))
}
