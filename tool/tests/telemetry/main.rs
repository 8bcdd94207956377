//! Runs `wsg telemetry` between virtual grippers and mosquitto. Eclipse Tahu's library decodes the messages.

#![cfg(all(unix, feature = "telemetry"))]

mod bridged;
mod commanded;
mod hostile;
mod load;
mod rig;

use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use rig::{Broker, Folder, Gripper, Host, Telemetry, Way, encoded, is_of, is_whole, metric};
use serde_json::{Value, json};
use wsg_protocol::{Command, HomingDirection, PrePositionFlags, Reply, Status, SystemFlags};
use wsg_sim::{
    Config,
    server::{Lines, SerialLine, ServerThread, UdpLine},
};

const HOME: Command<'static> = Command::Homing { direction: HomingDirection::Positive };

/// A motion slow enough that each state is reported: 10 mm take 100 ms in these grippers' time.
fn move_to(width: f32) -> Command<'static> {
    Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed: 5.0 }
}

/// Returns the latest value of a metric in births and data.
fn latest<'a>(messages: &'a [Value], birth: &Value, name: &str) -> Option<&'a Value> {
    let alias = &metric(birth, name)["alias"];
    let metrics = messages.iter().filter_map(|message| message["metrics"].as_array()).flatten();
    metrics.rev().find(|metric| metric["alias"] == *alias).map(|metric| &metric["value"])
}

#[test]
#[ignore = "needs mosquitto and sparkplug_payload: run `cargo xtask test`"]
fn births_data_and_deaths_reach_mosquitto_and_sparkplug_payload() {
    let (folder, mut gripper) = (Folder::new(), Gripper::start());
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    let telemetry = Telemetry::at(&folder, broker.port, &gripper.section("left"));

    // Births: names, types, units, ranges, aliases.
    let node = host.wait_for("NBIRTH", "");
    assert_eq!((&node["seq"], &metric(&node, "bdSeq")["value"]), (&json!(0), &json!(0)));
    assert_eq!(metric(&node, "Node Control/Rebirth")["value"], false);
    assert!(metric(&node, "Node Control/Rebirth").get("alias").is_none());
    let birth = host.wait_for("DBIRTH", "left");
    let width = metric(&birth, "Width");
    assert_eq!((&width["type"], &width["value"]), (&json!("Float"), &Value::Null));
    assert_eq!(width["properties"]["engUnit"]["value"], "mm");
    assert_eq!(width["properties"]["engLow"]["value"], 0);
    assert_eq!(width["properties"]["engHigh"]["value"], 110);
    assert_eq!(metric(&birth, "Properties/Serial Number")["value"], 4711);
    assert_eq!(metric(&birth, "State")["value"], "IDLE");
    let mut aliases: Vec<_> = [&node, &birth]
        .iter()
        .flat_map(|birth| birth["metrics"].as_array().unwrap())
        .filter_map(|metric| metric["alias"].as_u64())
        .collect();
    let count = aliases.len();
    aliases.sort_unstable();
    aliases.dedup();
    assert_eq!((aliases.len(), count), (count, birth["metrics"].as_array().unwrap().len() + 6));

    // Data: changed metrics, identified by alias only.
    let mut controller = gripper.controller();
    assert_eq!(
        (controller.command(HOME), controller.command(move_to(40.0))),
        (Status::Success, Status::Success)
    );
    let messages = host.wait("the width", |messages| {
        let width = latest(messages, &birth, "Width").and_then(Value::as_f64);
        width.is_some_and(|width| (width - 40.0).abs() < 0.1)
            && latest(messages, &birth, "Moving") == Some(&json!(false))
    });
    let data: Vec<_> = messages.iter().filter(|message| is_of(message, "DDATA", "left")).collect();
    assert!(data.len() > 2, "{data:?}");
    for metric in data.iter().flat_map(|message| message["metrics"].as_array().unwrap()) {
        assert!(metric.get("name").is_none() && metric["alias"].is_u64(), "{metric}");
        assert!(metric.get("isHistorical").is_none_or(|it| it == false), "{metric}");
    }
    assert!(
        data.iter()
            .any(|message| latest(&[(*message).clone()], &birth, "State") == Some(&json!("POSITIONING")))
    );

    // The gripper is switched off and on again.
    drop(controller);
    gripper.switch_off();
    host.wait_for("DDEATH", "left");
    host.clear();
    gripper.switch_on();
    let again = host.wait_for("DBIRTH", "left");
    assert_eq!(metric(&again, "Diagnostics/Connections")["value"], 2);

    // Exit: announced to the host and to the gripper.
    telemetry.end();
    let death = host.wait_for("NDEATH", "");
    assert_eq!(metric(&death, "bdSeq")["value"], 0);
    assert!(death.get("seq").is_none_or(Value::is_null), "{death}");
    let messages = host.wait("the last messages", |_| true);
    let flags = gripper.controller().ask(
        Command::GetSystemState { update: wsg_protocol::AutoUpdate::once() },
        |reply: &Reply<'_>| match reply.value() {
            Some(wsg_protocol::Value::GetSystemState(flags)) => Some(flags),
            _ => None,
        },
    );
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags:?}");

    // All messages except NDEATH carry consecutive sequence numbers.
    let numbers = messages.iter().filter_map(|message| message["seq"].as_u64()).collect::<Vec<_>>();
    assert!(numbers.windows(2).all(|pair| pair[1] == (pair[0] + 1) % 256), "{numbers:?}");
}

