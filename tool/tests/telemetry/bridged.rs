//! A bridge, read over its service port: the bridge's library behind a pseudo terminal, in the wall clock's time.

use std::{
    collections::VecDeque,
    io::{ErrorKind, Read, Write},
    os::unix::net::UnixStream,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use bus_modbus::rtu::Character;
use host_tests::{
    can_bench::Double, flash_model::FlashModel, rtu_double::RtuDouble, serial_gripper::SerialGripper,
    terminal::Terminal,
};
use wsg_bridge_fw::{
    Board, BusPort, Config, ResetCause, Station,
    can::{BusOffPolicy, CanBus},
    io::Inputs,
    plc::DpBuffers,
};
use wsg_sim::Time;

use crate::{
    is_whole, latest,
    rig::{Broker, Folder, Host, Telemetry, metric},
};

/// The service port's end of the line.
struct Line {
    stream: UnixStream,
    waiting: VecDeque<(Character, u32)>,
}

impl Line {
    /// Takes what came within a millisecond; whether anything did.
    fn read(&mut self) -> bool {
        let mut byte = [0; 1];
        match self.stream.read_exact(&mut byte) {
            Ok(()) => self.waiting.push_back((Character::Byte(byte[0]), 0)),
            Err(error) => {
                let kind = error.kind();
                assert!(matches!(kind, ErrorKind::WouldBlock | ErrorKind::TimedOut), "{error}");
                return false;
            }
        }
        true
    }
}

impl BusPort for Line {
    fn receive(&mut self) -> Option<(Character, u32)> {
        self.waiting.pop_front()
    }

    fn silence_us(&mut self) -> u32 {
        100_000
    }

    fn send(&mut self, frame: &[u8]) {
        self.stream.write_all(frame).expect("the other end is open");
    }
}

/// What fails.
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
        let (near, far) = UnixStream::pair().unwrap();
        near.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let faults = Arc::<Faults>::default();
        let seen = Arc::clone(&faults);
        let thread = thread::spawn(move || serve(Line { stream: near, waiting: VecDeque::new() }, &seen));
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

fn serve(mut line: Line, faults: &Faults) {
    let buffers: &'static DpBuffers = Box::leak(Box::default());
    let mut station = Station::new(CanBus::new(Double::default(), BusOffPolicy::DEFAULT), buffers);
    let mut flash = FlashModel::new();
    let config = station.load(&Config::DEFAULT.record(), &flash).expect("these settings are right");
    station.start(&config, Board::UNKNOWN, ResetCause::PowerOn);
    let mut gripper =
        SerialGripper::new(wsg_sim::Config { serial_number: 70_000, ..wsg_sim::Config::default() });
    let mut now_ms = 0;
    while !faults.end.load(Ordering::SeqCst) {
        // A request is there as a whole once a read brings no more.
        while line.read() {}
        if faults.bridge.load(Ordering::SeqCst) {
            line.waiting.clear();
            continue;
        }
        now_ms += 1;
        let bus = &mut RtuDouble::default();
        station.turn(now_ms, Inputs::FAST_STOP_OK, &mut gripper.line, bus, &mut line, &mut flash);
        if faults.gripper.load(Ordering::SeqCst) {
            // What the bridge sends goes nowhere.
            gripper.line.take_sent();
        } else {
            gripper.advance(Time::from_millis(now_ms.into()));
        }
    }
}

#[test]
fn bridge_and_the_gripper_behind_it_are_told_by_mosquitto_and_sparkplug_payload() {
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

    // The gripper loses its power, and comes back.
    host.clear();
    bridge.faults.gripper.store(true, Ordering::SeqCst);
    is("Gripper Link", "silent".into());
    is("State", serde_json::Value::Null);
    bridge.faults.gripper.store(false, Ordering::SeqCst);
    is("State", "IDLE".into());

    // So does the bridge.
    host.clear();
    bridge.faults.bridge.store(true, Ordering::SeqCst);
    host.wait_for("DDEATH", "press");
    telemetry.wait_until_it_says("no answer within 1500 ms");
    bridge.faults.bridge.store(false, Ordering::SeqCst);
    host.wait_for("DBIRTH", "press");
    telemetry.end();
}
