//! Measures calls of the drivers over loopback TCP, compared in one run with a bare socket that exchanges the same bytes.
//!
//! The peer is `wsg-sim`, with one server per client. The clients take turns of some hundred queries, so that other load
//! affects all of them. Prints one line per figure with name and number: microseconds or, for `cpu`, percent of a core.
//!
//! `latency PATH/wsg_binary_driver.py` also measures UMI's Python driver, with `python3`. The file
//! is `umi/real_world/wsg_binary_driver.py` of the repository `real-stanford/universal_manipulation_interface`.
//!
//! The time of a stop is measured from the call to the arrival of its bytes at the other end of the socket, in a thread that
//! forwards them to the server.

use std::hint::black_box;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Child, ChildStdin, ChildStdout, Command as Process, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use wsg_protocol::driver::blocking::Gripper;
use wsg_protocol::driver::{Config, Error, Mm, MmPerS, OnBlock, StopKind, host, tokio as on_tokio};
use wsg_protocol::{AutoUpdate, Command, CommandId, FrameEncoder, HomingDirection, session};
use wsg_sim::server::{Lines, ServerThread};

/// Queries of each client per run, and per turn.
const QUERIES: usize = 10_000;
const TURN: usize = 200;
/// Unmeasured queries at the start.
const WARM_UP: usize = 500;
/// Numbers of busy loops in parallel with the clients, one run each.
const LOADS: [usize; 4] = [0, 1, 2, 4];

/// Stops of each kind.
const STOPS: usize = 100;
/// Travel for the measurement of the waiting thread's processor time, in mm at 5 mm/s.
const TRAVEL_MM: f32 = 15.0;

/// On a busy machine the server may answer later than any real gripper.
const PATIENT: Config = Config {
    session: session::Config { reply_timeout_ms: 10_000, ..Config::DEFAULT.session },
    ..Config::DEFAULT
};

fn main() {
    stops();
    if let Some(percent) = processor_time_of_a_motion() {
        println!("cpu {percent:.3}");
    }
    for load in LOADS {
        let is_over = Arc::new(AtomicBool::new(false));
        let busy: Vec<_> = (0..load).map(|_| thread::spawn(spin(&is_over))).collect();
        for (name, times) in queries() {
            let [median, p99] = [50, 99].map(|percent| percentile(&times, percent));
            println!("query-{name}-median-load-{load} {median:.2}");
            println!("query-{name}-p99-load-{load} {p99:.2}");
        }
        is_over.store(true, Ordering::Relaxed);
        busy.into_iter().for_each(|thread| thread.join().expect("the busy loop never panics"));
    }
}

fn spin(is_over: &Arc<AtomicBool>) -> impl FnOnce() + use<> {
    let is_over = Arc::clone(is_over);
    move || {
        while !black_box(&is_over).load(Ordering::Relaxed) {
            std::hint::spin_loop();
        }
    }
}

/// Returns a percentile of times in ascending order.
fn percentile(sorted: &[f64], percent: usize) -> f64 {
    sorted[(sorted.len() * percent / 100).min(sorted.len() - 1)]
}

/// A client that runs a number of queries and returns the time of each in microseconds.
type Client<'a> = Box<dyn FnMut(usize) -> Vec<f64> + 'a>;

/// Returns a client that measures each call in this process.
fn timed<'a>(mut ask: impl FnMut() + 'a) -> Client<'a> {
    Box::new(move |count| {
        let time = |_| {
            let begun = Instant::now();
            ask();
            begun.elapsed().as_secs_f64() * 1e6
        };
        (0..count).map(time).collect()
    })
}

/// UMI's driver in a separate process, which measures its own calls.
const UMI: &str = "\
import importlib.util, sys, time
path, host, port = sys.argv[1:]
spec = importlib.util.spec_from_file_location('driver', path)
driver = importlib.util.module_from_spec(spec)
spec.loader.exec_module(driver)
wsg = driver.WSGBinaryDriver(host, int(port))
wsg.start()
for line in sys.stdin:
    times = []
    for _ in range(int(line)):
        begun = time.perf_counter()
        wsg.cmd_submit(0x43, bytes(3))
        times.append((time.perf_counter() - begun) * 1e6)
    print(*times, flush=True)
