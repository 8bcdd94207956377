//! Host commands by DCMD: valid ones are executed, and nothing else reaches the gripper.

use std::{
    io::Write,
    net::SocketAddr,
    sync::{Arc, Mutex},
    time::{SystemTime, UNIX_EPOCH},
};

use serde_json::{Value, json};
use wsg_sim::{
    Config, Part,
    server::{Lines, Log, ServerThread},
};

use crate::{
    is_whole, latest, published,
    rig::{Broker, Folder, Host, Telemetry, encoded, metric, wait_for},
};

/// The log of a virtual gripper.
#[derive(Clone, Default)]
struct FrameLog(Arc<Mutex<Vec<u8>>>);

impl Write for FrameLog {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl FrameLog {
    /// Returns the IDs of requests that move, stop or unlock the fingers or set the force limit, in order.
    fn commands(&self) -> Vec<String> {
        let text = String::from_utf8(self.0.lock().unwrap().clone()).unwrap();
        let requests =
            text.lines().filter_map(|line| line.split_once(" -> AA AA AA ")).map(|(_, frame)| frame);
        let commands = requests.map(|frame| frame.split(' ').next().unwrap().to_owned());
        commands.filter(|id| id.starts_with('2') || id == "32").collect()
    }

    /// Waits for the log, which is written with a delay, and asserts that exactly these requests were received.
    fn expect(&self, expected: &[&str]) {
        wait_for("the log", || (self.commands().len() >= expected.len()).then_some(()));
        assert_eq!(self.commands(), expected);
    }
}

/// Starts a gripper with a part of 20 mm. Also returns its log.
fn gripper(time_scale: f32) -> (ServerThread, SocketAddr, FrameLog) {
    let log = FrameLog::default();
    let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
    let config = Config { time_scale, part: Part::of_width(20.0), ..Config::default() };
    let server = ServerThread::start(config, &lines, Some(Log::to(log.clone()))).unwrap();
    let address = server.tcp_address().unwrap();
    (server, address, log)
}

fn now_ms() -> u64 {
    u64::try_from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_millis()).unwrap()
}

fn section(name: &str, address: SocketAddr, settings: &str) -> String {
    format!("[[gripper]]\nname = {name:?}\naddress = \"tcp://{address}\"\n{settings}\n")
}

fn command(name: &str) -> Value {
    json!({ "name": format!("Command/{name}"), "type": "Boolean", "value": true })
}

fn number(name: &str, value: f64) -> Value {
    json!({ "name": format!("Command/{name}"), "type": "Float", "value": value })
}

fn payload(at: u64, metrics: &[Value]) -> Vec<u8> {
    encoded(&json!({ "timestamp": at, "metrics": metrics }))
}

/// A host that commands the gripper "left".
struct Commander<'a> {
    broker: &'a Broker,
    host: &'a Host,
    birth: Value,
    last_at: u64,
}

impl Commander<'_> {
    fn send(&self, payload: &[u8]) {
        self.broker.publish("spBv1.0/plant/DCMD/cell/left", payload, &[]);
    }

    /// Sends a command with a new time, and returns its payload.
    fn order(&mut self, metrics: &[Value]) -> Vec<u8> {
        self.last_at = now_ms().max(self.last_at + 1);
        let payload = payload(self.last_at, metrics);
        self.send(&payload);
        payload
    }

    /// Waits for a result, then discards the messages so far.
    fn wait_for_result(&self, result: &str) {
        self.host.wait(result, |messages| {
            let published = latest(messages, &self.birth, "Command/Result");
            published.and_then(Value::as_str).is_some_and(|published| published.contains(result))
        });
        self.host.clear();
    }
}

/// Starts telemetry with one device that accepts commands, and a host that sends them.
fn commanded<'a>(
    folder: &Folder,
    broker: &'a Broker,
    host: &'a Host,
    address: SocketAddr,
) -> (Telemetry, Commander<'a>) {
    let devices = "command_age_ms = 60000\n".to_owned() + &section("left", address, "allow_commands = true");
    let telemetry = Telemetry::at(folder, broker.port, &devices);
    let birth = host.wait_for("DBIRTH", "left");
    (telemetry, Commander { broker, host, birth, last_at: 0 })
}

