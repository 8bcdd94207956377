//! Faults of the lines and of the process of `wsg gateway`, at random moments of a grip cycle.
//!
//! Judged beside the gripper, by the commands on its line and by its fingers: each request of the PLC causes at most one motion, none
//! that waited for too long, and no motion outlives its PLC, its gateway or the connection between them. Afterwards, the gateway
//! serves again.
//!
//! `WSG_CHAOS=1500 cargo test -p host-tests --test surfaces chaos` runs more cases. Pulled cables require root: add
//! `-- --include-ignored`.

use std::net::SocketAddr;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use host_tests::chance::Chance;
use host_tests::extent;
use host_tests::gateway::Gateway;
use host_tests::modbus_tcp::Master;
use host_tests::namespaces::{End, Network};
use rustix::process::{Pid, Signal, kill_process};
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::{CommandId, Status, SystemFlags};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

use crate::station::{BOUND, Line, Station, Way, lines};

/// Cases at the same time. They wait most of the time.
const AT_ONCE: u64 = 5;

/// Motions of a grip cycle: flags, command, and width in 0.01 mm.
const CYCLE: [(CommandFlags, CommandId, i16); 3] = [
    (CommandFlags::MOVE, CommandId::PrePosition, 10_00),
    (CommandFlags::GRIP, CommandId::GripPart, 5_00),
    (CommandFlags::RELEASE, CommandId::ReleasePart, 80_00),
];

/// Speeds in 0.01 mm/s: a motion that outlasts every fault, and a cycle of about a second.
const SLOW: u16 = 20_00;
const FAST: u16 = 400_00;

/// Interval of the PLC.
const SCAN: Duration = Duration::from_millis(5);

/// Time between the zeros and the edge of a command. A fault that begins in it delays the edge.
const BEFORE_EDGE: Duration = Duration::from_millis(100);

/// Longest fault after which nothing needs to stop, shortest one after which everything must, and longest one.
const SHORT_MS: u64 = 300;
const LONG_MS: u64 = 1_500;
const LONGEST_MS: u64 = 2_200;

/// Age of a request that the gateway must discard: BUS_TIMEOUT, with a margin for the machine.
const TOO_OLD: Duration = Duration::from_millis(1_300);

/// Time in which a signal stops a process.
const SIGNALLED: Duration = Duration::from_millis(50);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Plc,
    Gripper,
}