wsg.disconnect()
";

struct Python {
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    child: Child,
}

impl Drop for Python {
    /// Closes the input, which ends the process.
    fn drop(&mut self) {
        self.requests = None;
        let _ = self.child.wait();
    }
}

fn umi(path: &str, address: SocketAddr) -> Client<'static> {
    let mut python = Process::new("python3");
    python.args(["-c", UMI, path, &address.ip().to_string(), &address.port().to_string()]);
    let mut child =
        python.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("python3 must be installed");
    let answers = BufReader::new(child.stdout.take().expect("a pipe"));
    let mut python = Python { requests: child.stdin.take(), answers, child };
    Box::new(move |count| {
        writeln!(python.requests.as_mut().expect("a pipe"), "{count}").expect("the driver runs");
        let mut line = String::new();
        python.answers.read_line(&mut line).expect("the driver runs");
        let times: Vec<f64> = line.split_whitespace().map(|time| time.parse().expect("a number")).collect();
        assert_eq!(times.len(), count, "the Python driver must answer every query");
        times
    })
}

/// Returns the times of all clients, in ascending order.
fn queries() -> Vec<(&'static str, Vec<f64>)> {
    let servers: Vec<ServerThread> = (0..6).map(|_| serve()).collect();
    let binary = |at: usize| servers[at].tcp_address().expect("the server has a TCP port");
    let gcl = |at: usize| servers[at].gcl_address().expect("the server has a GCL port");

    let query = Command::GetOpeningWidth { update: AutoUpdate::once() };
    let frame: Vec<u8> = FrameEncoder::new(query.id().code(), query).collect();
    let mut blocking = host::connect(binary(1)).expect("the gripper answers");
    let mut over_gcl = host::connect_gcl(gcl(3)).expect("the gripper answers");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let mut asynch = runtime.block_on(on_tokio::connect(binary(2))).expect("the gripper answers");

    let mut clients: Vec<(&str, Client<'_>)> = vec![
        ("bare", bare(binary(0), frame)),
        ("blocking", timed(|| _ = black_box(blocking.width().expect("it is answered")))),
        ("tokio", timed(|| _ = black_box(runtime.block_on(asynch.width()).expect("it is answered")))),
        ("bare-gcl", bare(gcl(4), b"POS?\n".to_vec())),
        ("gcl", timed(|| _ = black_box(over_gcl.width().expect("it is answered")))),
    ];
    if let Some(path) = std::env::args().nth(1) {
        clients.push(("umi", umi(&path, binary(5))));
    }
    let mut times = vec![Vec::new(); clients.len()];
    for (_, ask) in &mut clients {
        ask(WARM_UP);
    }
    for _ in 0..QUERIES / TURN {
        for ((_, ask), times) in clients.iter_mut().zip(&mut times) {
            times.extend(ask(TURN));
        }
    }
    times.iter_mut().for_each(|times| times.sort_by(f64::total_cmp));
    clients.iter().map(|(name, _)| *name).zip(times).collect()
}

fn serve() -> ServerThread {
    let loopback = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
    let lines = Lines { tcp: loopback, gcl: loopback, ..Lines::default() };
    ServerThread::start(wsg_sim::Config::default(), &lines, None).expect("loopback is available")
}

