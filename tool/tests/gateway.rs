//! Runs `wsg gateway` between masters of Modbus/TCP and a virtual gripper. Its promises on FAST STOP, old requests, refusals and lost
//! lines are tested with the other ways in to a gripper: `host-tests/tests/surfaces`.
#![cfg(unix)]

#[path = "common/program.rs"]
mod program;

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::thread::sleep;
use std::time::{Duration, Instant};

use host_tests::gateway::Gateway;
use program::{printed, wsg};
use rustix::process::{Pid, Signal, kill_process};
use wsg_protocol::SystemFlags;
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(60);

/// Flags of the output image, as the high byte of register 0.
const MOVE: u16 = 0x0100;
const GRIP: u16 = 0x0200;
const HOMING: u16 = 0x0800;
const JOG_MINUS: u16 = 0x8000;

/// Input registers.
const DISCONNECTS: u8 = 117;
const BUS_TIMEOUTS: u8 = 125;

/// A gateway, and its gripper with a part of 20 mm.
struct Rig {
    gripper: Option<ServerThread>,
    address: SocketAddr,
    gateway: Gateway,
}

impl Rig {
    fn start() -> Self {
        Self::with(&[])
    }

    fn with(options: &[&str]) -> Self {
        let gripper = serve("127.0.0.1:0".parse().unwrap());
        let address = gripper.tcp_address().unwrap();
        Self { gripper: Some(gripper), address, gateway: Gateway::start(address, options) }
    }

    fn gripper(&self) -> &ServerThread {
        self.gripper.as_ref().unwrap()
    }

    fn restart_gripper(&mut self) {
        self.gripper = None;
        self.gripper = Some(serve(self.address));
    }

    fn connect(&self) -> Master {
        let stream = TcpStream::connect(self.gateway.modbus).unwrap();
        stream.set_read_timeout(Some(BOUND)).unwrap();
        Master(stream)
    }

    /// Returns a master that has homed the fingers. A busy machine is less punctual than a PLC, so BUS_TIMEOUT is a minute.
    fn homed(&self) -> Master {
        let mut master = self.connect();
        until("the gripper answers", || master.inputs().is_some());
        master.set_timeout(60_000);
        assert_eq!(master.command(HOMING, 0), (1, 0), "HOMING ends in IDLE");
        master
    }

    /// Returns a master that has started a motion to 10 mm, which takes 5 s.
    fn moving(&self, timeout_ms: u16) -> Master {
        let mut master = self.homed();
        master.set_timeout(timeout_ms);
        master.write(0, 1_000);
        master.write(MOVE, 1_000);
        until("the fingers move", || self.has(SystemFlags::MOVING));
        master
    }

    fn has(&self, flags: SystemFlags) -> bool {
        self.gripper().state().flags.intersects(flags)
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.gateway.process), signal).unwrap();
    }

    /// Ends the gateway by a signal, and checks that it has stopped the fingers without a FAST STOP.
    fn end(&mut self, signal: Signal) {
        self.signal(signal);
        assert_eq!(self.gateway.process.wait().unwrap().code(), Some(0));
        until("the fingers rest", || !self.has(SystemFlags::MOVING));
        // The gripper has noticed the end of the connection.
        sleep(Duration::from_millis(100));
        assert!(!self.has(SystemFlags::FAST_STOP), "{:?}", self.gripper().state());
    }
}

fn serve(address: SocketAddr) -> ServerThread {
    let config = Config { part: Part::of_width(20.0), homing_speed: Some(400.0), ..Config::default() };
    ServerThread::start(config, &Lines { tcp: Some(address), ..Lines::default() }, None).unwrap()
}

#[track_caller]
fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < BOUND, "time-out: {what}");
        sleep(Duration::from_millis(5));
    }
}

/// Runs a test, again if the machine paused its gateway, which then disconnects from everything.
fn unpaused(test: impl Fn(&mut Rig)) {
    for attempt in 1.. {
        let mut rig = Rig::start();
        let tested = catch_unwind(AssertUnwindSafe(|| test(&mut rig)));
        let is_paused = rig.gateway.messages().contains("paused");
        match tested {
            Ok(()) => return,
            Err(_) if is_paused && attempt < 10 => {}
            Err(panic) => resume_unwind(panic),
        }
    }
}

struct Master(TcpStream);

impl Master {
    fn send(&mut self, pdu: &[u8]) -> io::Result<()> {
        self.0.write_all(&[&[0, 1, 0, 0, 0, pdu.len() as u8 + 1, 1][..], pdu].concat())
    }