impl Side {
    /// Returns the interface of the cable, its address at the gateway, and at the other end.
    const fn cable(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Plc => ("eth1", "192.168.8.1", "192.168.8.2"),
            Self::Gripper => ("eth2", "192.168.9.1", "192.168.9.2"),
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Fault {
    /// SIGKILL, and a new process.
    Kill,
    /// SIGSTOP, and SIGCONT after this time.
    Stop(Duration),
    /// A severed line, until the fingers rest.
    Sever(Side),
    Reset(Side),
    /// A line on which nothing passes in these directions for this time: delay, or a half-open connection.
    Hold(Side, &'static [Way], Duration),
    /// A cable without carrier for this time, because the interface of this end is down.
    Pull(Side, End, Duration),
}

impl Fault {
    fn random(chance: &mut Chance, has_cables: bool) -> Self {
        let short = chance.hits(0.5);
        let ms =
            if short { 1 + chance.below(SHORT_MS) } else { LONG_MS + chance.below(LONGEST_MS - LONG_MS) };
        let time = Duration::from_millis(ms);
        let side = if chance.hits(0.5) { Side::Plc } else { Side::Gripper };
        if has_cables {
            let end = if chance.hits(0.5) { End::Gripper } else { End::Controller };
            return Self::Pull(side, end, time);
        }
        match chance.below(9) {
            0 => Self::Kill,
            1 => Self::Stop(time),
            2 => Self::Sever(side),
            3 | 4 => Self::Reset(side),
            5 => Self::Hold(side, &[Way::Requests], time),
            6 => Self::Hold(side, &[Way::Answers], time),
            _ => Self::Hold(side, &[Way::Requests, Way::Answers], time),
        }
    }

    /// Returns whether the gripper loses its connection, which is a FAST STOP (command set, 1.4.2).
    fn ends_connection(self) -> bool {
        match self {
            Self::Kill | Self::Sever(Side::Gripper) | Self::Reset(Side::Gripper) => true,
            Self::Stop(time) | Self::Hold(Side::Gripper, _, time) | Self::Pull(Side::Gripper, _, time) => {
                time >= Duration::from_millis(LONG_MS)
            }
            _ => false,
        }
    }

    /// Returns whether the gateway loses the PLC for so long that a motion must stop.
    fn ends_bus(self) -> bool {
        match self {
            Self::Sever(Side::Plc) => true,
            Self::Hold(Side::Plc, ways, time) => {
                ways.contains(&Way::Requests) && time >= Duration::from_millis(LONG_MS)
            }
            Self::Pull(Side::Plc, _, time) => time >= Duration::from_millis(LONG_MS),
            _ => false,
        }
    }
}

/// A PLC in a grip cycle, which shares its state with the test.
struct Plc {
    /// Where it connects.
    gateway: Mutex<SocketAddr>,
    speed: u16,
    /// The last image.
    image: Mutex<OutputImage>,
    /// Edges that it has tried to write.
    edges: Mutex<Vec<(CommandFlags, Instant)>>,
    is_over: AtomicBool,
}

impl Plc {
    fn connect(&self) -> Result<Master> {
        Ok(Master::connect(*self.gateway.lock().expect("no panic"), BOUND)?)
    }

    fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    /// Requests the motions. After the last one, and after an error, repeats the last image, with its flag, on new connections.
    fn run(&self) {
        // An error is the fault.
        let _ = self.cycle();
        while !self.is_over() {
            let _ = self.connect().and_then(|mut master| self.repeat(&mut master));
            sleep(SCAN);
        }
    }

    fn cycle(&self) -> Result<()> {
        let mut master = self.connect()?;
        for (flags, _, width) in CYCLE {
            self.command(&mut master, OutputImage { flags, width, speed: self.speed, ..OutputImage::ZERO })?;
        }
        self.repeat(&mut master)
    }

    fn repeat(&self, master: &mut Master) -> Result<()> {
        while !self.is_over() {
            master.write(*self.image.lock().expect("no panic"))?;
            sleep(SCAN);
        }
        Ok(())
    }

    /// Requests a motion, and returns its status.
    fn command(&self, master: &mut Master, image: OutputImage) -> Result<Status> {
        let image = OutputImage { force_limit: 40_00, ..image };
        master.write(OutputImage { flags: CommandFlags::empty(), ..image })?;
        sleep(BEFORE_EDGE);
        *self.image.lock().expect("no panic") = image;
        self.edges.lock().expect("no panic").push((image.flags, Instant::now()));
        master.write(image)?;
        let start = Instant::now();
        loop {
            let status = master.read()?.status;
            if status != Status::CmdPending || self.is_over() {
                return Ok(status);
            }
            ensure!(start.elapsed() < BOUND, "the command does not end");
            sleep(SCAN);
        }
    }

    /// Acknowledges a FAST STOP and references the fingers.
    fn home(&self) -> Result<()> {
        let mut master = self.connect()?;
        for flags in [CommandFlags::empty(), CommandFlags::STOP_ACK, CommandFlags::empty()] {
            master.write(OutputImage { flags, ..OutputImage::ZERO })?;
            sleep(SCAN);
        }
        let status =
            self.command(&mut master, OutputImage { flags: CommandFlags::HOMING, ..OutputImage::ZERO })?;
        ensure!(status == Status::Success, "{status}");
        Ok(())
    }
}

struct Rig<'a> {
    station: Station,
    gateway: Gateway,
    /// The line between PLC and gateway.
    plc: Line,
    /// The cables, with the gateway alone at the controller's end.
    network: Option<&'a Network>,
}

impl<'a> Rig<'a> {
    fn start(network: Option<&'a Network>) -> Self {
        let config = Config { part: Part::of_width(5.0), homing_speed: Some(400.0), ..Config::default() };
        let mut lines = lines();
        if network.is_some() {
            let (_, _, address) = Side::Gripper.cable();
            lines = Lines { tcp: format!("{address}:0").parse().ok(), ..lines };
        }
        let gripper = ServerThread::start(config, &lines, None).expect("the server starts");
        let station = Station::of(gripper, None);
        let (gateway, plc) = gateway(network, station.tcp.address);
        Self { station, gateway, plc, network }
    }

    fn line(&self, side: Side) -> &Line {
        match side {
            Side::Plc => &self.plc,
            Side::Gripper => &self.station.tcp,
        }
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.gateway.process), signal).expect("the process runs");
    }

