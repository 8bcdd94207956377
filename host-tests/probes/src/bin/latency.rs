//! How long a call of a driver takes over loopback TCP, beside a bare socket that exchanges the same bytes in the same run.
//!
//! The peer is `wsg-sim`, a server for each client. The clients take turns, some hundred queries at a time, so that other work
//! of the machine hits all of them. Prints a line for each figure, a name and a number in microseconds.

use std::hint::black_box;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Instant;

use wsg_protocol::driver::{asynch, blocking, host, tokio as on_tokio};
use wsg_protocol::{AutoUpdate, Command, FrameEncoder};
use wsg_sim::Config;
use wsg_sim::server::{Lines, ServerThread};

/// Queries of each client in one run, and in one turn.
const QUERIES: usize = 10_000;
const TURN: usize = 200;
/// Queries before the first that counts.
const WARM_UP: usize = 500;
/// Busy loops beside the clients, one run each.
const LOADS: [usize; 4] = [0, 1, 2, 4];

fn main() {
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

/// One client: asks once.
type Client<'a> = Box<dyn FnMut() + 'a>;

/// The times of all clients, in ascending order.
fn queries() -> Vec<(&'static str, Vec<f64>)> {
    let servers: Vec<ServerThread> = (0..5).map(|_| serve()).collect();
    let binary = |at: usize| servers[at].tcp_address().expect("it is served");
    let gcl = |at: usize| servers[at].gcl_address().expect("it is served");

    let query = Command::GetOpeningWidth { update: AutoUpdate::once() };
    let frame: Vec<u8> = FrameEncoder::new(query.id().code(), query).collect();
    let mut blocking = blocking::Gripper::new(connect(binary(1)), host::StdClock::new());
    blocking.connect().expect("the gripper answers");
    let mut over_gcl = blocking::GclGripper::new(connect(gcl(3)), host::StdClock::new());
    over_gcl.connect().expect("the gripper answers");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let mut asynch = runtime.block_on(async {
        let line = on_tokio::Tcp::connect(binary(2)).await.expect("it listens");
        let mut gripper = asynch::Gripper::new(line, on_tokio::TokioTimer::new());
        gripper.connect().await.expect("the gripper answers");
        gripper
    });

    let mut clients: [(&str, Client<'_>); 5] = [
        ("bare", bare(binary(0), frame)),
        ("blocking", Box::new(|| _ = black_box(blocking.width().expect("it is answered")))),
        ("tokio", Box::new(|| _ = black_box(runtime.block_on(asynch.width()).expect("it is answered")))),
        ("bare-gcl", bare(gcl(4), b"POS?\n".to_vec())),
        ("gcl", Box::new(|| _ = black_box(over_gcl.width().expect("it is answered")))),
    ];
    let mut times: [Vec<f64>; 5] = Default::default();
    for (_, ask) in &mut clients {
        (0..WARM_UP).for_each(|_| ask());
    }
    for _ in 0..QUERIES / TURN {
        for ((_, ask), times) in clients.iter_mut().zip(&mut times) {
            times.extend((0..TURN).map(|_| {
                let begun = Instant::now();
                ask();
                begun.elapsed().as_secs_f64() * 1e6
            }));
        }
    }
    times.iter_mut().for_each(|times| times.sort_by(f64::total_cmp));
    clients.iter().map(|(name, _)| *name).zip(times).collect()
}

fn serve() -> ServerThread {
    let loopback = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
    let lines = Lines { tcp: loopback, gcl: loopback, ..Lines::default() };
    ServerThread::start(Config::default(), &lines, None).expect("loopback is there")
}

fn connect(address: SocketAddr) -> host::Tcp {
    host::Tcp::connect(address).expect("it listens")
}

/// A socket that sends the bytes of the query and reads those of the answer, and nothing else.
fn bare(address: SocketAddr, query: Vec<u8>) -> Client<'static> {
    let mut socket = TcpStream::connect(address).expect("it listens");
    socket.set_nodelay(true).expect("it is a socket");
    let mut answer = [0; 512];
    Box::new(move || {
        socket.write_all(&query).expect("it takes a few bytes");
        #[expect(clippy::disallowed_methods, reason = "no signal comes, and one read is measured")]
        let len = socket.read(&mut answer).expect("it answers");
        assert!(len > 0, "the peer has closed");
    })
}
