//! What is set about the bridge as a CANopen device.

use wsg_protocol::can::Identifiers;

/// As built. What a master can change has an object ([`OBJECTS`](super::OBJECTS)); power-up brings this back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeConfig {
    /// The node-ID, 1 to 127.
    pub node: u8,
    /// The node-ID of the master, whose heartbeat is watched.
    pub master: u8,
    /// How often the bridge sends its heartbeat, in milliseconds; 0: never.
    pub heartbeat_ms: u16,
    /// The least time between two TPDOs of one kind, in 100 µs.
    pub inhibit: [u16; 2],
    /// The most time between two TPDOs of one kind, in milliseconds; 0: only on change.
    pub event_ms: [u16; 2],
}

impl NodeConfig {
    /// Node 10h, master 7Fh, a heartbeat twice a second. State and status 2 ms apart at the least, width and force 20 ms,
    /// which change all the time while the fingers move; both every 100 ms without a change.
    pub const DEFAULT: Self =
        Self { node: 0x10, master: 0x7F, heartbeat_ms: 500, inhibit: [20, 200], event_ms: [100, 100] };

    /// Whether both node-IDs are some.
    #[must_use]
    pub const fn is_valid(&self) -> bool {
        self.node >= 1
            && self.node <= 127
            && self.master >= 1
            && self.master <= 127
            && self.node != self.master
    }

    /// Whether the gripper's identifiers are among those that CANopen uses, on this device or another.
    #[must_use]
    pub fn collides_with(gripper: Identifiers) -> bool {
        let pair = gripper.controller();
        [pair.transmit.as_raw(), pair.receive.as_raw()].into_iter().any(Self::is_canopens)
    }

    /// Whether CANopen uses this identifier: NMT, SYNC and EMCY, TIME; PDOs; SDOs; heartbeats; LSS.
    pub(crate) const fn is_canopens(id: u16) -> bool {
        matches!(
            id,
            0 | 0x080..=0x100 | 0x181..=0x57F | 0x581..=0x5FF | 0x601..=0x67F | 0x701..=0x77F | 0x7E4..=0x7E5
        )
    }
}