    fn rests(&self) {
        self.station.until("at rest", |state| !state.flags.contains(SystemFlags::MOVING));
    }

    fn is_stopped_fast(&self) {
        self.station.until("in FAST STOP", |state| {
            state.flags.contains(SystemFlags::FAST_STOP) && !state.flags.contains(SystemFlags::MOVING)
        });
    }

    /// Applies a fault until it has had its effect. Returns the time in which an edge of the PLC must start nothing.
    fn strike(&mut self, fault: Fault, plc: &Plc) -> Range<Instant> {
        let begun = Instant::now();
        let mut discarded = begun..begun;
        match fault {
            Fault::Kill => {
                self.signal(Signal::KILL);
                self.is_stopped_fast();
                (self.gateway, self.plc) = gateway(self.network, self.station.tcp.address);
                *plc.gateway.lock().expect("no panic") = self.plc.address;
            }
            Fault::Stop(time) => {
                self.signal(Signal::STOP);
                sleep(time);
                if fault.ends_connection() {
                    discarded = begun + SIGNALLED..Instant::now();
                }
                self.signal(Signal::CONT);
            }
            Fault::Sever(side) => {
                self.line(side).cut();
                if fault.ends_connection() {
                    self.is_stopped_fast();
                }
                self.rests();
                self.line(side).mend();
            }
            Fault::Reset(side) => self.line(side).reset(),
            Fault::Hold(side, ways, time) => {
                ways.iter().for_each(|way| self.line(side).hold(*way));
                discarded = self.wait(fault, time);
                ways.iter().for_each(|way| self.line(side).release(*way));
            }
            Fault::Pull(side, end, time) => {
                let plug = |is_plugged| {
                    self.network.expect("the rig has cables").plug(end, side.cable().0, is_plugged);
                };
                plug(false);
                discarded = self.wait(fault, time);
                plug(true);
            }
        }
        if fault.ends_connection() {
            self.is_stopped_fast();
        }
        discarded
    }

    /// Waits until a fault that holds a line has had its effect. Returns the time in which an edge of the PLC must start nothing.
    fn wait(&self, fault: Fault, time: Duration) -> Range<Instant> {
        let held = Instant::now();
        sleep(time);
        if fault.ends_bus() {
            self.rests();
            return held..Instant::now() - TOO_OLD;
        }
        held..held
    }