/// Prints the time from a FAST STOP to its arrival at the other end of the socket: by an idle driver, and by a handle while
/// the driver waits for a motion.
fn stops() {
    let (address, arrivals) = tap(serve());
    let line = host::Tcp::connect(address).expect("the tap listens");
    let mut gripper = Gripper::<_, _>::with_config(line, host::StdClock::new(), PATIENT);
    gripper.connect().expect("the gripper answers");
    let handle = gripper.stop_handle().expect("a free file descriptor");
    gripper.home(HomingDirection::Positive).expect("unblocked fingers");
    let (mut idle, mut by_handle) = (vec![], vec![]);
    for _ in 0..STOPS {
        // The driver waits for a motion and receives only its refreshes.
        let handle = handle.clone();
        let button = thread::spawn(move || {
            thread::park_timeout(PAUSE);
            let called = Instant::now();
            handle.fast_stop().expect("the line accepts a FAST STOP");
            called
        });
        let moved = gripper.move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop);
        assert!(matches!(moved, Err(Error::Stopped(StopKind::FastStop))), "{moved:?}");
        by_handle.push(micros(
            button.join().expect("the thread does not panic"),
            arrivals.recv().expect("the FAST STOP arrives"),
        ));
        gripper.acknowledge().expect("an answer");
        arrivals.try_iter().for_each(drop);

        thread::park_timeout(PAUSE);
        let called = Instant::now();
        gripper.fast_stop().expect("a confirmation");
        idle.push(micros(called, arrivals.recv().expect("the FAST STOP arrives")));
        gripper.acknowledge().expect("an answer");
        // On a busy machine, a late confirmation causes repetitions.
        arrivals.try_iter().for_each(drop);
    }
    for (name, mut times) in [("idle", idle), ("handle", by_handle)] {
        times.sort_by(f64::total_cmp);
        for (what, percent) in [("median", 50), ("p99", 99)] {
            println!("fast-stop-{name}-{what} {:.2}", percentile(&times, percent));
        }
    }
}

/// Pause between two stops, for the remaining traffic of the first.
const PAUSE: Duration = Duration::from_millis(20);

fn micros(begun: Instant, ended: Instant) -> f64 {
    ended.saturating_duration_since(begun).as_secs_f64() * 1e6
}

/// Starts a proxy to the server that reports the arrival time of each FAST STOP.
fn tap(server: ServerThread) -> (SocketAddr, Receiver<Instant>) {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("loopback is available");
    let address = listener.local_addr().expect("a bound listener");
    let (arrived, arrivals) = channel();
    thread::spawn(move || {
        let (mut near, _) = listener.accept().expect("the driver connects");
        let mut far = TcpStream::connect(server.tcp_address().expect("it is served")).expect("it listens");
        near.set_nodelay(true).and_then(|()| far.set_nodelay(true)).expect("they are sockets");
        let [mut back_from, mut back_to] =
            [&far, &near].map(|end| end.try_clone().expect("a free file descriptor"));
        thread::spawn(move || std::io::copy(&mut back_from, &mut back_to));
        let fast_stop: Vec<u8> = FrameEncoder::new(CommandId::FastStop.code(), Command::FastStop).collect();
        let mut bytes = [0; 512];
        #[expect(clippy::disallowed_methods, reason = "no signal handler is installed")]
        while let Ok(count @ 1..) = near.read(&mut bytes) {
            let now = Instant::now();
            if bytes[..count].windows(fast_stop.len()).any(|window| window == fast_stop) {
                arrived.send(now).expect("a waiting receiver");
            }
            far.write_all(&bytes[..count]).expect("the server listens");
        }
    });
    (address, arrivals)
}

/// Returns the processor time of a thread that waits for a motion, in percent of a core. Linux only.
fn processor_time_of_a_motion() -> Option<f64> {
    let server = serve();
    let mut gripper =
        host::connect(server.tcp_address().expect("the server has a TCP port")).expect("the gripper answers");
    gripper.home(HomingDirection::Positive).expect("unblocked fingers");
    let (begun, before) = (Instant::now(), processor_time()?);
    gripper.move_by(Mm(-TRAVEL_MM), MmPerS(5.0), OnBlock::Stop).expect("unblocked fingers");
    Some((processor_time()? - before).as_secs_f64() / begun.elapsed().as_secs_f64() * 100.0)
}

/// Returns the processor time of this thread.
fn processor_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split(' ').next()?.parse().ok().map(Duration::from_nanos)
}

/// Returns a client with a bare socket, which only sends the query and reads the answer.
fn bare(address: SocketAddr, query: Vec<u8>) -> Client<'static> {
    let mut socket = TcpStream::connect(address).expect("the server listens");
    socket.set_nodelay(true).expect("a TCP socket");
    let mut answer = [0; 512];
    timed(move || {
        socket.write_all(&query).expect("the socket accepts a few bytes");
        #[expect(
            clippy::disallowed_methods,
            reason = "no signal handler is installed, and a single read is measured"
        )]
        let len = socket.read(&mut answer).expect("an answer");
        assert!(len > 0, "the peer has closed");
    })
}
