use super::*;

const NOW: u64 = 100_000;
const RANGES: &[Option<(f32, f32)>] = &[
    None,
    None,
    None,
    None,
    None,
    None,
    None,
    Some((0.0, 110.0)),
    Some((5.0, 420.0)),
    Some((5.0, 50.0)),
    None,
];
const SITUATION: Situation<'static> = Situation {
    now: NOW,
    age_ms: 2_000,
    last_at: NOW - 1_000,
    is_online: true,
    is_moving: false,
    ranges: RANGES,
    first_alias: 78,
};

fn metric(name: &str, value: MetricValue) -> payload::Metric {
    payload::Metric { name: Some(name.to_owned()), value: Some(value), ..payload::Metric::default() }
}

fn command(name: &str) -> payload::Metric {
    metric(name, MetricValue::Boolean(true))
}

fn number(name: &str, number: f32) -> payload::Metric {
    metric(name, MetricValue::Float(number))
}

fn of(metrics: Vec<payload::Metric>) -> Payload {
    Payload { timestamp: Some(NOW), metrics, seq: None }
}

fn refusal(metrics: Vec<payload::Metric>) -> String {
    SITUATION.decide(&of(metrics)).unwrap_err()
}

#[test]
fn each_command_is_accepted_with_its_parameters() {
    let both = || [number("Command/Width", 20.0), number("Command/Speed", 100.0)];
    let with = |name: &str, rest: &[payload::Metric]| of([&[command(name)], rest].concat());
    let force = &number("Command/Force", 30.0);
    let all = [&both()[..], std::slice::from_ref(force)].concat();
    let (width, speed) = (20.0, 100.0);
    for (payload, expected) in [
        (with("Command/Home", &[]), Action::Home),
        (with("Command/Move", &both()), Action::Move { width, speed, force: None }),
        (with("Command/Move", &all), Action::Move { width, speed, force: Some(30.0) }),
        (with("Command/Grip", &both()), Action::Grip { width, speed, force: None }),
        (with("Command/Grip", &all), Action::Grip { width, speed, force: Some(30.0) }),
        (with("Command/Release", &both()), Action::Release { width, speed }),
        (with("Command/Stop", &[]), Action::Stop),
        (with("Command/Fast Stop", &[]), Action::FastStop),
        (with("Command/Acknowledge", &[]), Action::Acknowledge),
    ] {
        assert_eq!(SITUATION.decide(&payload), Ok(expected));
        let is_motion = expected.of().is_motion();
        let moving = Situation { is_moving: true, ..SITUATION }.decide(&payload);
        assert_eq!(moving.is_err(), is_motion, "{expected:?} during a motion");
        let offline = Situation { is_online: false, ..SITUATION }.decide(&payload).unwrap_err();
        assert!(offline.contains("does not respond"), "{offline}");
    }
}

#[test]
fn metrics_are_identified_by_the_alias_of_the_birth() {
    let by_alias = |alias| payload::Metric { name: None, alias: Some(alias), ..command("") };
    assert_eq!(SITUATION.decide(&of(vec![by_alias(78)])), Ok(Action::Home));
    assert_eq!(SITUATION.decide(&of(vec![by_alias(83)])), Ok(Action::FastStop));
    for alias in [77, 88, 89, 0, 14] {
        assert!(
            refusal(vec![by_alias(alias)]).contains("not a command or parameter of this gripper"),
            "{alias}"
        );
    }
    let contradiction = payload::Metric { alias: Some(79), ..command("Command/Home") };
    assert!(refusal(vec![contradiction]).contains("is not a gripper command"));
}

