//! Reads a bridge over its service port, and a gateway. The bridge's library runs on a pseudo terminal in real time.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
};

use host_tests::gateway::{Gateway, unpaused};
use host_tests::terminal::Terminal;
use host_tests::world::{World, service_line::ServiceLine};
use wsg_bridge_fw::{Config, io::Inputs};
use wsg_sim::server::{Lines, ServerThread};

use crate::{
    is_whole, latest,
    rig::{Broker, Folder, Host, Telemetry, metric},
};

#[derive(Default)]
struct Faults {
    /// The gripper has no power.
    gripper: AtomicBool,
    /// The bridge has no power.
    bridge: AtomicBool,
    end: AtomicBool,
}

/// A bridge with a gripper, in a thread.
struct Bridged {
    terminal: Terminal,
    faults: Arc<Faults>,
    thread: Option<JoinHandle<()>>,
}

impl Bridged {
    fn start() -> Self {
        let (line, far) = ServiceLine::new();
        let faults = Arc::<Faults>::default();
        let seen = Arc::clone(&faults);
        let thread = thread::spawn(move || serve(line, &seen));
        Self { terminal: Terminal::to(far).unwrap(), faults, thread: Some(thread) }
    }
}

impl Drop for Bridged {
    fn drop(&mut self) {
        self.faults.end.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn serve(mut line: ServiceLine, faults: &Faults) {
    let gripper = wsg_sim::Config { serial_number: 70_000, ..wsg_sim::Config::default() };
    let mut world = World::new(Config::DEFAULT, gripper);
    world.set(Inputs::FAST_STOP_OK, true);
    while !faults.end.load(Ordering::SeqCst) {
        line.read();
        if faults.bridge.load(Ordering::SeqCst) {
            line.clear();
        } else if faults.gripper.load(Ordering::SeqCst) {
            world.turn_alone(&mut line);
            // Discard what the bridge sends.
            world.far.line.take_sent();
        } else {
            world.turn(&mut line);
        }
    }
}

#[test]
fn bridge_and_gripper_report_to_mosquitto_and_sparkplug_payload() {
    if !is_whole() {
        return;
    }
    let (folder, bridge) = (Folder::new(), Bridged::start());
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    let device = format!("[[bridge]]\nname = \"press\"\ndevice = {:?}\n", bridge.terminal.path);
    let telemetry = Telemetry::at(&folder, broker.port, &device);

    let birth = host.wait_for("DBIRTH", "press");
    assert_eq!(metric(&birth, "Width")["properties"]["engUnit"]["value"], "mm");
    let is = |name: &'static str, value: serde_json::Value| {
        let birth = birth.clone();
        host.wait(name, move |messages| latest(messages, &birth, name) == Some(&value));
    };
    is("Gripper Link", "answers".into());
    is("Properties/Serial Number", 70_000.into());
    is("State", "IDLE".into());
    is("Referenced", false.into());

    // The gripper loses power and restarts.
    host.clear();
    bridge.faults.gripper.store(true, Ordering::SeqCst);
    is("Gripper Link", "silent".into());
    is("State", serde_json::Value::Null);
    bridge.faults.gripper.store(false, Ordering::SeqCst);
    is("State", "IDLE".into());

    // The bridge loses power and restarts.
    host.clear();
    bridge.faults.bridge.store(true, Ordering::SeqCst);
    host.wait_for("DDEATH", "press");
    telemetry.wait_until_it_says("no response within 1500 ms");
    bridge.faults.bridge.store(false, Ordering::SeqCst);
    host.wait_for("DBIRTH", "press");
    telemetry.end();
}

#[test]
fn gateway_and_its_reports_reach_mosquitto_and_sparkplug_payload() {
    if !is_whole() {
        return;
    }
    let start = || {
        let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
        let gripper = ServerThread::start(wsg_sim::Config::default(), &lines, None).unwrap();
        let gateway = Gateway::start(gripper.tcp_address().unwrap(), &[]);
        (gripper, gateway)
    };
    unpaused(start, |(_, gateway)| gateway, |_, _| false, |(_, gateway)| reaches_mosquitto(gateway));
}

fn reaches_mosquitto(gateway: &mut Gateway) {
    let folder = Folder::new();
    let broker = Broker::start(&folder);
    let host = Host::watch(&broker);
    let device = format!("[[bridge]]\nname = \"press\"\ndevice = \"tcp://{}?unit=7\"\n", gateway.modbus);
    let telemetry = Telemetry::at(&folder, broker.port, &device);

    let birth = host.wait_for("DBIRTH", "press");
    let is = |name: &'static str, value: serde_json::Value| {
        let birth = birth.clone();
        host.wait(name, move |messages| latest(messages, &birth, name) == Some(&value));
    };
    is("Gripper Link", "answers".into());
    is("State", "IDLE".into());
    is("Gateway/Masters", 1.into());
    is("Gateway/Gripper Connections", 1.into());
    is("Gateway/PLC Address", serde_json::Value::Null);
    assert_eq!(metric(&birth, "Gateway/Cycle Time")["properties"]["engUnit"]["value"], "µs");
    gateway.process.kill().unwrap();
    host.wait_for("DDEATH", "press");
    telemetry.wait_until_it_says("cannot connect to a gateway");
    telemetry.end();
}
