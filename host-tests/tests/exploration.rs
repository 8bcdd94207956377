//! Explores every order of events to a small depth. `cargo xtask explore` uses a greater depth.

use host_tests::explore::{Bounds, PlcKind, replay};
use host_tests::operation::image;
use host_tests::operation::names::*;
use wsg_bridge_fw::io::Outputs;

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

/// Found by the exploration of 10^8 states, when the rule of HOLDING did not know third parties.
#[test]
fn third_party_may_grip_while_busy_answers_a_refused_edge() {
    let kept = replay(
        PlcKind::Wires,
        "moving",
        &[
            Gripper(Fails),
            AnswersAll,
            Toggle(Inputs::MOVE),
            Gripper(ThirdPartyBegins(GripPart)),
            Gripper(Finishes),
            AnswersAll,
        ],
    );
    assert!(kept.is_ok_and(|outputs| outputs.contains(Outputs::BUSY | Outputs::HOLDING)), "{kept:?}");
}

/// Found by the same exploration, when a motion of the PLC counted that ERROR had ended before it was sent.
#[test]
fn third_party_may_grip_while_a_motion_of_the_plc_waits() {
    let image = |flags| image(flags, [30_00, 50_00, 40_00]);
    let kept = replay(
        PlcKind::Bus,
        "homed",
        &[
            Write(image(CommandFlags::STOP_ACK)),
            Toggle(Inputs::GRIP),
            Write(image(CommandFlags::MOVE)),
            Gripper(ThirdPartyBegins(GripPart)),
            Gripper(Finishes),
            AnswersAll,
        ],
    );
    assert!(kept.is_ok_and(|outputs| outputs.contains(Outputs::BUSY | Outputs::HOLDING)), "{kept:?}");
}
