//! Load test: 500 grippers on one thread, with CPU and memory use and lost messages.

use std::{
    env, fs,
    io::{BufRead, BufReader},
    net::SocketAddr,
    process::{Command as Process, Stdio},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    runtime,
    sync::oneshot,
    task::{JoinSet, LocalSet},
};
use wsg_protocol::{
    Command, Event, FrameEncoder, FrameParser, HomingDirection, PrePositionFlags, Reply, Status,
};
use wsg_sim::{
    Config,
    server::{Lines, Server},
};

use crate::rig::{Broker, Folder, Running, Telemetry, wait_for};

const GRIPPERS: usize = 500;
const SECONDS: u64 = 60;
/// Number of threads for the virtual grippers, which need more CPU time than the program under test.
const THREADS: usize = 4;

/// Virtual grippers that move continuously, in separate threads.
struct Plant {
    addresses: Vec<SocketAddr>,
    _ends: Vec<oneshot::Sender<()>>,
}

impl Plant {
    fn start() -> Self {
        // Each gripper needs a listener and three sockets in this process.
        let limit = getrlimit(Resource::Nofile);
        setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, ..limit }).unwrap();
        let (opened, opening) = std::sync::mpsc::channel();
        let ends = (0..THREADS).map(|_| {
            let (opened, (end, ended)) = (opened.clone(), oneshot::channel());
            thread::spawn(|| serve_some(opened, ended));
            end
        });
        Self { _ends: ends.collect(), addresses: opening.iter().take(GRIPPERS).collect() }
    }
}

/// Serves a thread's share of the grippers.
fn serve_some(opened: std::sync::mpsc::Sender<SocketAddr>, ended: oneshot::Receiver<()>) {
    let runtime = runtime::Builder::new_current_thread().enable_all().build().unwrap();
    LocalSet::new().block_on(&runtime, async move {
        let mut tasks = JoinSet::new();
        for _ in 0..GRIPPERS / THREADS {
            let lines = Lines { tcp: Some(([127, 0, 0, 1], 0).into()), ..Lines::default() };
            let server = Server::bind(Config::default(), &lines, None).await.unwrap();
            let address = server.address("tcp").unwrap();
            tasks.spawn_local(async { server.run(std::future::pending()).await.unwrap() });
            tasks.spawn_local(travel(address));
            opened.send(address).unwrap();
        }
        let _ = ended.await;
    });
}

/// Keeps the fingers of a gripper moving slowly, so that each update has a new width.
async fn travel(address: SocketAddr) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let mut parser = FrameParser::<64>::new();
    let ends = [10.0, 100.0].map(|width| Command::PrePosition {
        flags: PrePositionFlags::STOP_ON_BLOCK,
        width,
        speed: 5.0,
    });
    let home = Command::Homing { direction: HomingDirection::Positive };
    for command in std::iter::once(home).chain(ends.iter().copied().cycle()) {
        let bytes: Vec<u8> = FrameEncoder::new(command.id().code(), command).collect();
        stream.write_all(&bytes).await.unwrap();
        let mut is_over = false;
        while !is_over {
            if let Some(Event::Frame(frame)) = parser.push(stream.read_u8().await.unwrap()) {
                is_over = Reply::decode(&frame).unwrap().status() != Status::CmdPending;
            }
        }
    }
}

/// Message counts at a host.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    births: u64,
    data: u64,
    historical_or_odd: u64,
    /// Number of gaps in the sequence numbers.
    gaps: u64,
    last: Option<u8>,
}

impl Seen {
    fn take(&mut self, line: &str) {
        let (topic, payload) = line.split_once(' ').unwrap();
        if !topic.starts_with("spBv1.0/") || topic.contains("/NDEATH/") {
            return;
        }
        self.births += u64::from(topic.contains("/DBIRTH/"));
        self.data += u64::from(topic.contains("/DDATA/"));
        let number = sequence_of(payload);
        let expected =
            if topic.contains("/NBIRTH/") { Some(0) } else { self.last.map(|last| last.wrapping_add(1)) };
        self.gaps += u64::from(number != expected);
        self.historical_or_odd += u64::from(number.is_none());
        self.last = number;
    }
}

