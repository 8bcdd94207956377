//! FAST STOP over a disturbed line: a sample of the cases. `cargo xtask fast-stop` runs all of them.

use host_tests::fault_sweep::Sweep;

/// Sampling interval: one case in this number is run.
const STRIDE: usize = 97;

#[test]
fn gripper_stops_in_time_with_any_bytes_damaged() {
    within_limits(&Sweep::all(STRIDE, false));
}

/// Fieldbus, 5.1.2.
#[test]
fn gstate_follows_a_third_party_in_time_with_any_byte_damaged() {
    within_limits(&Sweep::of_third_parties(STRIDE));
}

fn within_limits(sweeps: &[Sweep]) {
    for sweep in sweeps {
        let times = sweep.run();
        let (worst_ms, case) = times.worst().expect("at least one case");
        assert!(*worst_ms <= sweep.limit_ms, "{}: {worst_ms} ms: {case:?}", sweep.name);
    }
}
