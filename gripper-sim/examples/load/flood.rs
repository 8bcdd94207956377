//! Clients that disturb the server as much as they can, and the effect on well-behaved clients.

use crate::figures::{Durations, Verdict};
use crate::sim::{Setup, Sim, ask, frame};
use anyhow::{Result, anyhow};
use std::io::{ErrorKind, Write};
use std::net::{TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use wsg_protocol::{AutoUpdate, Command, LoopData};

/// Number of clients of each misbehaving kind.
const OF_EACH: usize = 20;
/// Nice value of the misbehaving clients when there are too few cores for all.
#[cfg(unix)]
const NICENESS: i32 = 15;
/// Interval of the requests of a well-behaved client.
const PACE: Duration = Duration::from_millis(5);
const FAIR_MS: f64 = 5.0;
/// Memory for 100 misbehaving clients: tables and queues of each are at most 32 KiB.
const MEMORY_KIB: u64 = 100 * 32;

pub(crate) fn run(lasting: Duration) -> Result<()> {
    let path = std::env::temp_dir().join(format!("wsg-load-{}", std::process::id()));
    let sim = Sim::start(Setup { unix: Some(&path), udp_remote_port: 1, ..Setup::default() })?;
    let quiet = round_trips(&sim, lasting.min(Duration::from_secs(3)))?;
    let quiet_kib = sim.rss_kib()?;

    let ended = AtomicBool::new(false);
    let (busy, most_kib) = thread::scope(|scope| -> Result<_> {
        let (sim, ended) = (&sim, &ended);
        let bad = [flood, flood_serial, flood_udp, reconnect, hold].map(|client| {
            scope.spawn(move || {
                // It competes with the others for the gripper, but not for the processor.
                #[cfg(unix)]
                rustix::process::nice(NICENESS)?;
                client(sim, ended)
            })
        });
        let memory = scope.spawn(|| -> Result<u64> {
            let mut most = 0;
            while !ended.load(Ordering::Relaxed) {
                most = most.max(sim.rss_kib()?);
                thread::sleep(Duration::from_millis(100));
            }
            Ok(most)
        });
        let busy = round_trips(sim, lasting);
        ended.store(true, Ordering::Relaxed);
        for client in bad {
            client.join().map_err(|_| anyhow!("a client failed"))??;
        }
        Ok((busy?, memory.join().map_err(|_| anyhow!("the memory was not read"))??))
    })?;
    sim.stop()?;

    println!("round trips, quiet    {} of them, {quiet}", quiet.count());
    println!("round trips, flooded  {} of them, {busy}", busy.count());
    println!("memory                {quiet_kib} KiB quiet, {most_kib} KiB at most");
    let mut verdict = Verdict::default();
    let median = busy.quantile(0.5);
    verdict.must(median <= FAIR_MS, format!("half of the answers take more than {median} ms"));
    let growth = most_kib.saturating_sub(quiet_kib);
    verdict.must(growth <= MEMORY_KIB, format!("the memory grew by {growth} KiB"));
    verdict.give()
}

/// Measures how long each answer to a well-behaved client takes.
fn round_trips(sim: &Sim, lasting: Duration) -> Result<Durations> {
    let mut stream = sim.connect()?;
    let data = LoopData::new(b"round and round").map_err(|refusal| anyhow!("{refusal}"))?;
    let start = Instant::now();
    let mut micros = Vec::new();
    while start.elapsed() < lasting {
        let start = Instant::now();
        ask(&mut stream, Command::Loop { data }, 1)?;
        micros.push(start.elapsed().as_micros() as u32);
        thread::sleep(PACE.saturating_sub(start.elapsed()));
    }
    ask(&mut stream, Command::DisconnectAnnouncement, 1)?;
    Ok(Durations::new(micros))
}

/// Sends as many requests as possible from clients that never read an answer.
fn flood(sim: &Sim, ended: &AtomicBool) -> Result<()> {
    let mut streams = connect_all(sim)?;
    for stream in &streams {
        stream.set_nonblocking(true)?;
    }
    let requests = frame(Command::GetSystemLimits).repeat(200);
    while !ended.load(Ordering::Relaxed) {
        let mut all_full = true;
        for stream in &mut streams {
            match uninterrupted::write(&mut *stream, &requests) {
                Ok(_) => all_full = false,
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
        }
        if all_full {
            thread::sleep(Duration::from_millis(1));
        }
    }
    Ok(())
}

/// A serial line has no flow control: all requests are accepted, and the answers are lost.
fn flood_serial(sim: &Sim, ended: &AtomicBool) -> Result<()> {
    let (_unread, mut stream) = sim.open_serial()?;
    let requests = frame(Command::GetSystemLimits).repeat(20);
    while !ended.load(Ordering::Relaxed) {
        stream.write_all(&requests)?;
    }
    Ok(())
}

fn flood_udp(sim: &Sim, ended: &AtomicBool) -> Result<()> {
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    let request = frame(Command::GetSystemLimits);
    while !ended.load(Ordering::Relaxed) {
        // Datagrams for which the system has no room are lost.
        let _ = uninterrupted::send_to(&socket, &request, sim.udp);
    }
    Ok(())
}

/// Opens connections that end unannounced immediately.
fn reconnect(sim: &Sim, ended: &AtomicBool) -> Result<()> {
    while !ended.load(Ordering::Relaxed) {
        let mut stream = sim.connect()?;
        stream.write_all(&frame(Command::Stop))?;
        // An excess connection is closed immediately; there is nothing to read then.
        let _ = uninterrupted::read(&stream, &mut [0; 64]);
        thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}

/// Incomplete frames, unread updates, and silent control connections.
fn hold(sim: &Sim, ended: &AtomicBool) -> Result<()> {
    let mut half = connect_all(sim)?;
    for stream in &mut half {
        stream.write_all(&[0xAA, 0xAA, 0xAA, 0x06, 0xF0, 0x03, 0x00])?;
    }
    let update = AutoUpdate::every(10);
    let mut unread = connect_all(sim)?;
    for stream in &mut unread {
        stream.write_all(&frame(Command::GetSpeed { update }))?;
        stream.write_all(&frame(Command::GetForce { update }))?;
    }
    let _silent: Vec<TcpStream> =
        (0..OF_EACH).map(|_| TcpStream::connect(sim.control)).collect::<Result<_, _>>()?;
    while !ended.load(Ordering::Relaxed) {
        for stream in &mut half {
            // One more byte before the time-out: the frame stays incomplete for long.
            stream.write_all(&[0])?;
        }
        thread::sleep(Duration::from_millis(400));
    }
    Ok(())
}

fn connect_all(sim: &Sim) -> Result<Vec<TcpStream>> {
    (0..OF_EACH).map(|_| sim.connect()).collect()
}
