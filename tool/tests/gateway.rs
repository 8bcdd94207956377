//! Runs `wsg gateway` between masters of Modbus/TCP and a virtual gripper. Its promises on FAST STOP, old requests, refusals and lost
//! lines are tested with the other ways in to a gripper: `host-tests/tests/surfaces`.
#![cfg(unix)]

#[path = "gateway/page.rs"]
mod page;
#[path = "common/program.rs"]
mod program;

use std::env::temp_dir;
use std::fs;
use std::io::{self, Read};
use std::mem;
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::panic::panic_any;
use std::path::PathBuf;
use std::process::id;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use document::read;
#[cfg(target_os = "linux")]
use host_tests::ethernetip;
use host_tests::gateway::{self, Gateway, Moved};
use host_tests::modbus_tcp;
use host_tests::socket::free_port;
use host_tests::terminal::Terminal;
use program::{printed, wsg};
use rustix::fs::{CWD, Mode, mkfifoat};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use serial2::SerialPort;
use wsg_bridge_fw::registers::{COMMAND_KEY, FIRST_COMMAND};
use wsg_protocol::SystemFlags;
use wsg_protocol::can::Identifiers;
use wsg_sim::server::{CanBus, CanLine, Lines, SerialLine, ServerThread, UdpLine};
use wsg_sim::{Config, Part};

/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(60);

/// Flags of the output image, as the high byte of register 0.
const MOVE: u16 = 0x0100;
const GRIP: u16 = 0x0200;
const RELEASE: u16 = 0x0400;
const HOMING: u16 = 0x0800;
const STOP_ACK: u16 = 0x1000;
const FAST_STOP: u16 = 0x2000;
const JOG_MINUS: u16 = 0x8000;

/// Input registers.
const DISCONNECTS: u8 = 117;
const BUS_TIMEOUTS: u8 = 125;
const SAVE_STATE: u8 = 204;

/// Status in input register 5 until a command has ended, and of a motion that a gripper which is not homed has refused.
const CMD_PENDING: u16 = 26;
const NOT_INITIALIZED: u16 = 3;

/// Message about a silent gripper.
const SILENT: &str = "the gripper does not answer";

/// Message about a gripper that is sent a FAST STOP at the end, because it answers late.
const UNSTOPPED: &str = "did not confirm within 500 ms that its fingers stopped: FAST STOP";

/// A gateway, and its grippers with parts of 20 mm. Most tests have one.
struct Rig {
    grippers: Vec<ServerThread>,
    /// Address of the first gripper on TCP.
    address: SocketAddr,
    gateway: Gateway,
    /// How often the line between both was cut or mended. Locked while the line carries bytes.
    cuts: Arc<Mutex<usize>>,
    _folder: Option<Folder>,
}

impl Rig {
    fn start() -> Self {
        Self::with(&[])
    }

    fn with(options: &[&str]) -> Self {
        // Connections of other programs take no ports of this address while the gripper restarts.
        let own = if cfg!(target_os = "linux") { "127.0.0.9:0" } else { "127.0.0.1:0" };
        let gripper = serve(own.parse().unwrap());
        let address = gripper.tcp_address().unwrap();
        Self::of(vec![gripper], address, Gateway::start(address, options), None)
    }

    fn of(
        grippers: Vec<ServerThread>,
        address: SocketAddr,
        gateway: Gateway,
        folder: Option<Folder>,
    ) -> Self {
        Self { grippers, address, gateway, cuts: Arc::default(), _folder: folder }
    }

    /// Starts a gateway with a page, and with two grippers on one port, units 1 and 2.
    fn of_two() -> Self {
        let grippers = [(); 2].map(|()| serve("127.0.0.1:0".parse().unwrap()));
        let address = |gripper: &ServerThread| gripper.tcp_address().unwrap();
        let [left, right] = [address(&grippers[0]), address(&grippers[1])];
        let folder = Folder::with(&format!(
            "page = \"127.0.0.1:0\"\n\
             [[gripper]]\ngripper = \"tcp://{left}\"\nmodbus = \"127.0.0.1:0\"\nunit = 1\n\
             [[gripper]]\nname = \"right\"\ngripper = \"tcp://{right}\"\nmodbus = \"127.0.0.1:0\"\nunit = 2\n\
             [gripper.delivered]\nBUS_TIMEOUT = 2500\n"
        ));
        Self::of(grippers.into(), left, folder.serve(2), Some(folder))
    }

    fn gripper(&self) -> &ServerThread {
        &self.grippers[0]
    }

    /// Cuts or mends the line. None of its bytes moves later.
    fn cut_or_mend(&self) {
        *self.cuts.lock().unwrap() += 1;
    }

    fn restart_gripper(&mut self) {
        self.grippers.clear();
        self.grippers.push(serve(self.address));
    }

    fn connect(&self) -> Master {
        Master::connect(self.gateway.modbus)
    }

    /// Returns a master that has homed the fingers.
    fn homed(&self) -> Master {
        let mut master = self.connect();
        master.home();
        master
    }

