use super::*;

const POLICY: BusOffPolicy = BusOffPolicy { delay_ms: 100, recovery_ms: 500, limit: 3, stable_ms: 10_000 };

/// Returns the actions during `ms` milliseconds from `from_ms` on, with an unchanged controller, and their times.
fn pass(bus: &mut BusOff, from_ms: u32, ms: u32, is_off: bool) -> std::vec::Vec<(u32, Step)> {
    (from_ms..from_ms + ms)
        .map(|now| (now, bus.update(Instant::from_millis(now), is_off)))
        .filter(|(_, step)| *step != Step::Nothing)
        .collect()
}

#[test]
fn bus_is_left_at_once_and_rejoined_after_delay_and_recovery() {
    let mut bus = BusOff::new(POLICY);
    assert_eq!(pass(&mut bus, 0, 1_000, false), []);
    assert_eq!(pass(&mut bus, 1_000, 300, true), [(1_000, Step::Leave), (1_100, Step::Recover)]);
    assert_eq!(bus.state(), BusState::Recovering);
    assert_eq!(pass(&mut bus, 1_300, 1_000, false), [(1_300, Step::Join)]);
    assert_eq!(bus.state(), BusState::On);
}

#[test]
fn slow_recovery_is_a_failure_and_the_last_failure_gives_up() {
    let mut bus = BusOff::new(POLICY);
    let recoveries = [(0, Step::Leave), (100, Step::Recover), (700, Step::Recover)];
    assert_eq!(pass(&mut bus, 0, 1_200, true), recoveries);
    assert_eq!(bus.state(), BusState::Recovering);
    assert_eq!(pass(&mut bus, 1_200, 60_000, true), []);
    assert_eq!(bus.state(), BusState::GivenUp);
    assert_eq!(pass(&mut bus, 61_200, 60_000, false), [], "no recovery without a retry");

    bus.retry(Instant::from_millis(121_200));
    assert_eq!(pass(&mut bus, 121_200, 200, false), [(121_300, Step::Recover), (121_301, Step::Join)]);
}

#[test]
fn without_a_limit_recovery_is_never_given_up() {
    let mut bus = BusOff::new(BusOffPolicy { limit: 0, ..POLICY });
    let steps = pass(&mut bus, 0, 60_000, true);
    assert_eq!(steps.len(), 101, "every 600 ms: {steps:?}");
}

#[test]
fn unnecessary_retry_changes_nothing() {
    let mut bus = BusOff::new(POLICY);
    bus.retry(Instant::from_millis(5));
    assert_eq!(bus.state(), BusState::On);
}

#[test]
fn failures_count_until_the_stable_time_without_a_failure() {
    for (stable_ms, is_given_up) in [(POLICY.stable_ms - 1, true), (POLICY.stable_ms, false)] {
        let mut bus = BusOff::new(BusOffPolicy { limit: 2, ..POLICY });
        pass(&mut bus, 0, 101, true);
        assert_eq!(pass(&mut bus, 101, stable_ms + 1, false), [(101, Step::Join)]);
        pass(&mut bus, 102 + stable_ms, 1, true);
        assert_eq!(bus.state() == BusState::GivenUp, is_given_up, "{stable_ms} ms");
    }
}
