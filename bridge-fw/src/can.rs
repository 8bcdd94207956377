//! CAN: the gripper on a bus instead of a serial line, and a PLC on a bus instead of wires.
//!
//! [`CanBus`] owns the controller, shares it between those who are on the bus ([`CanNode`]), and leaves and joins the
//! bus when the controller goes bus-off. [`GripperLink`](crate::gripper::GripperLink) is one of them: to the bridge it is
//! a line like any other. [`Node`] is the other: the PLC's side, by CANopen. The board gives the controller, behind [`CanController`].
//!
//! The mapping of messages to frames is `wsg_protocol::can`'s.

mod bus;
mod bus_off;
mod controller;
mod mcp2515;
mod node;
mod report;

pub use crate::config::{CanConfig, DEFAULT_NODE, NodeConfig, collides_with_canopen};
pub(crate) use bus::MAX_ON_THE_WAY;
pub use bus::{CanBus, CanNode, NullNode};
pub use bus_off::{BusOffPolicy, BusState};
pub use controller::{CanController, Health, NoCan, NoFrame, Withdrawal};
pub use mcp2515::{Mcp2515, Mcp2515Buffers, Overrun};
pub use node::{
    DataType, FAULTS, Fault, INPUT_INDEX, Key, NmtState, Node, OBJECTS, OUTPUT_INDEX, Object, REPORTS_INDEX,
    SETTINGS_INDEX, write_eds,
};
pub use report::{BusCounters, BusReport, LinkCounters};
