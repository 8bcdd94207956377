//! How long a call of a driver takes over loopback TCP, beside a bare socket that exchanges the same bytes in the same run.
//!
//! The peer is `wsg-sim`, a server for each client. The clients take turns, some hundred queries at a time, so that other work
//! of the machine hits all of them. Prints a line for each figure, a name and a number: microseconds, or for `cpu` percent of
//! a core.
//!
//! With UMI's Python driver, `latency PATH/wsg_binary_driver.py` measures that one in the same turns; it needs `python3`. The file
//! is `umi/real_world/wsg_binary_driver.py` of the repository `real-stanford/universal_manipulation_interface`.
//!
//! Stops are timed from the call until the bytes have arrived at the other end of the socket, in a thread that passes them on
//! to the server.

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

/// Queries of each client in one run, and in one turn.
const QUERIES: usize = 10_000;
const TURN: usize = 200;
/// Queries before the first that counts.
const WARM_UP: usize = 500;
/// Busy loops beside the clients, one run each.
const LOADS: [usize; 4] = [0, 1, 2, 4];

/// Stops of each kind.
const STOPS: usize = 100;
/// Travel while the processor time of the waiting thread is counted, in mm at 5 mm/s.
const TRAVEL_MM: f32 = 15.0;

/// A busy machine may let the server wait for longer than a gripper ever would.
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
        busy.into_iter().for_each(|thread| thread.join().expect("it only spins"));
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

/// In ascending order of the times; in microseconds.
fn percentile(sorted: &[f64], percent: usize) -> f64 {
    sorted[(sorted.len() * percent / 100).min(sorted.len() - 1)]
}

/// One client: asks so many times, and returns how long each took, in microseconds.
type Client<'a> = Box<dyn FnMut(usize) -> Vec<f64> + 'a>;

/// A client that is timed here.
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

/// UMI's driver in a process of its own, which times itself.
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
    /// It ends with its input.
    fn drop(&mut self) {
        self.requests = None;
        let _ = self.child.wait();
    }
}

fn umi(path: &str, address: SocketAddr) -> Client<'static> {
    let mut python = Process::new("python3");
    python.args(["-c", UMI, path, &address.ip().to_string(), &address.port().to_string()]);
    let mut child =
        python.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("python3 is installed");
    let answers = BufReader::new(child.stdout.take().expect("a pipe"));
    let mut python = Python { requests: child.stdin.take(), answers, child };
    Box::new(move |count| {
        writeln!(python.requests.as_mut().expect("a pipe"), "{count}").expect("the driver runs");
        let mut line = String::new();
        python.answers.read_line(&mut line).expect("the driver runs");
        let times: Vec<f64> = line.split_whitespace().map(|time| time.parse().expect("a number")).collect();
        assert_eq!(times.len(), count, "the Python driver has ended");
        times
    })
}

/// The times of all clients, in ascending order.
fn queries() -> Vec<(&'static str, Vec<f64>)> {
    let servers: Vec<ServerThread> = (0..6).map(|_| serve()).collect();
    let binary = |at: usize| servers[at].tcp_address().expect("it is served");
    let gcl = |at: usize| servers[at].gcl_address().expect("it is served");

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
    ServerThread::start(wsg_sim::Config::default(), &lines, None).expect("loopback is there")
}

