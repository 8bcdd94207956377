use super::*;

const TABLE: &[Metric] = GRIPPER;

fn node_of(capacity: usize) -> Node {
    Node::new("plant", "cell", &[("left".to_owned(), TABLE), ("right".to_owned(), TABLE)], capacity)
}

fn found(device: u16, at: u64) -> Report {
    let values = vec![Some(Value::Unsigned(0)); TABLE.len()];
    Report { device, at, what: What::Found { values, ranges: vec![Some((0.0, 1.0)); TABLE.len()] } }
}

fn changed(device: u16, at: u64) -> Report {
    Report { device, at, what: What::Changed(vec![(0, Some(Value::Float(at as f32)))]) }
}

const fn lost(device: u16, at: u64) -> Report {
    Report { device, at, what: What::Lost }
}

/// Sends all due messages. Returns each as "KIND DEVICE", for data with its time and `historical` if set.
fn sent(node: &mut Node, now: u64) -> Vec<String> {
    std::iter::from_fn(|| node.poll_transmit(now)).map(|message| text_of(&message)).collect()
}

fn text_of(message: &Message) -> String {
    let payload = Payload::decode(message.payload.as_slice()).unwrap();
    let parts: Vec<&str> = message.topic.split('/').collect();
    let mut text = format!("{} {}", parts[2], parts.get(4).unwrap_or(&""));
    if parts[2] == "DDATA" {
        let metric = &payload.metrics[0];
        text += &format!(" {}", metric.timestamp.unwrap());
        text += if metric.is_historical == Some(true) { " historical" } else { "" };
    }
    text
}

fn sequence_of(message: &Message) -> Option<u64> {
    Payload::decode(message.payload.as_slice()).unwrap().seq
}

#[test]
fn births_are_sent_first_then_historical_samples_then_new_data() {
    let mut node = node_of(10);
    node.take(found(0, 1));
    node.take(changed(0, 2));
    assert_eq!(sent(&mut node, 3), [""; 0]);

    node.connected(7);
    assert_eq!(sent(&mut node, 10), ["NBIRTH ", "DBIRTH left", "DDATA left 2 historical"]);
    node.take(found(1, 11));
    node.take(changed(0, 12));

    assert_eq!(sent(&mut node, 13), ["DBIRTH right", "DDATA left 12"]);
    node.take(lost(1, 14));
    assert_eq!(sent(&mut node, 15), ["DDEATH right"]);
}

#[test]
fn device_lost_in_an_outage_is_born_for_its_history_then_dies() {
    let mut node = node_of(10);
    node.take(found(0, 1));
    node.take(changed(0, 2));
    node.take(lost(0, 3));

    node.connected(0);

    let expected = ["NBIRTH ", "DBIRTH left", "DDATA left 2 historical", "DDEATH left"];
    assert_eq!(sent(&mut node, 10), expected);
    assert_eq!(sent(&mut node, 11), [""; 0]);
}

#[test]
fn birth_of_a_lost_device_shows_no_value_from_before_the_loss() {
    let is_null = |message: Message| {
        let payload = Payload::decode(message.payload.as_slice()).unwrap();
        payload.metrics.into_iter().map(|metric| metric.is_null == Some(true)).collect::<Vec<_>>()
    };
    let mut node = node_of(10);
    node.take(found(0, 1));
    node.take(changed(0, 2));
    node.take(lost(0, 3));
    node.connected(0);
    assert_eq!(text_of(&node.poll_transmit(10).unwrap()), "NBIRTH ");
    assert_eq!(is_null(node.poll_transmit(10).unwrap()), [true; TABLE.len()], "born for its history only");
    assert_eq!(sent(&mut node, 10), ["DDATA left 2 historical", "DDEATH left"]);

    // Found and lost before the message about the former is sent.
    node.take(found(0, 11));
    node.take(lost(0, 12));
    assert_eq!(is_null(node.poll_transmit(13).unwrap()), [true; TABLE.len()]);
    assert_eq!(sent(&mut node, 13), ["DDEATH left"]);

    node.take(found(0, 14));
    assert_eq!(
        is_null(node.poll_transmit(15).unwrap()),
        [false; TABLE.len()],
        "values of the new connection"
    );
}

