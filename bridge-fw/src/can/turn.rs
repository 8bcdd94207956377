//! A turn of a bridge whose gripper is on the bus: what comes before what, in one place for every board.

use wsg_protocol::Instant;

use super::{BusReport, CanBus, CanController, GripperLink, Participant};
use crate::Bridge;
use crate::io::Outputs;

/// One turn of the main loop with the gripper on the bus, and somebody else on it or [`Nobody`](super::Nobody). `poll` is
/// the bridge's own turn; it is given what is known of the bus for those who report it.
pub fn turn_with_gripper<C: CanController, P: Participant<C::Frame>>(
    now: Instant,
    bridge: &mut Bridge,
    bus: &mut CanBus<C>,
    link: &mut GripperLink,
    other: &mut P,
    poll: impl FnOnce(&mut Bridge, &mut GripperLink, &mut P, &BusReport) -> Outputs,
) -> Outputs {
    bus.listen(now, link, other);
    link.expire(now);
    // Before the bridge's turn: what a bus that is lost carried must not be gone on with.
    bridge.set_link_lost(bus.is_lost());
    let report = bus.report(link.counters());
    bridge.set_can_reports(report.registers());
    let outputs = poll(bridge, link, other, &report);
    // Before anything is said: what was said to a gripper that is lost must not leave.
    link.set_connected(bridge.is_connected());
    bus.talk(now, link, other);
    outputs
}