/// A value of a metric that a host received as data.
#[derive(Clone, Debug)]
struct Published {
    at: u64,
    value: Value,
    is_historical: bool,
}

/// Returns all values of a metric that a host received as data, in order.
fn published(messages: &[Value], alias: &Value) -> Vec<Published> {
    let metrics = messages.iter().filter_map(|message| message["metrics"].as_array()).flatten();
    let of_it = metrics.filter(|metric| metric["alias"] == *alias && metric.get("name").is_none());
    let published = of_it.map(|metric| Published {
        at: metric["timestamp"].as_u64().unwrap(),
        value: metric["value"].clone(),
        is_historical: metric["isHistorical"] == true,
    });
    published.collect()
}

/// The states of a gripper during one move. Each change is reported.
const TO_AND_FRO: [&str; 2] = ["POSITIONING", "IDLE"];

/// Returns the states during a number of moves.
fn states(moves: usize) -> Vec<&'static str> {
    TO_AND_FRO.iter().copied().cycle().take(2 * moves).collect()
}

fn move_to_and_fro(gripper: &Gripper, moves: usize) {
    let mut controller = gripper.controller();
    for number in 0..moves {
        let width = if number % 2 == 0 { 50.0 } else { 60.0 };
        assert_eq!(controller.command(move_to(width)), Status::Success);
    }
}

#[test]
fn mosquitto_outage_within_the_store_loses_no_sparkplug_payload() {
    if !is_whole() {
        return;
    }
    let (folder, gripper, way) = (Folder::new(), Gripper::start(), Way::new());
    assert_eq!(gripper.controller().command(HOME), Status::Success);
    let mut broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    way.open_to(broker.port);
    let _telemetry = Telemetry::at(&folder, way.port, &gripper.section("left"));
    let birth = host.wait_for("DBIRTH", "left");
    let state = metric(&birth, "State")["alias"].clone();
    move_to_and_fro(&gripper, 2);
    let before = host.wait("data", |messages| published(messages, &state).len() == 4);
    assert!(published(&before, &state).iter().all(|published| !published.is_historical), "{before:?}");
    let last_before = published(&before, &state).iter().map(|published| published.at).max().unwrap();

    // Kill the broker, keep moving, and let a host connect before telemetry.
    way.close();
    broker.kill();
    move_to_and_fro(&gripper, 6);
    broker.restart();
    let host = Host::watch(&broker);
    way.open_to(broker.port);

    let birth = host.wait_for("NBIRTH", "");
    assert!(metric(&birth, "bdSeq")["value"].as_u64() > Some(0), "{birth}");
    // Samples in flight when the broker was killed may be sent twice.
    let new = |messages: &[Value]| {
        let published = published(messages, &state).into_iter();
        published.filter(|published| published.at > last_before).collect::<Vec<_>>()
    };
    let after = host.wait("stored samples", |messages| new(messages).len() >= 12);
    let stored = new(&after);
    assert!(stored.iter().all(|published| published.is_historical), "{stored:?}");
    let texts: Vec<&str> = stored.iter().map(|published| published.value.as_str().unwrap()).collect();
    assert_eq!(texts, states(6));
    let births = after.iter().position(|message| is_of(message, "DBIRTH", "left"));
    let data = after.iter().position(|message| is_of(message, "DDATA", "left"));
    assert!(births < data, "{after:?}");
    host.clear();
    move_to_and_fro(&gripper, 1);
    let live = host.wait("live data", |messages| published(messages, &state).len() == 2);
    assert!(published(&live, &state).iter().all(|published| !published.is_historical), "{live:?}");
}

