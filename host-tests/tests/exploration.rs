//! Explores every order of events to a small depth. `cargo xtask explore` uses a greater depth.

use host_tests::explore::{Bounds, PlcKind};

/// Covers all orders of four actions.
const BOUNDS: Bounds = Bounds { depth: 4, states: u64::MAX };

fn explore(plc: PlcKind) -> Vec<&'static str> {
    let report = plc.explore(BOUNDS);
    println!("{report}");
    assert!(report.broken().is_empty(), "an invariant is violated; see the output above");
    report.unseen()
}

#[test]
fn promises_hold_in_every_order_of_events_on_the_wires() {
    assert_eq!(explore(PlcKind::Wires), ["a jog"]);
}

#[test]
fn promises_hold_in_every_order_of_events_on_the_bus() {
    assert_eq!(explore(PlcKind::Bus), ["a release"]);
}
