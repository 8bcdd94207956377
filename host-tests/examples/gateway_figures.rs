//! Measures `wsg gateway` over loopback TCP. Prints one line per figure with name and number, in microseconds, percent of a core, or
//! bytes. Linux only.
//!
//! ```sh
//! cargo build --release -p wsg-tool && cargo run --release -p host-tests --example gateway_figures
//! ```
//!
//! The time of a command runs from the write of its registers to the arrival of its frame at the gripper's end of the socket, in a
//! thread that forwards the bytes to a virtual gripper. Each command alternates with the same write through a process that only copies
//! bytes, so other load affects both.

use std::io::Write;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use host_tests::example::Process;
use host_tests::gateway::Gateway;
use host_tests::modbus_tcp::Master;
use wsg_fieldbus::{CommandFlags, InputImage, OutputImage};
use wsg_protocol::{CommandId, Status, SystemFlags, frame::PREAMBLE_BYTE};
use wsg_sim::Config;
use wsg_sim::server::{Lines, ServerThread};

/// Writes of each kind.
const WRITES: usize = 2_000;
/// Pause before each write: a PLC does not write continuously, so the gateway has to wake up.
const PAUSE: Duration = Duration::from_millis(2);
/// Maximum number of writes that the machine disturbed: it paused the gateway, which then disconnects from everything.
const DISTURBED: usize = 100;
/// Grippers of the idle gateway.
const GRIPPERS: usize = 10;
/// Duration of the measurement of an idle gateway, and time before it.
const IDLE: Duration = Duration::from_secs(20);
const CALM: Duration = Duration::from_secs(2);
/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(30);
/// Unit of processor times in `/proc` (proc(5)).
const TICK_S: f64 = 0.01;

fn main() -> Result<()> {
    if let Some(server) = std::env::args().nth(1) {
        return copy(server.parse()?);
    }
    commands()?;
    idle()
}

/// Measures the writes that cause a motion and a FAST STOP.
fn commands() -> Result<()> {
    let gripper = serve()?;
    let (address, arrivals) = tap(gripper.tcp_address().context("it has a port")?)?;
    let gateway = Gateway::start(address, &[]);
    let mut copier = Copier::start()?;
    let mut plc = Plc::homed(gateway.modbus)?;
    let mut disturbed = 0;
    for (name, flags, id) in [
        ("move", CommandFlags::MOVE, CommandId::PrePosition),
        ("fast-stop", CommandFlags::FASTSTOP, CommandId::FastStop),
    ] {
        let (mut times, mut copied) = (Vec::new(), Vec::new());
        while times.len() < WRITES {
            copied.push(copier.time()?);
            match plc.time(flags, id, &arrivals) {
                Ok(time) => times.push(time),
                Err(error) => {
                    disturbed += 1;
                    ensure!(disturbed <= DISTURBED, "{error}");
                    plc = Plc::homed(gateway.modbus)?;
                }
            }
        }
        for (path, mut times) in [("gateway", times), ("copied", copied)] {
            times.sort();
            for (statistic, percent) in [("median", 50), ("p99", 99)] {
                let time = times[times.len() * percent / 100];
                println!("{path}-{name}-{statistic} {:.1}", time.as_secs_f64() * 1e6);
            }
        }
    }
    Ok(())
}

/// Measures a gateway whose masters have left.
fn idle() -> Result<()> {
    let grippers = (0..GRIPPERS).map(|_| serve()).collect::<Result<Vec<_>>>()?;
    let mut text = String::new();
    for gripper in &grippers {
        let address = gripper.tcp_address().context("it has a port")?;
        text += &format!("[[gripper]]\ngripper = \"tcp://{address}\"\nmodbus = \"127.0.0.1:0\"\n");
    }
    let gateway = Gateway::of_config(&text, GRIPPERS);
    for port in &gateway.ports {
        until("the gripper answers", || Ok(Master::connect(*port, BOUND)?.read().is_ok()))?;
    }
    thread::sleep(CALM);
    let process = format!("/proc/{}", gateway.process.id());
    let (before, begun) = (processor_s(&process)?, Instant::now());
    thread::sleep(IDLE);
    let share = (processor_s(&process)? - before) / begun.elapsed().as_secs_f64();
    println!("idle-cpu {:.2}", 100.0 * share);
    let status = std::fs::read_to_string(process + "/status")?;
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("proc(5)")?;
    println!("idle-memory {}", 1024 * resident.trim().trim_end_matches(" kB").parse::<u64>()?);
    Ok(())
}