    /// Runs a case.
    fn case(&mut self, chance: &mut Chance) {
        let (is_slow, fault) = (chance.hits(0.3), Fault::random(chance, self.network.is_some()));
        let moment = Duration::from_millis(chance.below(1_500));
        let _case = Case(format!("{fault:?} after {moment:?}, slow: {is_slow}"));
        let plc = Plc {
            gateway: Mutex::new(self.plc.address),
            speed: if is_slow { SLOW } else { FAST },
            image: Mutex::new(OutputImage::ZERO),
            edges: Mutex::default(),
            is_over: AtomicBool::new(false),
        };
        self.serve_again(&plc);
        self.station.tcp.take_effective();
        plc.edges.lock().expect("no panic").clear();
        let target = f32::from(CYCLE[0].2) / 100.0;
        let discarded = thread::scope(|threads| {
            threads.spawn(|| plc.run());
            // Also if an assertion fails, or the scope would wait for its thread.
            let _over = Over(&plc);
            sleep(moment);
            let before = self.station.state();
            self.station.measure();
            let discarded = self.strike(fault, &plc);
            let moved_far = is_slow
                && before.flags.contains(SystemFlags::MOVING)
                && before.width > target + f32::from(SLOW) / 100.0 * 3.0;
            if fault.ends_bus() && moved_far && self.station.stall() < Duration::from_millis(500) {
                let state = self.station.state();
                assert!(state.width > target + 1.0, "the motion has continued to its end: {state:?}");
            }
            // The PLC repeats its flag.
            sleep(Duration::from_millis(chance.below(SHORT_MS)));
            discarded
        });
        self.serve_again(&plc);
        let edges = plc.edges.lock().expect("no panic").clone();
        let effective = self.station.tcp.take_effective();
        for (flags, id, _) in [&CYCLE[..], &[(CommandFlags::HOMING, CommandId::Homing, 0)]].concat() {
            let of_id = edges.iter().filter(|(edge, _)| *edge == flags);
            let requested = of_id.filter(|(_, at)| !discarded.contains(at)).count();
            let sent = effective.iter().filter(|sent| **sent == id).count();
            assert!(sent <= requested, "{id}: {sent} sent, {requested} requested, {discarded:?}: {edges:?}");
        }
    }

    /// Waits until the PLC can reference the fingers.
    fn serve_again(&self, plc: &Plc) {
        plc.is_over.store(false, Ordering::Relaxed);
        let start = Instant::now();
        while let Err(error) = plc.home() {
            assert!(start.elapsed() < BOUND, "the gateway serves again: {error}");
            sleep(SCAN);
        }
    }
}

/// Starts a gateway. Returns it, and the line of its PLC: a cable, or a line on this computer.
fn gateway(network: Option<&Network>, gripper: SocketAddr) -> (Gateway, Line) {
    let Some(network) = network else {
        let gateway = Gateway::start(gripper, &[]);
        let plc = Line::to(gateway.modbus);
        return (gateway, plc);
    };
    let ((_, address, _), gripper) = (Side::Plc.cable(), format!("tcp://{gripper}"));
    let command = Gateway::with(&["--gripper", &gripper, "--modbus", &format!("{address}:0")]);
    let gateway = network.at(End::Controller, || Gateway::spawn(command, 1));
    let plc = Line::on_ethernet(gateway.modbus, |_, _| ());
    (gateway, plc)
}

/// Ends the PLC.
struct Over<'a>(&'a Plc);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.is_over.store(true, Ordering::Relaxed);
    }
}

/// Prints its text when a case panics.
struct Case(String);

impl Drop for Case {
    fn drop(&mut self) {
        if thread::panicking() {
            eprintln!("{}", self.0);
        }
    }
}

/// Runs the cases at the end of the gripper and the PLC.
fn run(whole: usize, network: impl Fn() -> Option<Network> + Sync) {
    let cases = std::env::var("WSG_CHAOS").map_or(extent::of(whole) as u64, |cases| cases.parse().unwrap());
    let run = |first, network: Option<&Network>| {
        let mut rig = Rig::start(network);
        for number in (first..cases).step_by(AT_ONCE as usize) {
            rig.case(&mut Chance::new(number));
        }
    };
    thread::scope(|threads| {
        for first in 0..AT_ONCE {
            let (run, network) = (&run, &network);
            threads.spawn(move || match network() {
                Some(network) => network.at(End::Gripper, || run(first, Some(&network))),
                None => run(first, None),
            });
        }
    });
}

#[test]
fn chaos_around_a_gateway_starts_nothing_and_stops_every_motion() {
    run(50, || None);
}

#[test]
#[ignore = "needs root: run `cargo xtask test`"]
fn chaos_of_pulled_cables_in_namespaces_starts_nothing_and_ends_every_motion() {
    run(25, || {
        let network = Network::new();
        for side in [Side::Plc, Side::Gripper] {
            let (interface, gateway, other) = side.cable();
            network.add_cable(interface, &[(End::Controller, gateway), (End::Gripper, other)]);
        }
        Some(network)
    });
}
