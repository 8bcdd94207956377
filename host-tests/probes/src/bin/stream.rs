//! Measures the period jitter of a set-point stream at `wsg-sim`, with or without the script of `driver::stream`.
//!
//! Options: `--seconds N` (60), `--rate HZ` (100), `--grippers N` (1), `--busy N` busy loops (0), `--profile real`,
//! `--no-script`. Prints one line per figure, with name and number. For each gripper: samples, share in percent of
//! periods up to 1.5 nominal periods, longest period and round trip in ms. The same follows for a bare timer, a thread
//! that only sleeps for each period. With busy loops the scheduler delays both, so the probe fails only if a stream has
//! less than 99.9 % and more than three times as many late periods as the bare timer.

use std::hint::black_box;
use std::net::SocketAddr;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use wsg_protocol::HomingDirection;
use wsg_protocol::driver::host::{self, StdClock, Tcp};
use wsg_protocol::driver::stream::{Backend, Config, SetPointStream};
use wsg_protocol::driver::{Error, Mm};
use wsg_sim::server::{Lines, Profile, ServerThread};

/// End positions of the reciprocating fingers in mm, one cycle per second.
const TRAVEL: [f32; 2] = [60.0, 90.0];
/// Duration of a travel. Samples are collected this often, well before the history is full.
const HALF_TURN_MS: u32 = 500;
/// Minimum share of periods in time, in percent.
const LEAST_SHARE: f64 = 99.9;
/// Maximum ratio of late periods to the bare timer's.
const MOST_LATE: f64 = 3.0;

struct Options {
    seconds: u64,
    rate_hz: u16,
    grippers: usize,
    busy: usize,
    profile: Profile,
    has_script: bool,
}

fn main() -> ExitCode {
    let Some(options) = options() else {
        eprintln!(
            "usage: stream [--seconds N] [--rate HZ] [--grippers N] [--busy N] [--profile real] [--no-script]"
        );
        return ExitCode::from(2);
    };
    let servers: Vec<ServerThread> = (0..options.grippers).map(|_| serve(&options)).collect();
    let streams: Vec<_> = servers.iter().map(|server| start(server, &options)).collect();
    let is_over = Arc::new(AtomicBool::new(false));
    for _ in 0..options.busy {
        let is_over = Arc::clone(&is_over);
        thread::spawn(move || {
            while !black_box(&is_over).load(Ordering::Relaxed) {
                std::hint::spin_loop();
            }
        });
    }
    let timer = thread::spawn({
        let is_over = Arc::clone(&is_over);
        move || bare_timer(options.rate_hz, &is_over)
    });
    let mut periods = vec![Vec::new(); streams.len()];
    for half_turn in 0..options.seconds * 2 {
        let position = if half_turn % 2 == 0 { TRAVEL[0] } else { TRAVEL[1] };
        for stream in &streams {
            stream.schedule(Mm(position), stream.now().plus(HALF_TURN_MS)).expect("the stream runs");
        }
        thread::sleep(Duration::from_millis(HALF_TURN_MS.into()));
        for (stream, periods) in streams.iter().zip(&mut periods) {
            collect(stream, periods);
        }
    }
    is_over.store(true, Ordering::Relaxed);
    let timer = share("bare-timer", &timer.join().expect("the timer thread never panics"), options.rate_hz);
    let mut is_even = true;
    for (at, (stream, periods)) in streams.iter().zip(&periods).enumerate() {
        let periods: Vec<f64> = periods.iter().map(|(_, period_ms)| f64::from(*period_ms)).collect();
        is_even &= share(&format!("gripper-{at}"), &periods, options.rate_hz)
            >= (100.0 - MOST_LATE * (100.0 - timer)).min(LEAST_SHARE);
        println!("gripper-{at}-round-trip-ms {:.1}", stream.line().round_trip_ms);
    }
    if is_even { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Returns the periods of a thread that only sleeps, in ms.
fn bare_timer(rate_hz: u16, is_over: &AtomicBool) -> Vec<f64> {
    let period = Duration::from_secs(1) / u32::from(rate_hz);
    let (mut due, mut last) = (Instant::now(), Instant::now());
    let mut periods = Vec::new();
    while !is_over.load(Ordering::Relaxed) {
        due += period;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let now = Instant::now();
        periods.push((now - last).as_secs_f64() * 1e3);
        last = now;
    }
    periods
}

/// Prints the statistics of these periods, in ms, and returns the share in time in percent.
fn share(what: &str, periods: &[f64], rate_hz: u16) -> f64 {
    let limit_ms = 1_500.0 / f64::from(rate_hz);
    let even = periods.iter().filter(|period| **period <= limit_ms).count();
    let share = even as f64 * 100.0 / periods.len() as f64;
    println!("{what}-samples {}", periods.len());
    println!("{what}-even-percent {share:.3}");
    println!("{what}-longest-ms {:.0}", periods.iter().copied().fold(0.0, f64::max));
    share
}

fn options() -> Option<Options> {
    let mut options = Options {
        seconds: 60,
        rate_hz: 100,
        grippers: 1,
        busy: 0,
        profile: Profile::Instant,
        has_script: true,
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let mut value = || arguments.next();
        match name.as_str() {
            "--seconds" => options.seconds = value()?.parse().ok()?,
            "--rate" => options.rate_hz = value()?.parse().ok().filter(|rate| *rate > 0)?,
            "--grippers" => options.grippers = value()?.parse().ok()?,
            "--busy" => options.busy = value()?.parse().ok()?,
            "--profile" if value()? == "real" => options.profile = Profile::Real,
            "--no-script" => options.has_script = false,
            _ => return None,
        }
    }
    Some(options)
}

fn serve(options: &Options) -> ServerThread {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../protocol/scripts/wsg_stream.lua");
    let lines = Lines {
        tcp: Some(SocketAddr::from(([127, 0, 0, 1], 0))),
        script: options.has_script.then_some(script),
        profile: options.profile,
        ..Lines::default()
    };
    ServerThread::start(wsg_sim::Config::default(), &lines, None).expect("loopback is available")
}

fn start(server: &ServerThread, options: &Options) -> SetPointStream<Tcp, StdClock> {
    let address = server.tcp_address().expect("the server has a TCP port");
    let mut gripper = host::connect(address).expect("the gripper answers");
    gripper.home(HomingDirection::Positive).expect("unblocked fingers");
    // The script registers its command shortly after its start.
    while options.has_script && matches!(gripper.raw(0xA5, &[], &mut [0; 32]), Err(Error::Refused(_))) {}
    let stream = SetPointStream::start(gripper, Config { rate_hz: options.rate_hz, ..Config::DEFAULT })
        .expect("an answer");
    assert_eq!(stream.backend() == Backend::Script, options.has_script);
    stream
}

/// Adds the new samples, each with its number and the time since its predecessor in ms.
fn collect(stream: &SetPointStream<Tcp, StdClock>, periods: &mut Vec<(u32, u32)>) {
    let last = periods.last().map_or(0, |(number, _)| *number);
    for pair in stream.history().windows(2).filter(|pair| pair[1].number > last) {
        periods.push((pair[1].number, pair[1].received_at.since(pair[0].received_at)));
    }
}