/// Returns the processor time of a process in seconds.
fn processor_s(process: &str) -> Result<f64> {
    let stat = std::fs::read_to_string(format!("{process}/stat"))?;
    // Fields 14 and 15; the second field, in parentheses, may contain spaces.
    let fields = stat.rsplit_once(')').context("proc(5)")?.1.split_whitespace().skip(11).take(2);
    Ok(TICK_S * fields.map(str::parse::<f64>).sum::<Result<f64, _>>()?)
}

fn serve() -> Result<ServerThread> {
    let lines = Lines { tcp: Some(SocketAddr::from(([127, 0, 0, 1], 0))), ..Lines::default() };
    ServerThread::start(Config { time_scale: 10.0, ..Config::default() }, &lines, None)
}

fn until(what: &str, mut holds: impl FnMut() -> Result<bool>) -> Result<()> {
    let start = Instant::now();
    while !holds()? {
        ensure!(start.elapsed() < BOUND, "time-out: {what}");
        thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}

/// Starts a listener that forwards connections to a gripper. Returns its address, and the arrivals of motions and FAST STOPs.
fn tap(gripper: SocketAddr) -> Result<(SocketAddr, Receiver<(CommandId, Instant)>)> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?;
    let (arrived, arrivals) = channel();
    thread::spawn(move || -> Result<()> {
        for client in listener.incoming() {
            let (mut client, mut gripper) = (client?, TcpStream::connect(gripper)?);
            gripper.set_nodelay(true)?;
            client.set_nodelay(true)?;
            let (mut from, mut to) = (gripper.try_clone()?, client.try_clone()?);
            thread::spawn(move || std::io::copy(&mut from, &mut to));
            let mut bytes = [0; 512];
            while let Ok(count @ 1..) = uninterrupted::read(&mut client, &mut bytes) {
                let now = Instant::now();
                for id in [CommandId::PrePosition, CommandId::FastStop] {
                    let head = [PREAMBLE_BYTE, PREAMBLE_BYTE, PREAMBLE_BYTE, id.code()];
                    if bytes[..count].windows(head.len()).any(|window| window == head) {
                        arrived.send((id, now))?;
                    }
                }
                gripper.write_all(&bytes[..count])?;
            }
        }
        Ok(())
    });
    Ok((address, arrivals))
}

/// A master of the gateway.
struct Plc {
    master: Master,
    image: OutputImage,
}

impl Plc {
    /// Connects a master that has acknowledged a FAST STOP and referenced the fingers.
    fn homed(gateway: SocketAddr) -> Result<Self> {
        let mut homed = None;
        until("the fingers are referenced", || {
            let image = OutputImage { width: 50_00, speed: 100_00, force_limit: 40_00, ..OutputImage::ZERO };
            let mut plc = Self { master: Master::connect(gateway, BOUND)?, image };
            // The gripper may not be connected, or still in FAST STOP.
            let status = plc.acknowledge().and_then(|()| plc.command(CommandFlags::HOMING));
            homed = matches!(status, Ok(Status::Success)).then_some(plc);
            Ok(homed.is_some())
        })?;
        homed.context("the loop has ended")
    }

    fn write(&mut self, flags: CommandFlags) -> Result<()> {
        self.master.write(OutputImage { flags, ..self.image })
    }