    fn answer(&mut self) -> io::Result<Vec<u8>> {
        let mut head = [0; 7];
        self.0.read_exact(&mut head)?;
        let mut pdu = vec![0; usize::from(head[5]) - 1];
        self.0.read_exact(&mut pdu)?;
        Ok(pdu)
    }

    fn ask(&mut self, pdu: &[u8]) -> io::Result<Vec<u8>> {
        self.send(pdu)?;
        self.answer()
    }

    fn set_timeout(&mut self, ms: u16) {
        let [high, low] = ms.to_be_bytes();
        assert_eq!(self.ask(&[6, 0, 101, high, low]).unwrap(), [6, 0, 101, high, low]);
    }

    /// Returns the low byte of a report.
    fn report(&mut self, register: u8) -> u8 {
        self.ask(&[4, 0, register, 0, 1]).unwrap()[3]
    }

    /// Returns the registers of the input image, or `None` while the gripper does not answer.
    fn inputs(&mut self) -> Option<Vec<u16>> {
        let answer = self.ask(&[4, 0, 0, 0, 6]).unwrap();
        let (words, _) = answer.get(2..)?.as_chunks::<2>();
        (answer[0] == 4).then(|| words.iter().map(|word| u16::from_be_bytes(*word)).collect())
    }

    /// Writes flags and WIDTH in 0.01 mm, with 20 mm/s and 40 N.
    fn write(&mut self, flags: u16, width: u16) {
        assert_eq!(self.ask(&request(flags, width)).unwrap()[0], 16);
    }

    /// Issues a command as a PLC does, and returns GSTATE and status at its end.
    fn command(&mut self, flags: u16, width: u16) -> (u16, u16) {
        self.write(0, width);
        self.write(flags, width);
        loop {
            let inputs = self.inputs().expect("the gripper answers");
            if inputs[5] != 26 {
                return (inputs[0] >> 8, inputs[5]);
            }
        }
    }
}

/// Returns Write Multiple Registers 0 to 3.
fn request(flags: u16, width: u16) -> Vec<u8> {
    let image = [flags, width, 2_000, 4_000].map(u16::to_be_bytes);
    [&[16, 0, 0, 0, 4, 8][..], image.as_flattened()].concat()
}

#[test]
fn master_homes_and_grips_and_ctrl_c_leaves_no_fast_stop() {
    unpaused(|rig| {
        let mut master = rig.homed();
        assert_eq!(master.command(GRIP, 2_000), (1 << 4, 0), "GRIP ends in HOLDING");
        rig.end(Signal::INT);
    });
}

#[test]
fn sigterm_during_a_motion_stops_it_without_a_fast_stop() {
    unpaused(|rig| {
        let _master = rig.moving(60_000);
        rig.end(Signal::TERM);
        assert!(rig.gripper().state().width > 12.0, "{:?}", rig.gripper().state());
    });
}

#[test]
fn killed_gateway_leaves_a_fast_stop() {
    unpaused(|rig| {
        let _master = rig.moving(60_000);
        rig.signal(Signal::KILL);
        until("FAST STOP", || rig.has(SystemFlags::FAST_STOP) && !rig.has(SystemFlags::MOVING));
    });
}

#[test]
fn gripper_that_restarts_during_a_motion_does_not_continue_it() {
    unpaused(|rig| {
        let mut master = rig.moving(60_000);
        rig.restart_gripper();
        let width = rig.gripper().state().width;
        until("the gripper answers again", || master.report(DISCONNECTS) > 0 && master.inputs().is_some());
        // The PLC still holds MOVE.
        for _ in 0..50 {
            master.write(MOVE, 1_000);
            sleep(Duration::from_millis(10));
        }
        assert_eq!(rig.gripper().state().width, width);
    });
}

#[test]
fn silent_master_stops_the_motion_after_bus_timeout() {
    unpaused(|rig| {
        let mut master = rig.moving(1_000);
        until("the fingers rest", || !rig.has(SystemFlags::MOVING));
        let state = rig.gripper().state();
        assert!(state.width > 12.0 && !rig.has(SystemFlags::FAST_STOP), "{state:?}");
        assert_eq!(master.report(BUS_TIMEOUTS), 1);
    });
}