    /// Returns a master that has started a motion to 10 mm, which takes 5 s.
    fn moving(&self) -> Master {
        self.moving_with(60_000)
    }

    /// Does so with a BUS_TIMEOUT, which no motion allows to change.
    fn moving_with(&self, timeout_ms: u16) -> Master {
        let mut master = self.homed();
        master.set_timeout(timeout_ms);
        master.start(MOVE);
        until("the fingers move", || self.has(SystemFlags::MOVING));
        master
    }

    fn has(&self, flags: SystemFlags) -> bool {
        has(self.gripper(), flags)
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.gateway.process), signal).unwrap();
    }

    /// Returns exit status and output of `wsg gateway status`, once it is as expected.
    fn status(&self, options: &[&str], is_so: impl Fn(i32, &str) -> bool) -> String {
        let address = self.gateway.modbus.to_string();
        let mut found = String::new();
        until("the status is as expected", || {
            let output = wsg(&[&["gateway", "status", &address], options].concat(), b"");
            found = printed(&output);
            is_so(output.status.code().unwrap(), &found)
        });
        found
    }

    /// Returns the gateway's reports on itself.
    fn reports(&self) -> Value {
        let status = self.status(&["--json"], |code, _| code < 2);
        serde_json::from_str::<Value>(&status).unwrap()["reports"].take()
    }

    /// Ends the gateway by a signal, and checks that it has stopped all fingers without a FAST STOP.
    fn end(&mut self, signal: Signal) {
        self.signal(signal);
        assert_eq!(self.gateway.process.wait().unwrap().code(), Some(0));
        for gripper in &self.grippers {
            until("the fingers rest", || !has(gripper, SystemFlags::MOVING));
        }
        // The gripper has noticed the end of the connection.
        sleep(Duration::from_millis(100));
        for gripper in &self.grippers {
            assert!(!has(gripper, SystemFlags::FAST_STOP), "{:?}", gripper.state());
        }
    }
}

fn has(gripper: &ServerThread, flags: SystemFlags) -> bool {
    gripper.state().flags.intersects(flags)
}

fn serve(address: SocketAddr) -> ServerThread {
    serve_on(&Lines { tcp: Some(address), ..Lines::default() })
}

fn serve_on(lines: &Lines) -> ServerThread {
    let config = Config { part: Part::of_width(20.0), homing_speed: Some(400.0), ..Config::default() };
    ServerThread::start(config, lines, None).unwrap()
}

#[track_caller]
fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < BOUND, "time-out: {what}");
        sleep(Duration::from_millis(5));
    }
}

/// Runs a test like [`unpaused_on`], with a gripper on TCP.
fn unpaused(test: impl Fn(&mut Rig)) {
    unpaused_on(Rig::start, test);
}

/// Runs a test, again if the machine paused its gateway or gripper, which then disconnects. Returns the messages of the gateway.
fn unpaused_on(start: impl Fn() -> Rig, test: impl Fn(&mut Rig)) -> String {
    let is_disturbed = |rig: &Rig, messages: &str| {
        let silences = rig.cuts.lock().unwrap().div_ceil(2);
        messages.matches(SILENT).count() > silences || messages.contains(UNSTOPPED)
    };
    gateway::unpaused(start, |rig| &mut rig.gateway, is_disturbed, test)
}

/// A folder with a configuration file, removed in the end. `FOLDER` in the text is its path.
struct Folder(PathBuf);

impl Folder {
    fn with(config: &str) -> Self {
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        let number = NEXT.fetch_add(1, Relaxed);
        let folder = Self(temp_dir().join(format!("wsg-gateway-{}-{number}", id())));
        fs::create_dir(&folder.0).unwrap();
        fs::write(folder.config(), config.replace("FOLDER", folder.0.to_str().unwrap())).unwrap();
        folder
    }

    fn config(&self) -> String {
        self.0.join("gateway.toml").to_str().unwrap().to_owned()
    }