#[test]
fn sparkplug_payload_counts_samples_lost_to_a_mosquitto_outage() {
    if !is_whole() {
        return;
    }
    let (folder, gripper, way) = (Folder::new(), Gripper::start(), Way::new());
    assert_eq!(gripper.controller().command(HOME), Status::Success);
    let broker = Broker::start(&folder);
    let devices = format!("store = 4\n{}", gripper.section("left"));
    let telemetry = Telemetry::at(&folder, way.port, &devices);
    telemetry.wait_until_it_says("left: connected");
    move_to_and_fro(&gripper, 6);

    let host = Host::watch(&broker);
    way.open_to(broker.port);

    let birth = host.wait_for("NBIRTH", "");
    let [waiting, dropped] =
        ["Store/Waiting", "Store/Dropped"].map(|name| metric(&birth, name)["value"].as_u64().unwrap());
    assert_eq!(waiting, 4);
    // Each of the twelve state changes produced at least one sample.
    assert!(dropped >= 8, "{dropped}");
    let data = host.wait("stored samples", |messages| {
        messages.iter().filter(|message| is_of(message, "DDATA", "left")).count() == 4
    });
    let times: Vec<u64> = data
        .iter()
        .filter(|message| is_of(message, "DDATA", "left"))
        .map(|message| message["metrics"][0]["timestamp"].as_u64().unwrap())
        .collect();
    assert!(times.is_sorted(), "{times:?}");
}

#[test]
fn sparkplug_payload_will_on_mosquitto_keeps_bd_seq_after_kill() {
    if !is_whole() {
        return;
    }
    let (folder, gripper) = (Folder::new(), Gripper::start());
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    for number in 0..3 {
        let telemetry = Telemetry::at(&folder, broker.port, &gripper.section("left"));
        let birth = host.wait_for("NBIRTH", "");
        assert_eq!(metric(&birth, "bdSeq")["value"], number);
        // Dropping sends SIGKILL.
        drop(telemetry);
        let death = host.wait_for("NDEATH", "");
        assert_eq!(metric(&death, "bdSeq")["value"], number);
        host.clear();
    }
}

#[test]
fn only_rebirth_is_accepted_via_mosquitto_and_sparkplug_payload() {
    if !is_whole() {
        return;
    }
    let (folder, gripper) = (Folder::new(), Gripper::start());
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    let telemetry = Telemetry::at(&folder, broker.port, &gripper.section("left"));
    host.wait_for("DBIRTH", "left");
    let command = |name: &str| {
        encoded(&json!({
            "timestamp": 1, "metrics": [{ "name": name, "timestamp": 1, "type": "Boolean", "value": true }]
        }))
    };

    host.clear();
    broker.publish("spBv1.0/plant/NCMD/cell", &command("Node Control/Rebirth"), &[]);
    host.wait_for("DBIRTH", "left");
    let node = host.wait_for("NBIRTH", "");
    assert_eq!((&node["seq"], &metric(&node, "bdSeq")["value"]), (&json!(0), &json!(0)));

    broker.publish("spBv1.0/plant/NCMD/cell", &command("Node Control/Reboot"), &[]);
    telemetry
        .wait_until_it_says("only \"Node Control/Rebirth\" = true is accepted, not \"Node Control/Reboot\"");
    broker.publish("spBv1.0/plant/DCMD/cell/left", &command("Home"), &[]);
    telemetry.wait_until_it_says("allow_commands is not set");
    broker.publish("spBv1.0/plant/NCMD/cell", b"\xFF\xFF", &[]);
    telemetry.wait_until_it_says("not a Sparkplug B payload");
    let refused = metric(&node, "Commands/Refused")["alias"].clone();
    host.wait("the count", |messages| {
        published(messages, &refused).iter().any(|published| published.value == 3)
    });
}