/// Prints how long a FAST STOP takes to the other end of the socket: of the driver while it is idle, and of a handle while the
/// driver waits for a motion.
fn stops() {
    let (address, arrivals) = tap(serve());
    let line = host::Tcp::connect(address).expect("it listens");
    let mut gripper = Gripper::<_, _>::with_config(line, host::StdClock::new(), PATIENT);
    gripper.connect().expect("the gripper answers");
    let handle = gripper.stop_handle().expect("a descriptor is left");
    gripper.home(HomingDirection::Positive).expect("the way is free");
    let (mut idle, mut by_handle) = (vec![], vec![]);
    for _ in 0..STOPS {
        // A motion keeps the driver waiting: nothing arrives but its refreshes.
        let handle = handle.clone();
        let button = thread::spawn(move || {
            thread::park_timeout(PAUSE);
            let called = Instant::now();
            handle.fast_stop().expect("the line takes it");
            called
        });
        let moved = gripper.move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop);
        assert!(matches!(moved, Err(Error::Stopped(StopKind::FastStop))), "{moved:?}");
        by_handle
            .push(micros(button.join().expect("it does not panic"), arrivals.recv().expect("it arrives")));
        gripper.acknowledge().expect("it is answered");
        arrivals.try_iter().for_each(drop);

        thread::park_timeout(PAUSE);
        let called = Instant::now();
        gripper.fast_stop().expect("it is confirmed");
        idle.push(micros(called, arrivals.recv().expect("it arrives")));
        gripper.acknowledge().expect("it is answered");
        // One that is not confirmed in time, on a busy machine, is followed by others.
        arrivals.try_iter().for_each(drop);
    }
    for (name, mut times) in [("idle", idle), ("handle", by_handle)] {
        times.sort_by(f64::total_cmp);
        for (what, percent) in [("median", 50), ("p99", 99)] {
            println!("fast-stop-{name}-{what} {:.2}", percentile(&times, percent));
        }
    }
}

/// Between two stops: whatever the one before has left behind is over.
const PAUSE: Duration = Duration::from_millis(20);

fn micros(begun: Instant, ended: Instant) -> f64 {
    ended.saturating_duration_since(begun).as_secs_f64() * 1e6
}

/// A way to the server that says when each FAST STOP has arrived.
fn tap(server: ServerThread) -> (SocketAddr, Receiver<Instant>) {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("loopback is there");
    let address = listener.local_addr().expect("it is bound");
    let (arrived, arrivals) = channel();
    thread::spawn(move || {
        let (mut near, _) = listener.accept().expect("the driver connects");
        let mut far = TcpStream::connect(server.tcp_address().expect("it is served")).expect("it listens");
        near.set_nodelay(true).and_then(|()| far.set_nodelay(true)).expect("they are sockets");
        let [mut back_from, mut back_to] =
            [&far, &near].map(|end| end.try_clone().expect("a descriptor is left"));
        thread::spawn(move || std::io::copy(&mut back_from, &mut back_to));
        let fast_stop: Vec<u8> = FrameEncoder::new(CommandId::FastStop.code(), Command::FastStop).collect();
        let mut bytes = [0; 512];
        #[expect(clippy::disallowed_methods, reason = "no signal comes")]
        while let Ok(count @ 1..) = near.read(&mut bytes) {
            let now = Instant::now();
            if bytes[..count].windows(fast_stop.len()).any(|window| window == fast_stop) {
                arrived.send(now).expect("it is waited for");
            }
            far.write_all(&bytes[..count]).expect("the server listens");
        }
    });
    (address, arrivals)
}

/// The processor time of a thread that waits for a motion, in percent of a core; on Linux.
fn processor_time_of_a_motion() -> Option<f64> {
    let server = serve();
    let mut gripper =
        host::connect(server.tcp_address().expect("it is served")).expect("the gripper answers");
    gripper.home(HomingDirection::Positive).expect("the way is free");
    let (begun, before) = (Instant::now(), processor_time()?);
    gripper.move_by(Mm(-TRAVEL_MM), MmPerS(5.0), OnBlock::Stop).expect("the way is free");
    Some((processor_time()? - before).as_secs_f64() / begun.elapsed().as_secs_f64() * 100.0)
}

/// Of this thread.
fn processor_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split(' ').next()?.parse().ok().map(Duration::from_nanos)
}

/// A socket that sends the bytes of the query and reads those of the answer, and nothing else.
fn bare(address: SocketAddr, query: Vec<u8>) -> Client<'static> {
    let mut socket = TcpStream::connect(address).expect("it listens");
    socket.set_nodelay(true).expect("it is a socket");
    let mut answer = [0; 512];
    timed(move || {
        socket.write_all(&query).expect("it takes a few bytes");
        #[expect(clippy::disallowed_methods, reason = "no signal comes, and one read is measured")]
        let len = socket.read(&mut answer).expect("it answers");
        assert!(len > 0, "the peer has closed");
    })
}
