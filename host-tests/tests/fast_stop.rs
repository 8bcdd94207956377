//! FAST STOP reaches the gripper through faults of the line: a part of the cases; `cargo xtask fast-stop` runs them all.

use host_tests::fault_sweep::Sweep;

/// Of the milliseconds, bytes and chances: one in so many.
const STRIDE: usize = 97;

#[test]
fn gripper_stops_in_time_whatever_bytes_are_damaged() {
    for sweep in Sweep::all(STRIDE, false) {
        let times = sweep.run();
        let (worst_ms, case) = times.worst().expect("there are cases");
        assert!(*worst_ms <= sweep.limit_ms, "{}: {worst_ms} ms: {case:?}", sweep.name);
    }
}
