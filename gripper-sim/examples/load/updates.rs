//! 100 connections, each with updates of four values every 10 ms, while the fingers move.

use crate::figures::{Durations, Verdict};
use crate::sim::{Setup, Sim, ask, frame, own_wait_s};
use anyhow::{Result, ensure};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::runtime;
use tokio::task::JoinSet;
use wsg_protocol::{AutoUpdate, Command, Event, FrameParser, HomingDirection, PrePositionFlags};

const CONNECTIONS: usize = 100;
const PERIOD: Duration = Duration::from_millis(10);
const VALUES: [u8; 4] = [0x41, 0x43, 0x44, 0x45];

/// The limits of the issue that introduced this test.
const MEDIAN_MS: f64 = 5.0;
const CORES: f64 = 1.0;
/// The fraction of time that the gripper's threads and that of the clients wait for a processor at which the wait alone
/// makes half of the updates late: half a period, half of the time. It is close to zero on an idle machine.
const LOADED: f64 = 0.25;
/// Tolerance for the allocator while memory does not grow, in KiB.
const FLAT_KIB: u64 = 1_024;

/// Arrival times of the updates of one value, in microseconds.
type Arrivals = Vec<u32>;

pub(crate) fn run(lasting: Duration, pages: usize) -> Result<()> {
    let sim = Sim::start(Setup { udp_remote_port: 1, ..Setup::default() })?;
    let mut mover = sim.connect()?;
    ask(&mut mover, Command::ACKNOWLEDGE, 1)?;
    ask(&mut mover, Command::Homing { direction: HomingDirection::Positive }, 2)?;
    println!(
        "{CONNECTIONS} connections, {} values every {PERIOD:?}, for {lasting:?}, {pages} pages watch",
        VALUES.len()
    );

    let ended = AtomicBool::new(false);
    let (series, cpu_s, waited_s, (early_kib, late_kib)) = thread::scope(|scope| -> Result<_> {
        scope.spawn(|| -> Result<()> {
            for width in [100.0, 30.0].into_iter().cycle() {
                if ended.load(Ordering::Relaxed) {
                    break;
                }
                let flags = PrePositionFlags::empty();
                ask(&mut mover, Command::PrePosition { flags, width, speed: 200.0 }, 2)?;
            }
            ask(&mut mover, Command::DisconnectAnnouncement, 1)
        });
        let before_s = sim.cpu_s()?;
        let memory = scope.spawn(|| -> Result<_> {
            // Measured after all have connected and used every buffer, and at the end.
            thread::sleep(lasting.mul_f64(0.3));
            let early = sim.rss_kib()?;
            thread::sleep(lasting.mul_f64(0.6));
            Ok((early, sim.rss_kib()?))
        });
        let series = subscribe(&sim, lasting, pages);
        let cpu_s = sim.cpu_s()? - before_s;
        let waited_s = sim.waited_s()? + own_wait_s()?;
        ended.store(true, Ordering::Relaxed);
        let memory = memory.join().map_err(|_| anyhow::anyhow!("the memory was not read"))??;
        Ok((series?, cpu_s, waited_s, memory))
    })?;
    sim.stop()?;

    let missed: usize = series.iter().map(missed).sum();
    let lateness = Durations::new(series.iter().flat_map(lateness).collect());
    let cores = cpu_s / lasting.as_secs_f64();
    println!("updates   {}, missed {missed}", lateness.count());
    println!("late by   {lateness}");
    println!("CPU       {cpu_s:.1} s, {cores:.2} cores");
    println!("memory    {early_kib} KiB early, {late_kib} KiB late");
    println!("waited    {waited_s:.1} s for a processor");

    let load = format!("gripper and clients had work and no processor for {waited_s:.1} s of {lasting:?}");
    let mut verdict = Verdict::under((waited_s >= LOADED * lasting.as_secs_f64()).then_some(load));
    let median = lateness.quantile(0.5);
    verdict.must_in_time(missed == 0, format!("{missed} updates are missing"));
    verdict.must_in_time(median <= MEDIAN_MS, format!("half of the updates are more than {median} ms late"));
    verdict.must(cores < CORES, format!("it takes {cores:.2} cores"));
    let growth = late_kib.saturating_sub(early_kib);
    verdict.must(growth <= FLAT_KIB, format!("the memory grew by {growth} KiB"));
    verdict.give()
}

