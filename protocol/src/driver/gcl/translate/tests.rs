//! The common features of both protocols, and the closest equivalents of the others.

use super::*;

#[test]
fn settings_of_a_session_are_the_same_over_gcl() {
    let config = session::Config {
        reply_timeout_ms: 1,
        attempts: 2,
        refresh_ms: 3,
        reconnect_ms: 4,
        motion_timeout_ms: 5,
        result_grace_ms: 6,
        update_period_ms: 7,
        width: true,
        speed: true,
        force: true,
        ..session::Config::DEFAULT
    };
    let lines = session_config(&config);
    assert_eq!((lines.reply_timeout_ms, lines.attempts, lines.refresh_ms), (1, 2, 3));
    assert_eq!((lines.reconnect_ms, lines.motion_timeout_ms, lines.result_grace_ms), (4, 5, 6));
    assert_eq!((lines.interval_ms, lines.width, lines.speed, lines.force), (7, true, true, true));
    let none = session_config(&session::Config { width: false, speed: false, force: false, ..config });
    assert_eq!((none.width, none.speed, none.force), (false, false, false));
}

#[test]
fn subscriptions_are_the_same_but_no_faster_than_gcl_allows() {
    let least = Autosend::MIN_INTERVAL_MS;
    for (period_ms, interval_ms) in [(1, least), (10, 10), (11, 11), (500, 500)] {
        let every = autosend(Topic::Width, AutoUpdate::every(period_ms));
        assert_eq!(every, Autosend::every(LineTopic::Pos, interval_ms));
        let on_change = autosend(Topic::SystemState, AutoUpdate::on_change(period_ms));
        assert_eq!(on_change, Autosend::on_change(LineTopic::Sysflags, interval_ms));
    }
    assert_eq!(autosend(Topic::Force, AutoUpdate::once()), Autosend::off(LineTopic::Force));
}

#[test]
fn temperature_is_the_nearest_tenth_of_a_degree() {
    for (celsius, nearest) in [
        (34.24, 342),
        (34.26, 343),
        (0.04, 0),
        (0.0, 0),
        (-0.04, 0),
        (-3.24, -32),
        (-3.26, -33),
        (1e9, i16::MAX),
    ] {
        assert_eq!(tenths(celsius), Temperature(nearest), "{celsius}");
    }
}
