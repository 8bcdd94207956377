//! CAN: the gripper on a bus instead of a serial line, and a PLC on a bus instead of wires.
//!
//! [`CanBus`] owns the controller, shares it between those who are on the bus ([`CanNode`]), and leaves and joins the
//! bus when the controller goes bus-off. [`GripperLink`](crate::gripper::GripperLink) is one of them: to the bridge it is
//! a line like any other. The PLC's side by CANopen is the other. The board gives the controller, behind [`CanController`].
//!
//! The mapping of messages to frames is `wsg_protocol::can`'s.

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
