//! CAN: the gripper or the PLC on a CAN bus.
//!
//! [`CanBus`] owns the controller, shares it between the participants ([`CanNode`]), and leaves and rejoins the bus after
//! bus-off. One participant is [`GripperLink`](crate::gripper::GripperLink), a line like any other to the bridge. The other
//! is the PLC's CANopen side. The board implements [`CanController`].
//!
//! `wsg_protocol::can` maps messages to frames.

mod bus;
mod bus_off;
mod config;
mod controller;
mod mcp2515;
mod report;
mod transmit_buffers;

pub use bus::{CanBus, CanNode};
pub(crate) use bus::{MAX_ON_THE_WAY, MAX_RECEIVED_PER_POLL};
pub use bus_off::{BusOffPolicy, BusState};
pub(crate) use config::TPDOS;
pub use config::{CanConfig, DEFAULT_NODE, NodeConfig, collides_with_canopen};
pub use controller::{CanController, Health, NoCan, NoFrame, Withdrawal};
pub use mcp2515::{Mcp2515, Mcp2515Buffers, Overrun};
pub use report::{BusCounters, BusReport, CanReports, LinkCounters};
pub use transmit_buffers::TransmitBuffers;