/// Opens the connections and reads until the time is over; returns the arrivals of each value of each connection.
fn subscribe(sim: &Sim, lasting: Duration, pages: usize) -> Result<Vec<Arrivals>> {
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let start = Instant::now();
        let mut watching = JoinSet::new();
        for _ in 0..pages {
            // One after the other, because fewer requests are served simultaneously.
            let page = open_page(sim.control).await?;
            watching.spawn(watch(page, start + lasting));
        }
        let mut clients = JoinSet::new();
        for _ in 0..CONNECTIONS {
            let stream = sim.connect()?;
            stream.set_nonblocking(true)?;
            clients.spawn(read_updates(stream, start, lasting));
        }
        let mut series = Vec::new();
        while let Some(client) = clients.join_next().await {
            series.extend(client??);
        }
        while let Some(page) = watching.join_next().await {
            page??;
        }
        Ok(series)
    })
}

/// Opens a page and waits for its first event.
async fn open_page(control: SocketAddr) -> Result<tokio::net::TcpStream> {
    let mut stream = tokio::net::TcpStream::connect(control).await?;
    stream.write_all(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n").await?;
    ensure!(stream.read(&mut [0; 64]).await? > 0, "a page got no answer");
    Ok(stream)
}

/// Checks that a page receives the state at least ten times a second until the time is over.
async fn watch(mut stream: tokio::net::TcpStream, end: Instant) -> Result<()> {
    let start = Instant::now();
    let mut buffer = vec![0; 64 * 1_024];
    let mut states = 0;
    while Instant::now() < end {
        let len = stream.read(&mut buffer).await?;
        ensure!(len > 0, "a page's stream ended");
        let read = buffer.get(..len).unwrap_or(&[]);
        // An event split across two buffers is not counted.
        states += read.windows(12).filter(|window| window == b"event: state").count();
    }
    let rate = states as f64 / start.elapsed().as_secs_f64();
    ensure!(rate > 10.0, "a page received the state {rate:.1} times a second");
    Ok(())
}

async fn read_updates(
    stream: std::net::TcpStream,
    start: Instant,
    lasting: Duration,
) -> Result<[Arrivals; VALUES.len()]> {
    let mut stream = tokio::net::TcpStream::from_std(stream)?;
    let update = AutoUpdate::every(PERIOD.as_millis() as u16);
    let requests = [
        Command::GetGripperState { update },
        Command::GetOpeningWidth { update },
        Command::GetSpeed { update },
        Command::GetForce { update },
    ];
    stream.write_all(&requests.map(frame).concat()).await?;
    let mut parser = FrameParser::<64>::new();
    let mut series: [Arrivals; VALUES.len()] = Default::default();
    let mut buffer = [0; 4_096];
    while start.elapsed() < lasting {
        let len = stream.read(&mut buffer).await?;
        ensure!(len > 0, "the gripper closed the connection");
        let at = start.elapsed().as_micros() as u32;
        for byte in &buffer[..len] {
            let Some(event) = parser.push(*byte) else { continue };
            let Event::Frame(frame) = event else { anyhow::bail!("a broken frame arrived") };
            if let Some(value) = VALUES.iter().position(|id| *id == frame.id) {
                series[value].push(at);
            }
        }
    }
    // Announced, so that the other clients continue undisturbed.
    stream.write_all(&frame(Command::DisconnectAnnouncement)).await?;
    Ok(series)
}

/// Returns the delay of each update against the earliest: the update with the least delay defines the phase.
fn lateness(arrivals: &Arrivals) -> Vec<u32> {
    let period = PERIOD.as_micros() as i64;
    let phases = || arrivals.iter().zip(0..).map(|(at, count)| i64::from(*at) - count * period);
    let earliest = phases().min().unwrap_or(0);
    phases().map(|phase| (phase - earliest) as u32).collect()
}

/// Returns how many updates are missing between the first and the last. A late update shifts the last one by less than a period.
fn missed(arrivals: &Arrivals) -> usize {
    let (Some(first), Some(last)) = (arrivals.first(), arrivals.last()) else { return usize::MAX };
    let expected = 1 + (f64::from(last - first) / PERIOD.as_micros() as f64).round() as usize;
    expected.saturating_sub(arrivals.len())
}