#[test]
fn fingers_obey_only_valid_sparkplug_payload_over_mosquitto() {
    if !is_whole() {
        return;
    }
    let folder = Folder::new();
    let ((_server, address, log), (closed, closed_address, untouched)) = (gripper(20.0), gripper(20.0));
    let broker = Broker::start(&folder);
    // A retained command with a valid timestamp.
    let kept = payload(now_ms() + 30_000, &[command("Home")]);
    broker.publish("spBv1.0/plant/DCMD/cell/left", &kept, &["-r"]);
    let host = Host::watch(&broker);
    let devices = "command_age_ms = 60000\n".to_owned()
        + &section("left", address, "allow_commands = true")
        + &section("right", closed_address, "");
    let telemetry = Telemetry::at(&folder, broker.port, &devices);
    let birth = host.wait_for("DBIRTH", "left");
    let width = metric(&birth, "Command/Width");
    assert_eq!(width["properties"]["engHigh"]["value"], 110);
    assert_eq!(metric(&birth, "Command/Home")["value"], false);
    let other = host.wait_for("DBIRTH", "right");
    assert!(
        other["metrics"]
            .as_array()
            .unwrap()
            .iter()
            .all(|metric| { !metric["name"].as_str().unwrap().starts_with("Command/") })
    );
    telemetry.wait_until_it_says("it is retained");
    let mut commander = Commander { broker: &broker, host: &host, birth, last_at: now_ms() + 30_000 };

    // The gripper is not referenced yet.
    commander.order(&[command("Grip"), number("Width", 20.0), number("Speed", 100.0)]);
    commander.wait_for_result("Grip: refused, E_NOT_INITIALIZED");
    let home = commander.order(&[command("Home")]);
    commander.wait_for_result("Home: done");
    let parameters = [number("Width", 20.0), number("Speed", 100.0), number("Force", 30.0)];
    commander.order(&[&[command("Grip")][..], &parameters].concat());
    commander.wait_for_result("Grip: held");
    commander.order(&[command("Release"), number("Width", 60.0), number("Speed", 100.0)]);
    commander.wait_for_result("Release: done");
    let done = ["25", "20", "32", "25", "26"];
    log.expect(&done);

    // None of these commands reaches the gripper.
    commander.send(&home);
    commander.wait_for_result("not later");
    commander.send(&payload(now_ms() - 61_000, &[command("Home")]));
    commander.wait_for_result("older than 60000 ms");
    commander.send(&payload(now_ms() + 120_000, &[command("Home")]));
    commander.wait_for_result("ahead");
    commander.order(&[command("Home"), command("Acknowledge")]);
    commander.wait_for_result("more than one command");
    commander.order(&[command("Move"), number("Width", 200.0), number("Speed", 100.0)]);
    commander.wait_for_result("Command/Width = 200 is outside 0 to 110");
    commander.order(&[command("Move"), number("Width", 30.0)]);
    commander.wait_for_result("requires a width and a speed");
    let to_the_other = payload(now_ms(), &[command("Home")]);
    broker.publish("spBv1.0/plant/DCMD/cell/right", &to_the_other, &[]);
    telemetry.wait_until_it_says("DCMD/cell/right refused: this device accepts no commands");

    // Later commands do, so the refused ones would have arrived by now.
    commander.order(&[command("Fast Stop")]);
    commander.wait_for_result("Fast Stop: done");
    commander.order(&[command("Home")]);
    commander.wait_for_result("Home: refused, E_ACCESS_DENIED");
    commander.order(&[command("Acknowledge")]);
    commander.wait_for_result("Acknowledge: done");
    log.expect(&[&done[..], &["23", "20", "24"]].concat());
    telemetry.end();
    closed.stop().unwrap();
    assert_eq!(untouched.commands(), [""; 0]);
}

#[test]
fn sparkplug_payload_stop_over_mosquitto_ends_a_reported_motion() {
    if !is_whole() {
        return;
    }
    let folder = Folder::new();
    let (_server, address, log) = gripper(1.0);
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    let (telemetry, mut commander) = commanded(&folder, &broker, &host, address);
    commander.order(&[command("Home")]);
    commander.wait_for_result("Home: done");

    // At the lowest speed the motion lasts long enough for a busy machine.
    commander.order(&[command("Move"), number("Width", 30.0), number("Speed", 5.0)]);
    let width = metric(&commander.birth, "Width")["alias"].clone();
    host.wait("widths during the motion", |messages| published(messages, &width).len() >= 5);
    commander.order(&[command("Home")]);
    commander.wait_for_result("the previous motion is not over");
    commander.order(&[command("Stop")]);
    host.wait("both results", |messages| {
        let text = serde_json::to_string(messages).unwrap();
        text.contains("Move: the motion was aborted") && text.contains("Stop: done")
    });

    // Motions are accepted again.
    commander.order(&[command("Home")]);
    commander.wait_for_result("Home: done");
    log.expect(&["20", "21", "22", "20"]);
    telemetry.end();
}

#[test]
fn lost_gripper_gets_no_sparkplug_payload_again_over_mosquitto() {
    if !is_whole() {
        return;
    }
    let folder = Folder::new();
    // So slow that the gripper is gone before the motion ends.
    let (server, address, log) = gripper(0.05);
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    let (telemetry, mut commander) = commanded(&folder, &broker, &host, address);
    commander.order(&[command("Home")]);
    wait_for("the motion", || (log.commands() == ["20"]).then_some(()));

    server.stop().unwrap();
    commander.wait_for_result("known");
    let lines = Lines { tcp: Some(address), ..Lines::default() };
    let again = FrameLog::default();
    let _server = wait_for("the address", || {
        ServerThread::start(Config::default(), &lines, Some(Log::to(again.clone()))).ok()
    });
    let birth = host.wait_for("DBIRTH", "left");

    let result = metric(&birth, "Command/Result")["value"].as_str().unwrap().to_owned();
    assert!(result.starts_with("Home: ") && result.ends_with("known"), "{result}");
    // Only this command reaches the restarted gripper.
    commander.order(&[command("Stop")]);
    commander.wait_for_result("Stop: done");
    again.expect(&["22"]);
    telemetry.end();
}