#[test]
fn device_that_returns_while_its_history_is_sent_stays_alive() {
    let mut node = node_of(10);
    node.take(found(0, 1));
    node.take(changed(0, 2));
    node.take(lost(0, 3));
    node.connected(0);
    node.take(found(0, 4));

    let expected = ["NBIRTH ", "DBIRTH left", "DDATA left 2 historical", "DBIRTH left"];
    assert_eq!(sent(&mut node, 10), expected);
}

#[test]
fn unconfirmed_samples_are_sent_again_over_the_next_connection() {
    let mut node = node_of(10);
    node.take(found(0, 1));
    node.connected(0);
    sent(&mut node, 2);
    node.take(changed(0, 3));
    assert_eq!(sent(&mut node, 3), ["DDATA left 3"]);
    node.confirm(node.mark());
    node.take(changed(0, 4));
    assert_eq!(sent(&mut node, 4), ["DDATA left 4"]);
    assert!(node.is_unconfirmed());

    node.disconnected();
    node.take(changed(0, 5));
    node.connected(1);

    let expected = ["NBIRTH ", "DBIRTH left", "DDATA left 4 historical", "DDATA left 5 historical"];
    assert_eq!(sent(&mut node, 10), expected);
}

#[test]
fn sequence_numbers_wrap_at_255_and_restart_with_a_rebirth() {
    let mut node = node_of(1_000);
    node.take(found(0, 1));
    node.connected(0);
    (0..600).for_each(|at| node.take(changed(0, 100 + at)));
    let numbers: Vec<_> =
        std::iter::from_fn(|| node.poll_transmit(2)).map(|message| sequence_of(&message)).collect();
    assert_eq!(numbers.len(), 602);
    let expected = (0..602).map(|number| Some(number % 256));
    assert!(numbers.into_iter().eq(expected));

    let rebirth = Payload {
        metrics: vec![payload::Metric {
            name: Some(REBIRTH.to_owned()),
            value: Some(MetricValue::Boolean(true)),
            ..payload::Metric::default()
        }],
        ..Payload::default()
    };
    node.command("spBv1.0/plant/NCMD/cell", &rebirth.encode_to_vec(), false, 3).unwrap();

    let births: Vec<_> = std::iter::from_fn(|| node.poll_transmit(3)).collect();
    assert_eq!(births.iter().map(text_of).collect::<Vec<_>>(), ["NBIRTH ", "DBIRTH left"]);
    assert_eq!(births.iter().map(sequence_of).collect::<Vec<_>>(), [Some(0), Some(1)]);
}

#[test]
fn changed_node_values_are_sent_at_most_once_per_second() {
    let mut node = node_of(1);
    node.connected(0);
    assert_eq!(sent(&mut node, 1_000), ["NBIRTH "]);
    node.take(found(0, 1_100));
    assert_eq!(sent(&mut node, 1_999), ["DBIRTH left"]);
    assert_eq!(sent(&mut node, 2_000), ["NDATA "]);
    assert_eq!(sent(&mut node, 3_000), [""; 0]);
}

#[test]
fn death_carries_its_connection_number_and_no_sequence_number() {
    let death = node_of(1).identity().death(200, 5);
    let payload = Payload::decode(death.payload.as_slice()).unwrap();
    assert_eq!((&*death.topic, payload.seq), ("spBv1.0/plant/NDEATH/cell", None));
    assert_eq!((payload.metrics.len(), &payload.metrics[0].value), (1, &Some(MetricValue::Long(200))));
}