    fn serve(&self, grippers: usize) -> Gateway {
        Gateway::spawn(Gateway::with(&["--config", &self.config()]), grippers)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

struct Master {
    line: modbus_tcp::Master,
}

impl Master {
    fn connect(address: SocketAddr) -> Self {
        let line = modbus_tcp::Master::connect(address, BOUND).unwrap();
        let mut master = Self { line };
        master.line.unit = 1;
        master
    }

    fn ask(&mut self, pdu: &[u8]) -> io::Result<Vec<u8>> {
        self.line.ask(pdu)
    }

    fn set_timeout(&mut self, ms: u16) {
        let [high, low] = ms.to_be_bytes();
        assert_eq!(self.ask(&[6, 0, 101, high, low]).unwrap(), [6, 0, 101, high, low]);
    }

    /// Homes the fingers. A busy machine is less punctual than a PLC, so BUS_TIMEOUT is a minute.
    fn home(&mut self) {
        until("the gripper answers", || self.inputs().is_some());
        self.set_timeout(60_000);
        assert_eq!(self.command(HOMING, 0), (1, 0), "HOMING ends in IDLE");
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

    /// Starts a motion to 10 mm, or a jog.
    fn start(&mut self, flags: u16) {
        self.write(0, 1_000);
        self.write(flags, 1_000);
    }

    /// Issues a command as a PLC does, and returns GSTATE and status at its end.
    fn command(&mut self, flags: u16, width: u16) -> (u16, u16) {
        self.write(0, width);
        self.write(flags, width);
        let mut inputs = None;
        // As a PLC, with pauses: they leave the processor to the other tests.
        until("the command ends", || {
            let read = self.inputs().expect("the gripper answers");
            inputs = (read[5] != CMD_PENDING).then_some((read[0] >> 8, read[5]));
            inputs.is_some()
        });
        inputs.unwrap()
    }
}

/// Checks that no command has moved the fingers.
fn rests_at(rig: &Rig, width: f32) {
    let state = rig.gripper().state();
    if state.width != width {
        panic_any(Moved(format!("{state:?} after {width} mm")));
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
#[cfg(target_os = "linux")]
fn owner_of_an_ethernetip_adapter_homes_grips_and_stops_the_fingers_by_idle_and_silence() {
    let address = ethernetip::own_address();
    unpaused_on(
        || Rig::with(&["--ethernetip", &address.to_string()]),
        |rig| {
            let mut master = rig.connect();
            until("the gripper answers", || master.inputs().is_some());
            // A busy machine is less punctual than a PLC.
            master.set_timeout(60_000);
            ethernetip::judge(address, &|| rig.gripper().state());
            assert_eq!(rig.reports()["PLC_ADDRESS"], Value::Null, "the PLC has left");
        },
    );
}

#[test]
fn sigterm_during_a_motion_stops_it_without_a_fast_stop() {
    unpaused(|rig| {
        let _master = rig.moving();
        rig.end(Signal::TERM);
        assert!(rig.gripper().state().width > 12.0, "{:?}", rig.gripper().state());
    });
}

#[test]
fn sigterm_during_a_motion_on_a_cut_line_says_that_the_fingers_did_not_stop() {
    let messages = unpaused_on(
        || rig_on(Link::Udp),
        |rig| {
            let _master = rig.moving();
            rig.cut_or_mend();
            rig.signal(Signal::TERM);
            assert_eq!(rig.gateway.process.wait().unwrap().code(), Some(0));
        },
    );
    assert!(messages.contains(UNSTOPPED), "{messages}");
}

#[test]
fn killed_gateway_leaves_a_fast_stop() {
    unpaused(|rig| {
        let _master = rig.moving();
        rig.signal(Signal::KILL);
        until("FAST STOP", || rig.has(SystemFlags::FAST_STOP) && !rig.has(SystemFlags::MOVING));
    });
}

#[test]
fn gripper_that_restarts_during_a_motion_does_not_continue_it() {
    unpaused(|rig| {
        let mut master = rig.moving();
        rig.restart_gripper();
        let width = rig.gripper().state().width;
        until("the gripper answers again", || master.report(DISCONNECTS) > 0 && master.inputs().is_some());
        // The PLC still holds MOVE.
        for _ in 0..50 {
            master.write(MOVE, 1_000);
            assert_ne!(master.inputs().map(|inputs| inputs[5]), Some(NOT_INITIALIZED), "MOVE was sent again");
            sleep(Duration::from_millis(10));
        }
        rests_at(rig, width);
    });
}

#[test]
fn silent_master_stops_the_motion_after_bus_timeout() {
    unpaused(|rig| {
        let mut master = rig.moving_with(2_000);
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
        master.start(JOG_MINUS);
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
    master.line.request(&request(MOVE, 1_000)).unwrap();
    sleep(Duration::from_millis(1_200));
    let width = rig.gripper().state().width;
    rig.signal(Signal::CONT);
    assert!(master.line.response().is_err(), "the connection ends without an answer");
    until("FAST STOP", || rig.has(SystemFlags::FAST_STOP));
    let mut connected = None;
    until("the gripper answers", || {
        let mut next = rig.connect();
        let is_up = matches!(next.ask(&[4, 0, 0, 0, 6]).as_deref(), Ok([4, ..]));
        connected = is_up.then_some(next);
        is_up
    });
    let reports = rig.reports();
    assert!(
        reports["PAUSES"].as_u64() > Some(0) && reports["LONGEST_PAUSE"].as_u64() > Some(1_200),
        "{reports}"
    );
    assert_eq!((&reports["PLC_ADDRESS"], &reports["CYCLE_TIME"]), (&Value::Null, &0.into()));
    // The first image has MOVE, and so have all others.
    let mut master = connected.unwrap();
    master.write(MOVE, 1_000);
    until("the stop is acknowledged", || {
        master.write(MOVE | STOP_ACK, 1_000);
        master.write(MOVE, 1_000);
        !rig.has(SystemFlags::FAST_STOP)
    });
    sleep(Duration::from_millis(300));
    rests_at(&rig, width);
    let messages = rig.gateway.messages();
    assert!(messages.contains("paused for"), "{messages}");
}

#[test]
fn two_grippers_share_a_port_by_unit_and_a_signal_stops_both() {
    let messages = unpaused_on(Rig::of_two, |rig| {
        let port = rig.gateway.modbus;
        assert_eq!(rig.gateway.ports, [port, port]);
        for (unit, timeout) in [("", "1000 ms"), ("?unit=2", "2500 ms")] {
            let shown =
                printed(&wsg(&["bridge", &format!("tcp://{port}{unit}"), "show", "BUS_TIMEOUT"], b""));
            assert!(shown.contains(timeout), "{shown}");
        }
        let mut master = rig.homed();
        for unit in [0, 3, 255] {
            master.line.unit = unit;
            assert_eq!(master.ask(&request(HOMING, 0)).unwrap(), [0x90, 0x0A], "unit {unit}");
        }
        assert!(rig.has(SystemFlags::REFERENCED) && !has(&rig.grippers[1], SystemFlags::REFERENCED));
        master.line.unit = 2;
        master.home();
        master.start(JOG_MINUS);
        master.line.unit = 1;
        master.start(MOVE);
        let are_moving = |rig: &Rig| rig.grippers.iter().all(|gripper| has(gripper, SystemFlags::MOVING));
        until("both move", || are_moving(rig));
        drop(master);
        until("the jog ends", || !has(&rig.grippers[1], SystemFlags::MOVING));
        assert!(rig.has(SystemFlags::MOVING), "{:?}", rig.gripper().state());
        let mut master = rig.connect();
        master.line.unit = 2;
        // A command before the answer to the Stop would be refused.
        until("the end of the jog is confirmed", || {
            master.inputs().is_some_and(|inputs| inputs[5] != CMD_PENDING)
        });
        master.start(MOVE);
        until("both move", || are_moving(rig));
        rig.end(Signal::TERM);
    });
    assert!(messages.contains("wsg: right: connected") && messages.contains("wsg: tcp://127"), "{messages}");
}

#[test]
fn mute_gripper_and_stalled_disk_do_not_hold_another_gripper() {
    let mute = TcpListener::bind("127.0.0.1:0").unwrap();
    let start = || {
        let gripper = serve("127.0.0.1:0".parse().unwrap());
        let address = gripper.tcp_address().unwrap();
        let folder = Folder::with(&format!(
            "[[gripper]]\ngripper = \"tcp://{}\"\nmodbus = \"127.0.0.1:0\"\nsettings = \"FOLDER/mute\"\n\
             [[gripper]]\ngripper = \"tcp://{address}\"\nmodbus = \"127.0.0.1:0\"\n",
            mute.local_addr().unwrap()
        ));
        // Without a reader, the pipe cannot be opened.
        mkfifoat(CWD, folder.0.join("mute.new"), Mode::RUSR | Mode::WUSR).unwrap();
        Rig::of(vec![gripper], address, folder.serve(2), Some(folder))
    };
    unpaused_on(start, |rig| {
        let mut stalled = Master::connect(rig.gateway.ports[0]);
        let ([high, low], [key_high, key_low]) = (FIRST_COMMAND.to_be_bytes(), COMMAND_KEY.to_be_bytes());
        let save = [6, high, low, key_high, key_low];
        assert_eq!(stalled.ask(&save).unwrap(), save);
        // More turns than the save takes.
        for _ in 0..300 {
            assert_eq!(stalled.report(SAVE_STATE), 1);
        }
        let mut master = Master::connect(rig.gateway.ports[1]);
        master.home();
        assert_eq!(stalled.inputs(), None);
        rig.end(Signal::TERM);
    });
}

#[test]
fn delivered_settings_apply_until_others_are_saved_and_defaults_returns_to_them() {
    let gripper = TcpListener::bind("127.0.0.1:0").unwrap();
    let folder = Folder::with(&format!(
        "[[gripper]]\ngripper = \"tcp://{}\"\nmodbus = \"127.0.0.1:0\"\nsettings = \"FOLDER/flash\"\n\
         delivered.BUS_TIMEOUT = \"2500 ms\"\n",
        gripper.local_addr().unwrap()
    ));
    for (words, expected, is_saved) in [
        (&["show", "BUS_TIMEOUT"][..], "2500", false),
        (&["set", "BUS_TIMEOUT", "3000", "--save"], "stored", false),
        (&["show", "BUS_TIMEOUT"], "3000", true),
        (&["defaults", "--yes"], "(3000 -> 2500)", true),
        (&["show", "BUS_TIMEOUT"], "2500", false),
    ] {
        let flash = folder.0.join("flash");
        let stored = fs::read(&flash).ok();
        let start = || {
            // As before a disturbed attempt.
            let _ =
                stored.as_ref().map_or_else(|| fs::remove_file(&flash), |stored| fs::write(&flash, stored));
            folder.serve(1)
        };
        let messages = gateway::unpaused(
            start,
            |gateway| gateway,
            |_, _| false,
            |gateway| {
                let output = wsg(&[&["bridge", &format!("tcp://{}", gateway.modbus)], words].concat(), b"");
                assert!(printed(&output).contains(expected), "{}", printed(&output));
            },
        );
        let precedence =
            "flash was saved by a master and takes precedence; DEFAULTS returns to the configuration";
        assert_eq!(messages.contains(precedence), is_saved, "{words:?}: {messages}");
    }
}

#[test]
fn check_config_prints_the_grippers_of_the_page_and_refuses_mistakes() {
    let page = read("docs/gateway.md");
    let (_, example) = page.split_once("```toml\n").unwrap();
    let (example, _) = example.split_once("```").unwrap();
    for (from, to, status, expected) in [
        (
            "",
            "",
            0,
            "gripper  tcp://192.168.1.20:1000 (left)\nmodbus   192.168.1.10:502, unit 1\n\
             gripper  tcp://192.168.1.21:1000 (right)\nmodbus   192.168.1.10:502, unit 2\n",
        ),
        ("unit = 2", "unit = 1", 2, ": another gripper has the unit 1 on 192.168.1.10:502\n"),
        (
            "left.flash",
            "missing/left.flash",
            2,
            "cannot create missing/left.flash: there is no such folder\n",
        ),
        (
            "left.flash",
            "FOLDER/gateway.toml",
            2,
            "gateway.toml is no file with settings of a bridge; expected",
        ),
    ] {
        let folder = Folder::with(&example.replace(from, to));
        let output = wsg(&["gateway", "--config", &folder.config(), "--check-config"], b"");
        assert_eq!(output.status.code(), Some(status), "{}", printed(&output));
        assert!(printed(&output).contains(expected), "{}", printed(&output));
        assert_eq!(output.stdout.is_empty(), status != 0, "{}", printed(&output));
    }
}

/// The package installs it. Until it is edited, the service does not start.
#[test]
fn configuration_of_the_service_is_refused_until_its_lines_are_enabled() {
    let shipped = read("tool/service/gateway.toml").replace("/var/lib/wsg", "FOLDER");
    let enabled: String = shipped
        .lines()
        .map(|line| {
            line.strip_prefix('#').filter(|rest| !rest.starts_with(' ')).unwrap_or(line).to_owned() + "\n"
        })
        .collect();
    for (config, status, expected) in [
        (&shipped, 2, "no gripper"),
        (&enabled, 0, "gripper  tcp://192.168.1.20:1000 (cell-1)\nmodbus   192."),
    ] {
        let folder = Folder::with(config);
        let output = wsg(&["gateway", "--config", &folder.config(), "--check-config"], b"");
        assert_eq!(output.status.code(), Some(status), "{}", printed(&output));
        assert!(printed(&output).contains(expected), "{}", printed(&output));
    }
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

/// A line without a connection.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Link {
    Udp,
    Serial,
    Slcan,
}

/// The test's ends of such a line. A thread passes on what they receive, unless the line is cut.
struct Cable {
    /// The gateway's address of the gripper.
    address: String,
    to_gateway: OwnedFd,
    to_gripper: OwnedFd,
    /// The terminal that the gateway opens.
    _terminal: Option<Terminal>,
}

impl Link {
    /// Returns a gripper with this line, and the other end of the line.
    fn open(self) -> (ServerThread, Cable) {
        let [gateway, gripper] = [0; 2].map(|_| UdpSocket::bind("127.0.0.1:0").unwrap());
        let address = |socket: &UdpSocket| socket.local_addr().unwrap();
        let udp = UdpLine { address: "127.0.0.1:0".parse().unwrap(), remote_port: address(&gripper).port() };
        let can = CanLine { bus: CanBus::Slcan(SerialLine::Pty), identifiers: Identifiers::DEFAULT };
        let server = serve_on(&Lines {
            udp: (self == Self::Udp).then_some(udp),
            serial: (self == Self::Serial).then_some(SerialLine::Pty),
            can: (self == Self::Slcan).then_some(can),
            ..Lines::default()
        });
        let Some(path) = server.serial_path().or(server.can_path()) else {
            let answer = free_port();
            gateway.connect(("127.0.0.1", answer)).unwrap();
            gripper.connect(server.udp_address().unwrap()).unwrap();
            let port = address(&gateway).port();
            let [to_gateway, to_gripper] = [gateway, gripper].map(|socket| {
                socket.set_nonblocking(true).unwrap();
                OwnedFd::from(socket)
            });
            let address = format!("udp://127.0.0.1:{port}?answer={answer}");
            return (server, Cable { address, to_gateway, to_gripper, _terminal: None });
        };
        let (to_gateway, line) = UnixStream::pair().unwrap();
        to_gateway.set_nonblocking(true).unwrap();
        let terminal = Terminal::to(line).unwrap();
        let to_gripper = SerialPort::open(path, 115_200).unwrap().into();
        let address = format!("{}:{}", if self == Self::Serial { "serial" } else { "slcan" }, terminal.path);
        (server, Cable { address, to_gateway: to_gateway.into(), to_gripper, _terminal: Some(terminal) })
    }
}

impl Cable {
    /// Passes on what both ends receive until the test ends.
    fn pass(&self, cuts: &Arc<Mutex<usize>>) {
        let mut seen = 0;
        while Arc::strong_count(cuts) > 1 {
            let cuts = cuts.lock().unwrap();
            let is_cut = !cuts.is_multiple_of(2);
            if mem::replace(&mut seen, *cuts) < *cuts && is_cut {
                // An adapter that loses power restarts with a closed channel. On other lines, this is noise.
                rustix::io::write(&self.to_gripper, b"\rC\r").unwrap();
            }
            for (from, to) in [(&self.to_gateway, &self.to_gripper), (&self.to_gripper, &self.to_gateway)] {
                let mut bytes = [0; 4_096];
                while let Ok(count @ 1..) = rustix::io::read(from, &mut bytes) {
                    if !is_cut {
                        // An error means that nothing listens.
                        let _ = rustix::io::write(to, &bytes[..count]);
                    }
                }
            }
            drop(cuts);
            sleep(Duration::from_millis(1));
        }
    }
}

/// Starts a gateway with a gripper on such a line.
fn rig_on(link: Link) -> Rig {
    let ((gripper, cable), cuts) = (link.open(), Arc::<Mutex<usize>>::default());
    let (address, seen) = (cable.address.clone(), Arc::clone(&cuts));
    thread::spawn(move || cable.pass(&seen));
    let gateway = Gateway::to(&address, &[]);
    if link != Link::Udp {
        until("a second program is refused", || {
            let second = printed(&wsg(&["gripper", &address, "width"], b""));
            second.contains("another program uses this port")
        });
    }
    Rig { cuts, ..Rig::of(vec![gripper], "127.0.0.1:0".parse().unwrap(), gateway, None) }
}

/// During a pause of the computer, the session makes no attempts that it could count.
#[test]
fn values_of_a_silent_gripper_are_shown_for_a_second_even_beside_a_pause() {
    unpaused_on(
        || rig_on(Link::Udp),
        |rig| {
            let mut master = rig.connect();
            for pause_ms in [0, 650] {
                until("the gripper answers", || master.inputs().is_some());
                rig.cut_or_mend();
                let cut_at = Instant::now();
                if pause_ms > 0 {
                    rig.signal(Signal::STOP);
                    sleep(Duration::from_millis(pause_ms));
                    rig.signal(Signal::CONT);
                }
                until("the gripper is lost", || {
                    let age = cut_at.elapsed();
                    let is_lost = master.inputs().is_none();
                    assert!(is_lost || age <= Duration::from_secs(1), "{pause_ms} ms: shown after {age:?}");
                    is_lost
                });
                rig.cut_or_mend();
            }
        },
    );
}

#[test]
fn gripper_on_any_line_grips_and_moves_neither_late_nor_after_the_end() {
    thread::scope(|scope| {
        for link in [Link::Udp, Link::Serial, Link::Slcan] {
            scope.spawn(move || grips_and_moves_neither_late_nor_after_the_end(link));
        }
    });
}

fn grips_and_moves_neither_late_nor_after_the_end(link: Link) {
    let messages = unpaused_on(
        || rig_on(link),
        |rig| {
            rig.gripper().set_part(Part::of_width(100.0));
            let mut master = rig.homed();
            assert_eq!(master.command(GRIP, 10_000), (1 << 4, 0), "{link:?}: GRIP ends in HOLDING");
            assert_eq!(master.command(RELEASE, 11_000), (1, 0), "{link:?}: RELEASE ends in IDLE");
            rig.gripper().set_part(None);
            master.write(0, 8_000);
            master.write(MOVE, 8_000);
            until("the fingers move", || rig.has(SystemFlags::MOVING));
            rig.cut_or_mend();
            until("the gripper is lost", || master.ask(&[4, 0, 0, 0, 6]).unwrap() == [0x84, 0x0B]);
            // The gripper has not noticed it.
            until("the motion has ended", || !rig.has(SystemFlags::MOVING));
            let width = rig.gripper().state().width;
            assert!((width - 80.0).abs() < 0.1 && !rig.has(SystemFlags::FAST_STOP), "{link:?}: {width} mm");
            for flags in [0, MOVE] {
                // The bridge may refuse them.
                let _ = master.ask(&request(flags, 4_000)).unwrap();
            }
            rig.cut_or_mend();
            until("the gripper answers again", || master.inputs().is_some());
            for _ in 0..50 {
                let _ = master.ask(&request(MOVE, 4_000)).unwrap();
                sleep(Duration::from_millis(10));
            }
            rests_at(rig, width);
            master.command(STOP_ACK, 0);
            master.write(0, 1_000);
            master.write(GRIP, 1_000);
            until("the fingers move", || rig.has(SystemFlags::MOVING));
            rig.end(Signal::HUP);
            assert!(rig.gripper().state().width > 12.0, "{link:?}: {:?}", rig.gripper().state());
        },
    );
    assert!(messages.contains("does not notice the end of this line"), "{link:?}: {messages}");
}

#[test]
fn gateway_serves_masters_although_nothing_reads_its_messages() {
    let mut rig = Rig::start();
    drop(rig.gateway.process.stderr.take());
    // A new master for each request: a pause of the gateway ends its connections.
    let answer = |rig: &Rig| rig.connect().ask(&[4, 0, 0, 0, 6]).map_or(0, |answer| answer[0]);
    until("the gripper answers", || answer(&rig) == 4);
    // The gateway has messages for each of these.
    for _ in 0..3 {
        rig.grippers.clear();
        until("the gripper is lost", || answer(&rig) == 0x84);
        rig.grippers.push(serve(rig.address));
        until("the gripper answers again", || answer(&rig) == 4);
    }
}

#[test]
fn wsg_bridge_stores_settings_in_the_file_of_the_gateway() {
    let file = std::env::temp_dir().join(format!("wsg-gateway-{}.flash", std::process::id()));
    for words in [&["set", "BUS_TIMEOUT", "2000", "--save"][..], &["show", "BUS_TIMEOUT"]] {
        unpaused_on(
            || Rig::with(&["--settings", file.to_str().unwrap()]),
            |rig| {
                let port = format!("tcp://{}", rig.gateway.modbus);
                let output = wsg(&[&["bridge", &port], words].concat(), b"");
                let shown = printed(&output);
                assert!(output.status.success() && shown.contains("2000"), "{shown}");
            },
        );
    }
    let _ = std::fs::remove_file(&file);
}

#[test]
fn status_names_the_plc_and_why_a_gateway_is_not_healthy() {
    unpaused(|rig| {
        let mut master = rig.homed();
        let text = rig.status(&[], |code, _| code == 0);
        let address = rig.gateway.modbus;
        assert!(
            text.starts_with(&format!("gateway    {address} is healthy\nbridge     firmware ")),
            "{text}"
        );
        assert!(text.contains("\nPLC        127.0.0.1, cycle "), "{text}");
        // The master, and the program. The connection of the previous status may still be open.
        until("two masters are connected", || rig.reports()["MASTERS"] == 2);
        let reports = rig.reports();
        let of = |name: &str| reports[name].as_u64().unwrap();
        assert!(of("CYCLE_TIME") > 0 && of("MASTER_CONNECTIONS") > 3, "{reports}");
        assert_eq!((of("GRIPPER_CONNECTIONS"), of("PAUSES")), (1, 0));
        // GRIPPER_CONNECTIONS. LONGEST_PAUSE is the last register.
        assert_eq!(master.ask(&[4, 3, 0xF8, 0, 1]).unwrap(), [4, 2, 0, 1]);
        assert_eq!(master.ask(&[4, 3, 0xFA, 0, 2]).unwrap(), [0x84, 2]);

        master.write(FAST_STOP, 0);
        rig.status(&[], |code, text| code == 1 && text.contains(" is not healthy: FAST_STOP_FLAG: "));
        rig.grippers.clear();
        rig.status(&[], |code, text| code == 1 && text.contains(" is not healthy: no gripper: lost\n"));
    });
}

#[test]
fn gateway_that_does_not_answer_delays_the_status_of_no_other() {
    let rig = Rig::start();
    let mute = TcpListener::bind("127.0.0.1:0").unwrap();
    let mute = mute.local_addr().unwrap().to_string();
    let bound = "no answer within 2 s";
    rig.status(&[&mute], |code, text| code == 6 && text.contains(" is healthy\n") && text.contains(bound));
}

#[test]
fn wrong_or_missing_address_is_refused_with_a_hint() {
    for (arguments, status, expected) in [
        (&["gateway", "--gripper", "gcl://h", "--modbus", "localhost:0"][..], 2, "not GCL; expected tcp://"),
        (&["gateway", "--gripper", "serial:x?rate=9600"], 2, "requires 115200 bit/s"),
        (&["gateway", "--gripper", "slcan:x?kbit=100"], 2, "requires 125 kbit/s"),
        (&["gripper", "socketcan:no-can", "width"], 6, "the CAN interface no-can cannot be opened: "),
        (&["gateway", "--gripper", "tcp://h"], 2, "--modbus <ADDR>"),
        (&["gateway", "--modbus", "localhost:0"], 2, "--gripper <ADDRESS>|--config <FILE>"),
        (&["gateway", "--config", "x", "--settings", "y"], 2, "cannot be used with '--settings <FILE>'"),
        (
            &["gateway", "--gripper", "tcp://h", "--modbus", "localhost:0", "--check-config"],
            2,
            "cannot be used with",
        ),
        (&["gateway", "--config", "missing.toml"], 2, "cannot read missing.toml"),
        (&["gateway", "--config", "x", "--page", "localhost:0"], 2, "cannot be used with '--page <ADDR>'"),
        (&["gateway", "--gripper", "tcp://h", "--profinet", "no-card"], 1, "no-card"),
        (&["gateway", "--gripper", "tcp://h", "--modbus", "bench:0"], 2, "expected an address with a port"),
        (&["gateway", "--gripper", "tcp://h", "status", "h"], 2, "cannot be used with"),
        (&["gateway", "status"], 2, "<ADDR>"),
        (&["gateway", "status", "h:port"], 2, "invalid port `port`"),
        (
            &["gateway", "status", "h?unit=x"],
            2,
            "wrong address `h?unit=x`; expected tcp://HOST[:502][?unit=1]",
        ),
        (&["gateway", "status", "127.0.0.1:1"], 6, "wsg: 127.0.0.1:1: cannot connect to a gateway"),
        (&["bridge", "tcp://h:port", "show"], 1, "invalid port `port`"),
        (&["bridge", "tcp://h?unit=300", "show"], 1, "expected tcp://HOST[:502][?unit=1]"),
        // An IPv6 address gets the default port, too.
        (&["bridge", "tcp://::1", "show"], 1, "cannot connect to a gateway at [::1]:502"),
    ] {
        let output = wsg(arguments, b"");
        assert_eq!(output.status.code(), Some(status), "{}", printed(&output));
        assert!(printed(&output).contains(expected), "{}", printed(&output));
    }
}

/// As a service of systemd.
#[cfg(target_os = "linux")]
mod service {
    use std::env::temp_dir;
    use std::fs::{self, File};
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::fs::MetadataExt;
    use std::os::unix::net::{SocketAddr, UnixDatagram};
    use std::process::{Command, id};

    use super::*;

    /// Starts a gateway as systemd does, with a watchdog that is to be fed at every half of this time.
    fn as_service(socket: &str, watchdog_us: u32) -> (Gateway, UnixDatagram) {
        let address = match socket.strip_prefix('@') {
            Some(name) => SocketAddr::from_abstract_name(name),
            None => SocketAddr::from_pathname(socket),
        };
        let manager = UnixDatagram::bind_addr(&address.unwrap()).unwrap();
        // Nothing answers there: a bridge without a gripper is alive, too.
        let mut command = Gateway::command("tcp://127.0.0.1:1", &[]);
        command.env("NOTIFY_SOCKET", socket).env("WATCHDOG_USEC", watchdog_us.to_string());
        (Gateway::spawn(command, 1), manager)
    }

    #[test]
    fn service_manager_is_notified_of_readiness_life_and_end() {
        let path = temp_dir().join(format!("wsg-notify-{}", id()));
        let (mut gateway, manager) = as_service(path.to_str().unwrap(), 400_000);
        manager.set_read_timeout(Some(BOUND)).unwrap();
        let received = || {
            let mut state = [0; 256];
            let len = manager.recv(&mut state).unwrap();
            String::from_utf8_lossy(&state[..len]).into_owned()
        };
        // The port is open: the system has chosen its number.
        let status = format!("gripper tcp://127.0.0.1:1 modbus {}", gateway.modbus);
        assert_eq!(received(), format!("READY=1\nSTATUS={status}"));
        for _ in 0..3 {
            assert_eq!(received(), "WATCHDOG=1");
        }
        kill_process(Pid::from_child(&gateway.process), Signal::TERM).unwrap();
        until("the end is announced", || received() == "STOPPING=1");
        assert_eq!(gateway.process.wait().unwrap().code(), Some(0));
        let _ = fs::remove_file(path);
    }

    #[test]
    fn gateway_serves_masters_although_the_service_manager_reads_nothing() {
        let (gateway, manager) = as_service(&format!("@wsg-unread-{}", id()), 1_000);
        let filler = UnixDatagram::unbound().unwrap();
        filler.set_nonblocking(true).unwrap();
        filler.connect_addr(&manager.local_addr().unwrap()).unwrap();
        until("the socket is full", || filler.send(b"X=1").is_err());
        // Meanwhile, the watchdog is due several times.
        for _ in 0..20 {
            until("a master is answered", || Master::connect(gateway.modbus).ask(&[4, 0, 101, 0, 1]).is_ok());
            sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn messages_begin_with_their_severity_in_the_journal_only() {
        let path = temp_dir().join(format!("wsg-journal-{}", id()));
        for is_journal in [true, false] {
            let journal = File::create(&path).unwrap();
            let file = journal.metadata().unwrap();
            let stream = format!("{}:{}", file.dev(), file.ino() + u64::from(!is_journal));
            let to_journal = |command: &mut Command| {
                command.env("JOURNAL_STREAM", &stream).stderr(journal.try_clone().unwrap());
            };
            let logged = |severity: &str, message: &str| {
                let line = format!("{}wsg: {message}", if is_journal { severity } else { "" });
                until(&line, || fs::read_to_string(&path).unwrap().lines().any(|it| it.starts_with(&line)));
            };
            let gripper = serve("127.0.0.1:0".parse().unwrap());
            let mut first = Gateway::command(&format!("tcp://{}", gripper.tcp_address().unwrap()), &[]);
            to_journal(&mut first);
            let first = Gateway::spawn(first, 1);
            logged("<6>", "connected to the gripper");
            drop(gripper);
            logged("<4>", "no connection to the gripper");
            let mut second = Command::new(env!("CARGO_BIN_EXE_wsg"));
            second.args(["gateway", "--gripper", "tcp://h", "--modbus", &first.modbus.to_string()]);
            to_journal(&mut second);
            assert_eq!(second.status().unwrap().code(), Some(1));
            logged("<3>", "Modbus/TCP cannot listen");
        }
        let _ = fs::remove_file(&path);
    }
}