/// Parses the sequence number, the last field of a payload (field 3, a varint).
fn sequence_of(hex: &str) -> Option<u8> {
    let byte = |from_end: usize| {
        let at = hex.len().checked_sub(2 * from_end)?;
        u8::from_str_radix(hex.get(at..at + 2)?, 16).ok()
    };
    match (byte(3)?, byte(2)?, byte(1)?) {
        (_, 0x18, number @ 0..0x80) => Some(number),
        (0x18, low @ 0x80.., 1) => Some(low),
        _ => None,
    }
}

/// Returns the CPU time of a process and its peak memory in KiB.
fn cost(id: u32) -> (Duration, u64) {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    // utime and stime in ticks of 10 ms (proc(5)). The first field here is its third.
    let ticks: u64 = [11, 12].iter().map(|at| fields[*at].parse::<u64>().unwrap()).sum();
    let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap();
    let memory = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    (Duration::from_millis(10 * ticks), memory.trim().trim_end_matches(" kB").parse().unwrap())
}

/// Prints the figures with `WSG_LOAD=1 cargo test --release -p wsg-tool --test telemetry five_hundred -- --nocapture`, as
/// `cargo xtask ci` does. Do not run it in parallel with other tests: the virtual grippers need more than a core.
#[test]
fn five_hundred_grippers_fit_a_core_losing_nothing_on_mosquitto() {
    if env::var_os("WSG_LOAD").is_none() {
        return;
    }
    let folder = Folder::new();
    let broker = Broker::start(&folder);
    let mut client = Process::new("mosquitto_sub");
    client.args(["-p", &broker.port.to_string(), "-F", "%t %x", "-t", "spBv1.0/#", "-t", "ready"]);
    broker.publish("ready", b"yes", &["-r"]);
    let mut client = Running(client.stdout(Stdio::piped()).spawn().unwrap());
    let lines = BufReader::new(client.0.stdout.take().unwrap()).lines();
    let (is_subscribed, subscribed) = std::sync::mpsc::channel();
    let seen = Arc::new(Mutex::new(Seen::default()));
    let counted = Arc::clone(&seen);
    thread::spawn(move || {
        for line in lines {
            let line = line.unwrap();
            if line.starts_with("ready") {
                is_subscribed.send(()).unwrap();
            }
            counted.lock().unwrap().take(&line);
        }
    });
    subscribed.recv_timeout(Duration::from_secs(60)).unwrap();
    let plant = Plant::start();
    let devices: String = plant
        .addresses
        .iter()
        .enumerate()
        .map(|(number, address)| {
            format!("[[gripper]]\nname = \"g{number}\"\naddress = \"tcp://{address}\"\n")
        })
        .collect();

    let telemetry = Telemetry::at(&folder, broker.port, &devices);
    wait_for("all births", || (seen.lock().unwrap().births >= GRIPPERS as u64).then_some(()));
    let (before, (cpu_before, _), start) = (*seen.lock().unwrap(), cost(telemetry.id()), Instant::now());
    wait_for("the time", || (start.elapsed() >= Duration::from_secs(SECONDS)).then_some(()));
    let (after, (cpu, memory), elapsed) = (*seen.lock().unwrap(), cost(telemetry.id()), start.elapsed());

    let rate = (after.data - before.data) as f64 / elapsed.as_secs_f64();
    let load = (cpu - cpu_before).as_secs_f64() / elapsed.as_secs_f64();
    println!(
        "{GRIPPERS} grippers for {:.1} s: {rate:.0} messages/s ({:.2}/s each), {:.1} % of a core, {:.1} MiB, {} gaps; virtual grippers stopped responding {} times",
        elapsed.as_secs_f64(),
        rate / GRIPPERS as f64,
        100.0 * load,
        memory as f64 / 1024.0,
        after.gaps,
        telemetry.printed().matches("no longer responds").count()
    );
    assert_eq!((after.gaps, after.historical_or_odd), (0, 0));
    assert!(load < 1.0, "{load}");
    assert!(memory < 128 * 1024, "{memory} KiB");
    // The limit allows for virtual grippers that are slow on a busy machine.
    assert!(rate > 5.0 * GRIPPERS as f64, "{rate}");
    telemetry.end();
}