#[test]
fn commands_other_than_a_rebirth_are_refused_and_counted() {
    let mut node = node_of(1);
    for (topic, payload) in [
        ("spBv1.0/plant/NCMD/cell", &b""[..]),
        ("spBv1.0/plant/NCMD/cell", b"\xFF"),
        ("spBv1.0/plant/DCMD/cell/left", b""),
    ] {
        node.command(topic, payload, false, 1).unwrap_err();
    }
    assert_eq!(node.own.refused, 3);
}

/// A node whose device "left" accepts commands later than 1000, and the queue of its orders.
fn commanded() -> (Node, crate::telemetry::command::Queue) {
    let mut node = node_of(100);
    let (orders, queue) = crate::telemetry::command::queue();
    node.allow_commands(0, orders, 2_000, 1_000);
    node.connected(0);
    found_commanded(&mut node, 1);
    (node, queue)
}

fn found_commanded(node: &mut Node, at: u64) {
    let Report { device, at, what } = found(0, at);
    let What::Found { mut values, mut ranges } = what else { panic!("`found` returned another report") };
    values.extend(vec![None; COMMANDS.len()]);
    ranges.extend(vec![Some((0.0, 100.0)); COMMANDS.len()]);
    node.take(Report { device, at, what: What::Found { values, ranges } });
}

fn dcmd(
    node: &mut Node,
    at: Option<u64>,
    names: &[&str],
    is_retained: bool,
    now: u64,
) -> Result<String, String> {
    let metric = |name: &&str| payload::Metric {
        name: Some((*name).to_owned()),
        value: Some(MetricValue::Boolean(true)),
        ..payload::Metric::default()
    };
    let payload = Payload { timestamp: at, metrics: names.iter().map(metric).collect(), seq: None };
    node.command("spBv1.0/plant/DCMD/cell/left", &payload.encode_to_vec(), is_retained, now)
}

/// Returns all results that were sent to hosts.
fn results(node: &mut Node, now: u64) -> Vec<String> {
    let messages = std::iter::from_fn(|| node.poll_transmit(now));
    let mut results = Vec::new();
    for message in messages.filter(|message| message.topic.contains("DDATA")) {
        for metric in Payload::decode(message.payload.as_slice()).unwrap().metrics {
            assert_eq!((metric.alias, metric.datatype), (Some(alias(0, TABLE.len() + 10)), Some(12)));
            let Some(MetricValue::String(text)) = metric.value else { panic!("{:?}", metric.value) };
            results.push(text);
        }
    }
    results
}

#[test]
fn command_is_accepted_once_and_refused_when_repeated() {
    let (mut node, mut queue) = commanded();
    assert_eq!(dcmd(&mut node, Some(1_001), &["Command/Home"], false, 1_500), Ok("Home".to_owned()));
    let order = queue.others.try_recv().unwrap();
    assert_eq!((order.at, order.expires_at, order.life), (1_001, 3_001, 1));
    node.take(Report {
        device: 0,
        at: 1_510,
        what: What::Outcome { of: OfCommand::Home, text: "Home: done".into() },
    });

    let again = dcmd(&mut node, Some(1_001), &["Command/Home"], false, 1_520).unwrap_err();

    assert!(again.contains("not later"), "{again}");
    queue.others.try_recv().unwrap_err();
    assert_eq!(node.own.refused, 1);
    assert_eq!(results(&mut node, 1_600), ["Home: done".to_owned(), format!("refused: {again}")]);
}

#[test]
fn refused_command_is_refused_when_repeated() {
    let (mut node, mut queue) = commanded();
    dcmd(&mut node, Some(1_001), &["Command/Home"], false, 1_001).unwrap();
    queue.others.try_recv().unwrap();
    let why = dcmd(&mut node, Some(1_002), &["Command/Home"], false, 1_002).unwrap_err();
    assert!(why.contains("not over"), "{why}");
    node.take(Report {
        device: 0,
        at: 1_003,
        what: What::Outcome { of: OfCommand::Home, text: String::new() },
    });

    dcmd(&mut node, Some(1_002), &["Command/Home"], false, 1_004).unwrap_err();

    queue.others.try_recv().unwrap_err();
    dcmd(&mut node, Some(1_003), &["Command/Home"], false, 1_004).unwrap();
}

