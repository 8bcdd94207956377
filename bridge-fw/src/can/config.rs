//! What is fixed about CAN when the bridge starts: the bus's rate, and who the bridge is on it.

use super::{DEFAULT_NODE, NodeConfig};
use crate::built::number;
use bus_canopen::is_reserved;
use wsg_protocol::can::Identifiers;

/// The CAN bus at power-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanConfig {
    /// The rate in kbit/s: 125, 250, 500 or 1000.
    pub kbit_rate: u32,
    /// The identifiers that the gripper listens to and sends on.
    pub gripper: Identifiers,
    /// The bridge as a CANopen device.
    pub node: NodeConfig,
}

impl CanConfig {
    /// 500 kbit/s, the gripper on 120h and 121h, node 10h.
    pub const DEFAULT: Self = Self { kbit_rate: 500, gripper: Identifiers::DEFAULT, node: DEFAULT_NODE };

    /// What the firmware is built with: [`DEFAULT`](Self::DEFAULT), but for the environment variables `WSG_CAN_RATE`
    /// (kbit/s), `WSG_CAN_ID` (the identifier that the gripper listens to; it sends on the next one), `WSG_CAN_NODE` and
    /// `WSG_CAN_MASTER` (node-IDs, 1 to 127) of the build. Numbers may be hexadecimal: `0x120`.
    pub const BUILT: Self = {
        let mut config = Self::DEFAULT;
        if let Some(rate) = option_env!("WSG_CAN_RATE") {
            config.kbit_rate = number(rate);
        }
        if let Some(id) = option_env!("WSG_CAN_ID") {
            let id = number(id);
            assert!(id < 0x7FF, "WSG_CAN_ID must be 0 to 0x7FE");
            let id = id as u16;
            let is_free = !is_reserved(id) && !is_reserved(id.saturating_add(1));
            assert!(is_free, "WSG_CAN_ID and the next identifier must be none that CANopen uses");
            if let Some(pair) = Identifiers::from_base(id) {
                config.gripper = pair;
            }
        }
        if let Some(node) = option_env!("WSG_CAN_NODE") {
            config.node.node = node_id(node);
        }
        if let Some(master) = option_env!("WSG_CAN_MASTER") {
            config.node.master = node_id(master);
        }
        assert!(config.node.is_valid(), "WSG_CAN_NODE and WSG_CAN_MASTER must be two node-IDs from 1 to 127");
        config
    };
}

const fn node_id(text: &str) -> u8 {
    let number = number(text);
    assert!(number >= 1 && number <= 127, "WSG_CAN_NODE and WSG_CAN_MASTER must be 1 to 127");
    number as u8
}
