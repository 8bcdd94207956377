//! What is set about the bridge as a CANopen device.

use wsg_protocol::can::Identifiers;

/// TPDOs of the bridge.
pub(super) const TPDOS: usize = 2;

/// As built. What a master can change has an object ([`OBJECTS`](super::OBJECTS)); power-up brings this back.
pub type NodeConfig = bus_canopen::Config<TPDOS>;

/// Node 10h, master 7Fh, a heartbeat twice a second. State and status 2 ms apart at the least, width and force 20 ms,
/// which change all the time while the fingers move; both every 100 ms without a change.
pub const DEFAULT_NODE: NodeConfig =
    NodeConfig { node: 0x10, master: 0x7F, heartbeat_ms: 500, inhibit: [20, 200], event_ms: [100, 100] };

/// Whether the gripper's identifiers are among those that CANopen uses, on this device or another.
#[must_use]
pub fn collides_with_canopen(gripper: Identifiers) -> bool {
    let pair = gripper.controller();
    [pair.transmit, pair.receive].into_iter().any(|id| bus_canopen::is_reserved(id.as_raw()))
}