#[test]
fn stops_are_accepted_during_a_motion_and_queued_separately() {
    let (mut node, mut queue) = commanded();
    dcmd(&mut node, Some(1_001), &["Command/Home"], false, 1_001).unwrap();
    dcmd(&mut node, Some(1_002), &["Command/Fast Stop"], false, 1_002).unwrap();
    dcmd(&mut node, Some(1_003), &["Command/Acknowledge"], false, 1_003).unwrap();

    assert_eq!(queue.urgent.try_recv().unwrap().action, crate::telemetry::command::Action::FastStop);
    assert_eq!(queue.others.try_recv().unwrap().at, 1_001);
    assert_eq!(queue.others.try_recv().unwrap().at, 1_003);
}

#[test]
fn refused_commands_are_not_queued_but_reported_and_counted() {
    let (mut node, mut queue) = commanded();
    let home: &[&str] = &["Command/Home"];
    let cases = [
        (None, home, false, 1_500, "no timestamp"),
        // A timestamp from before the program start.
        (Some(1_000), home, false, 1_500, "or the program start"),
        (Some(1_001), home, false, 3_002, "older than 2000 ms"),
        (Some(5_001), home, false, 3_000, "ahead"),
        (Some(3_001), home, true, 3_002, "retained"),
        (Some(3_002), &["Command/Home", "Command/Grip"][..], false, 3_002, "more than one"),
    ];
    for (at, names, is_retained, now, expected) in cases {
        let why = dcmd(&mut node, at, names, is_retained, now).unwrap_err();
        assert!(why.contains(expected), "{why}");
    }
    for number in 0..4 {
        dcmd(&mut node, Some(4_000 + number), &["Command/Stop"], false, 4_000).unwrap();
    }
    let why = dcmd(&mut node, Some(4_010), &["Command/Stop"], false, 4_000).unwrap_err();
    assert!(why.contains("too many"), "{why}");
    queue.others.try_recv().unwrap_err();
    assert_eq!((node.own.refused, results(&mut node, 4_000).len()), (7, 7));

    // While the gripper is offline no data is sent; its next birth carries the result.
    node.take(lost(0, 4_001));
    let why = dcmd(&mut node, Some(4_020), home, false, 4_020).unwrap_err();
    assert!(why.contains("does not respond"), "{why}");
    assert_eq!(results(&mut node, 4_021), [""; 0]);
    found_commanded(&mut node, 4_030);
    let result = &node.devices[0].values[TABLE.len() + 10];
    assert_eq!(*result, Some(Value::Text(format!("refused: {why}"))));
    dcmd(&mut node, Some(4_031), home, false, 4_031).unwrap();
    assert_eq!(queue.others.try_recv().unwrap().life, 2);
}

#[test]
fn device_that_does_not_allow_commands_accepts_none() {
    let (mut node, _queue) = commanded();
    node.take(found(1, 1));
    sent(&mut node, 1_100);
    let payload = Payload {
        timestamp: Some(1_100),
        metrics: vec![payload::Metric {
            name: Some("Command/Home".to_owned()),
            value: Some(MetricValue::Boolean(true)),
            ..payload::Metric::default()
        }],
        seq: None,
    };
    for device in ["right", "none", "left/x"] {
        let topic = format!("spBv1.0/plant/DCMD/cell/{device}");
        node.command(&topic, &payload.encode_to_vec(), false, 1_100).unwrap_err();
    }
    assert_eq!((node.own.refused, sent(&mut node, 1_101)), (3, Vec::new()));
}
