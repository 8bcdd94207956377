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

/// All messages that are due, as "KIND DEVICE" and, for data, its moment, and whether it is historical.
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
fn births_come_first_then_what_was_stored_as_historical_then_what_is_new() {
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
fn device_that_went_during_an_outage_is_born_for_its_history_and_dies_behind_it() {
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
fn device_that_comes_back_while_its_history_is_sent_stays() {
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
fn what_was_not_confirmed_is_sent_again_over_the_next_connection() {
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
fn sequence_numbers_run_from_0_to_255_and_around_and_begin_again_with_a_rebirth() {
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
    node.command("spBv1.0/plant/NCMD/cell", &rebirth.encode_to_vec()).unwrap();

    let births: Vec<_> = std::iter::from_fn(|| node.poll_transmit(3)).collect();
    assert_eq!(births.iter().map(text_of).collect::<Vec<_>>(), ["NBIRTH ", "DBIRTH left"]);
    assert_eq!(births.iter().map(sequence_of).collect::<Vec<_>>(), [Some(0), Some(1)]);
}

#[test]
fn node_tells_what_changed_of_itself_once_a_second_at_the_most() {
    let mut node = node_of(1);
    node.connected(0);
    assert_eq!(sent(&mut node, 1_000), ["NBIRTH "]);
    node.take(found(0, 1_100));
    assert_eq!(sent(&mut node, 1_999), ["DBIRTH left"]);
    assert_eq!(sent(&mut node, 2_000), ["NDATA "]);
    assert_eq!(sent(&mut node, 3_000), [""; 0]);
}

#[test]
fn death_has_the_number_of_its_connection_and_no_sequence_number() {
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
        node.command(topic, payload).unwrap_err();
    }
    assert_eq!(node.own.refused, 3);
}