    /// Acknowledges until the gripper has left FAST STOP: the confirmation of the stop may be under way.
    fn acknowledge(&mut self) -> Result<()> {
        until("FAST STOP is acknowledged", || {
            for flags in [CommandFlags::empty(), CommandFlags::STOP_ACK] {
                self.write(flags)?;
                thread::sleep(PAUSE);
            }
            Ok(!self.master.read()?.system.contains(SystemFlags::FAST_STOP))
        })?;
        self.write(CommandFlags::empty())
    }

    /// Requests a motion, and returns its status.
    fn command(&mut self, flags: CommandFlags) -> Result<Status> {
        self.write(CommandFlags::empty())?;
        self.write(flags)?;
        Ok(self.inputs(|inputs| inputs.status != Status::CmdPending)?.status)
    }

    /// Returns the first inputs that satisfy `wanted`.
    fn inputs(&mut self, wanted: impl Fn(&InputImage) -> bool) -> Result<InputImage> {
        let mut inputs = self.master.read()?;
        until("the inputs change", || {
            inputs = self.master.read()?;
            Ok(wanted(&inputs))
        })?;
        Ok(inputs)
    }

    /// Returns the time from the write of a flag to the arrival of its command.
    fn time(
        &mut self,
        flags: CommandFlags,
        id: CommandId,
        arrivals: &Receiver<(CommandId, Instant)>,
    ) -> Result<Duration> {
        // Another width for each motion.
        self.image.width = 100_00 - self.image.width + 10;
        self.write(CommandFlags::empty())?;
        thread::sleep(PAUSE);
        arrivals.try_iter().for_each(drop);
        let written = Instant::now();
        self.master.send(OutputImage { flags, ..self.image })?;
        let (arrived, at) = arrivals.recv_timeout(BOUND)?;
        ensure!(arrived == id, "{arrived} arrived");
        self.master.answer()?;
        if id == CommandId::FastStop {
            self.inputs(|inputs| inputs.system.contains(SystemFlags::FAST_STOP))?;
            self.acknowledge()?;
        } else {
            let status = self.inputs(|inputs| inputs.status != Status::CmdPending)?.status;
            ensure!(status == Status::Success, "{status}");
        }
        Ok(at - written)
    }
}

/// A process that copies the bytes of a connection, and both of its ends.
struct Copier {
    _process: Process,
    master: Master,
    arrivals: Receiver<Instant>,
}

impl Copier {
    fn start() -> Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let mut copier = Command::new(std::env::current_exe()?);
        copier.arg(listener.local_addr()?.to_string()).stdout(Stdio::piped());
        let mut process = Process(copier.spawn()?);
        let mut address = String::new();
        let stdout = process.0.stdout.take().context("stdout is piped")?;
        std::io::BufRead::read_line(&mut std::io::BufReader::new(stdout), &mut address)?;
        let master = Master::connect(address.trim().parse()?, BOUND)?;
        let (mut server, _) = listener.accept()?;
        let (arrived, arrivals) = channel();
        thread::spawn(move || {
            let mut bytes = [0; 512];
            while let Ok(1..) = uninterrupted::read(&mut server, &mut bytes) {
                if arrived.send(Instant::now()).is_err() {
                    return;
                }
            }
        });
        Ok(Self { _process: process, master, arrivals })
    }

    /// Returns the time from a write to its arrival.
    fn time(&mut self) -> Result<Duration> {
        thread::sleep(PAUSE);
        let written = Instant::now();
        self.master.send(OutputImage::ZERO)?;
        Ok(self.arrivals.recv_timeout(BOUND)? - written)
    }
}

/// Copies the bytes of one client to a server, in the process of a [`Copier`].
fn copy(server: SocketAddr) -> Result<()> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    println!("{}", listener.local_addr()?);
    let (mut client, _) = listener.accept()?;
    let mut server = TcpStream::connect(server)?;
    server.set_nodelay(true)?;
    let mut bytes = [0; 512];
    while let count @ 1.. = uninterrupted::read(&mut client, &mut bytes)? {
        server.write_all(&bytes[..count])?;
    }
    Ok(())
}