#[test]
fn jog_ends_with_the_connection_of_its_master() {
    unpaused(|rig| {
        let mut master = rig.homed();
        master.write(0, 0);
        master.write(JOG_MINUS, 0);
        until("the fingers move", || rig.has(SystemFlags::MOVING));
        drop(master);
        until("the fingers rest", || !rig.has(SystemFlags::MOVING));
        let state = rig.gripper().state();
        assert!(state.width > 12.0 && !rig.has(SystemFlags::FAST_STOP), "{state:?}");
    });
}

#[test]
fn command_that_waited_while_the_process_was_stopped_is_discarded() {
    let mut rig = Rig::start();
    let mut master = rig.homed();
    master.write(0, 1_000);
    rig.signal(Signal::STOP);
    sleep(Duration::from_millis(50));
    master.send(&request(MOVE, 1_000)).unwrap();
    sleep(Duration::from_millis(1_200));
    let width = rig.gripper().state().width;
    rig.signal(Signal::CONT);
    assert!(master.answer().is_err(), "the connection ends without an answer");
    until("FAST STOP", || rig.has(SystemFlags::FAST_STOP));
    let mut connected = None;
    until("the gripper answers", || {
        let mut next = rig.connect();
        let is_up = matches!(next.ask(&[4, 0, 0, 0, 6]).as_deref(), Ok([4, ..]));
        connected = is_up.then_some(next);
        is_up
    });
    // The first image.
    connected.unwrap().write(MOVE, 1_000);
    sleep(Duration::from_millis(300));
    assert_eq!(rig.gripper().state().width, width);
    let messages = rig.gateway.messages();
    assert!(messages.contains("paused for"), "{messages}");
}

/// Commands that wait on such a connection would reach the gripper minutes later.
#[test]
fn connection_that_is_not_answered_is_reset() {
    let mute = TcpListener::bind("127.0.0.1:0").unwrap();
    let _gateway = Gateway::start(mute.local_addr().unwrap(), &[]);
    for _ in 0..2 {
        let (mut stream, _) = mute.accept().unwrap();
        stream.set_read_timeout(Some(BOUND)).unwrap();
        let end = stream.read_to_end(&mut Vec::new()).unwrap_err();
        assert_eq!(end.kind(), io::ErrorKind::ConnectionReset);
    }
}

#[test]
fn gateway_serves_masters_although_nothing_reads_its_messages() {
    let mut rig = Rig::start();
    drop(rig.gateway.process.stderr.take());
    let mut master = rig.connect();
    until("the gripper answers", || master.inputs().is_some());
    // The gateway has messages for each of these.
    for _ in 0..3 {
        rig.restart_gripper();
        until("the gripper is lost", || master.inputs().is_none());
        until("the gripper answers again", || master.inputs().is_some());
    }
}

#[test]
fn wsg_bridge_stores_settings_in_the_file_of_the_gateway() {
    let file = std::env::temp_dir().join(format!("wsg-gateway-{}.flash", std::process::id()));
    let bridge = |words: &[&str]| {
        let rig = Rig::with(&["--settings", file.to_str().unwrap()]);
        let port = format!("tcp://{}", rig.gateway.modbus);
        printed(&wsg(&[&["bridge", &port], words].concat(), b""))
    };
    let set = bridge(&["set", "BUS_TIMEOUT", "2000", "--save"]);
    let shown = bridge(&["show", "BUS_TIMEOUT"]);
    let _ = std::fs::remove_file(&file);
    assert!(shown.contains("2000"), "{set}{shown}");
}

#[test]
fn wrong_or_missing_address_is_refused_with_a_hint() {
    for (arguments, status, expected) in [
        (&["gateway", "--gripper", "udp://h", "--modbus", "localhost:0"][..], 2, "expected tcp://HOST"),
        (&["gateway", "--gripper", "tcp://h"], 2, "--modbus <ADDR>"),
        (&["gateway", "--gripper", "tcp://h", "--profinet", "no-card"], 1, "no-card"),
        (&["gateway", "--gripper", "tcp://h", "--modbus", "bench:0"], 2, "expected an address with a port"),
        (&["bridge", "tcp://h:port", "show"], 1, "invalid port `port`"),
        // An IPv6 address gets the default port, too.
        (&["bridge", "tcp://::1", "show"], 1, "cannot connect to a gateway at [::1]:502"),
    ] {
        let output = wsg(arguments, b"");
        assert_eq!(output.status.code(), Some(status), "{}", printed(&output));
        assert!(printed(&output).contains(expected), "{}", printed(&output));
    }
}