#[test]
fn anything_but_one_command_with_its_parameters_is_refused() {
    let speed = || number("Command/Speed", 100.0);
    let width = |mm| number("Command/Width", mm);
    let typed = |datatype, metric| payload::Metric { datatype: Some(datatype), ..metric };
    for (metrics, expected) in [
        (vec![], "no command"),
        (vec![width(20.0), speed()], "no command"),
        (vec![command("Home")], "\"Home\" is not a gripper command"),
        (vec![command("Command/Home"), command("Width")], "\"Width\" is not a gripper command"),
        (vec![command("Command/Result")], "is not a gripper command"),
        (vec![payload::Metric { name: None, ..command("") }], "neither name nor alias"),
        (vec![command("Command/Home"), command("Command/Stop")], "more than one command"),
        (vec![command("Command/Home"), command("Command/Home")], "more than one command"),
        (vec![metric("Command/Home", MetricValue::Boolean(false))], "Command/Home is not true"),
        (vec![metric("Command/Home", MetricValue::Long(1))], "Command/Home is not true"),
        (vec![payload::Metric { value: None, ..command("Command/Home") }], "Command/Home is not true"),
        (vec![payload::Metric { is_null: Some(true), ..command("Command/Home") }], "null or historical"),
        (
            vec![payload::Metric { is_historical: Some(true), ..command("Command/Home") }],
            "null or historical",
        ),
        (vec![typed(9, command("Command/Home"))], "differs from the birth"),
        (vec![command("Command/Grip"), typed(10, width(20.0)), speed()], "differs from the birth"),
        (vec![command("Command/Home"), width(20.0)], "Home takes no parameters"),
        (vec![command("Command/Stop"), speed()], "Stop takes no parameters"),
        (vec![command("Command/Move"), width(20.0)], "Move requires a width and a speed"),
        (vec![command("Command/Grip"), speed()], "Grip requires a width and a speed"),
        (
            vec![command("Command/Release"), width(20.0), speed(), number("Command/Force", 30.0)],
            "Release requires a width and a speed, and no force",
        ),
        (vec![command("Command/Grip"), width(20.0), width(20.0), speed()], "Command/Width appears twice"),
        (
            vec![command("Command/Grip"), metric("Command/Width", MetricValue::Long(20)), speed()],
            "Command/Width is not a Float",
        ),
        (vec![command("Command/Move"), width(110.1), speed()], "Command/Width = 110.1 is outside 0 to 110"),
        (vec![command("Command/Move"), width(-0.1), speed()], "is outside 0 to 110"),
        (vec![command("Command/Move"), width(f32::NAN), speed()], "Command/Width = NaN is outside"),
        (vec![command("Command/Move"), width(f32::INFINITY), speed()], "is outside 0 to 110"),
        (vec![command("Command/Move"), width(20.0), number("Command/Speed", 4.9)], "is outside 5 to 420"),
        (
            vec![command("Command/Grip"), width(20.0), speed(), number("Command/Force", 50.1)],
            "Command/Force = 50.1 is outside 5 to 50",
        ),
    ] {
        let why = refusal(metrics);
        assert!(why.contains(expected), "{why}, expected {expected}");
    }
    let unknown = Situation { ranges: &[], ..SITUATION };
    let why = unknown.decide(&of(vec![command("Command/Move"), width(20.0), speed()])).unwrap_err();
    assert_eq!(why, "the range of Command/Width is unknown");
}

#[test]
fn command_timestamp_must_be_current_and_later_than_the_last() {
    let situation = Situation { last_at: 0, ..SITUATION };
    let at = |situation: Situation<'_>, at| {
        situation.time_of(&Payload { timestamp: at, metrics: Vec::new(), seq: None })
    };
    assert!(at(situation, None).unwrap_err().contains("no timestamp"));
    assert!(at(situation, Some(NOW - 2_001)).unwrap_err().contains("older than 2000 ms"));
    assert_eq!(at(situation, Some(NOW - 2_000)), Ok(NOW - 2_000));
    assert_eq!(at(situation, Some(NOW + 2_000)), Ok(NOW + 2_000));
    assert!(at(situation, Some(NOW + 2_001)).unwrap_err().contains("ahead"));
    assert!(at(situation, Some(u64::MAX)).unwrap_err().contains("ahead"));
    assert!(at(situation, Some(0)).unwrap_err().contains("older"));
    for again in [NOW - 1_000, NOW - 1_001] {
        assert!(at(SITUATION, Some(again)).unwrap_err().contains("not later"), "{again}");
    }
    assert_eq!(at(SITUATION, Some(NOW - 999)), Ok(NOW - 999));
}