#[test]
fn udp_and_serial_lines_reach_mosquitto_and_sparkplug_payload() {
    if !is_whole() {
        return;
    }
    let folder = Folder::new();
    let answers = rig::free_port();
    let udp = |serial_number| {
        let address = std::net::SocketAddr::from(([127, 0, 0, 1], rig::free_port()));
        let lines = Lines { udp: Some(UdpLine { address, remote_port: answers }), ..Lines::default() };
        let server =
            ServerThread::start(Config { serial_number, ..Config::default() }, &lines, None).unwrap();
        (format!("udp://{address}?local={answers}"), server)
    };
    let servers = [udp(1), udp(2)];
    let lines = Lines { serial: Some(SerialLine::Pty), ..Lines::default() };
    let serial = ServerThread::start(Config { serial_number: 3, ..Config::default() }, &lines, None).unwrap();
    let addresses = [
        servers[0].0.clone(),
        servers[1].0.clone(),
        format!("serial:{}", serial.serial_path().unwrap().display()),
    ];
    let devices: String = addresses
        .iter()
        .enumerate()
        .map(|(number, address)| format!("[[gripper]]\nname = \"g{}\"\naddress = {address:?}\n", number + 1))
        .collect();
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    let telemetry = Telemetry::at(&folder, broker.port, &devices);
    for number in 1..=3 {
        let birth = host.wait_for("DBIRTH", &format!("g{number}"));
        assert_eq!(metric(&birth, "Properties/Serial Number")["value"], number);
    }
    telemetry.end();
}

#[test]
fn tls_to_mosquitto_needs_the_given_ca_for_sparkplug_payload() {
    if !is_whole() {
        return;
    }
    let (folder, gripper) = (Folder::new(), Gripper::start());
    let ca_key = KeyPair::generate().unwrap();
    let mut of_ca = CertificateParams::new(Vec::new()).unwrap();
    of_ca.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    of_ca.distinguished_name.push(DnType::CommonName, "the plant's CA");
    let ca = of_ca.self_signed(&ca_key).unwrap();
    let issuer = Issuer::new(of_ca, ca_key);
    let key = KeyPair::generate().unwrap();
    let certificate =
        CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap().signed_by(&key, &issuer).unwrap();
    let ca_file = folder.write("ca.pem", &ca.pem());
    let wrong_ca = folder.write("wrong.pem", &certificate.pem());
    let [cert_file, key_file] = [("cert.pem", certificate.pem()), ("key.pem", key.serialize_pem())]
        .map(|(name, text)| folder.write(name, &text));
    let broker = Broker::with_settings(
        &folder,
        &format!(
            "allow_anonymous true\ncafile {}\ncertfile {}\nkeyfile {}\n",
            ca_file.display(),
            cert_file.display(),
            key_file.display()
        ),
    );
    let host = Host::watch_with(&broker, &["-h", "127.0.0.1", "--cafile", ca_file.to_str().unwrap()]);
    let section =
        |ca: &std::path::Path| format!("address = \"mqtts://127.0.0.1:{}\"\nca_file = {ca:?}", broker.port);

    let refusing = Telemetry::start(&folder, &section(&wrong_ca), &gripper.section("left"));
    refusing.wait_until_it_says("TLS failed: invalid peer certificate");
    refusing.end();
    let _telemetry = Telemetry::start(&folder, &section(&ca_file), &gripper.section("left"));
    host.wait_for("DBIRTH", "left");
}

#[test]
fn wrong_mosquitto_password_is_reported_for_sparkplug_payload() {
    if !is_whole() {
        return;
    }
    let (folder, gripper) = (Folder::new(), Gripper::start());
    let passwords = folder.write("passwords", "cell:right\n");
    let hashed = std::process::Command::new("mosquitto_passwd").arg("-U").arg(&passwords).status().unwrap();
    assert!(hashed.success());
    let broker = Broker::with_settings(&folder, &format!("password_file {}\n", passwords.display()));
    let user = ["-u", "cell", "-P", "right"];
    let host = Host::watch_with(&broker, &user);
    let section = format!(
        "address = \"mqtt://127.0.0.1:{}\"\nuser = \"cell\"\npassword_file = {:?}",
        broker.port,
        folder.path("password")
    );

    folder.write("password", "wrong\n");
    let refused = Telemetry::start(&folder, &section, &gripper.section("left"));
    refused.wait_until_it_says("wrong user or password");
    assert_eq!(refused.printed().matches("password").count(), 1, "{}", refused.printed());
    assert!(!refused.printed().contains("wrong\n"), "{}", refused.printed());
    refused.end();
    folder.write("password", "right\n");
    let _telemetry = Telemetry::start(&folder, &section, &gripper.section("left"));
    host.wait_for("DBIRTH", "left");
}
