//! `doctor`: checks the connection to a gripper and reports what to change.
//!
//! It sends queries and announces the end of the connection. It never sends a motion, a stop or an acknowledgement. Only on request,
//! it ends a connection without an announcement, which is a FAST STOP.

mod probe;
mod report;

pub(crate) use report::Check;

use std::io;
use std::time::{Duration, Instant};

use wsg_protocol::driver::blocking::{GclGripper, Gripper as BinaryGripper};
use wsg_protocol::driver::host::StdClock;
use wsg_protocol::driver::{Error, Update};
use wsg_protocol::session::Topic;
use wsg_protocol::{AutoUpdate, GripperState, SystemFlags};

use super::address::Address;
use super::line::Connection;
use super::output::Output;
use super::record::Recorder;
use super::run::{Gripper, ProtocolCommands};
use super::signals::Signals;
use super::trouble::Trouble;
use probe::{Checksums, Peer, Speech};
use report::{EARLIER, Report};

/// Number of queries for the round-trip statistics.
const QUERIES: usize = 100;
/// Round-trip times above which the network is suspected: median and 99th percentile. Field reports put real grippers at
/// about 22 ms.
const SLOW_MEDIAN: Duration = Duration::from_millis(50);
const SLOW_P99: Duration = Duration::from_millis(200);

/// How long automatic updates are counted to measure their rate.
const COUNTED: Duration = Duration::from_secs(1);
/// The network is suspected if fewer than this share of the requested updates arrive.
const FEW_UPDATES: f64 = 0.5;

/// Longest wait for another client's motion to end. The disconnect announcement would stop it (command set, 3.1.2).
const STANDSTILL: Duration = Duration::from_secs(10);

/// Time in which a gripper enters FAST STOP after the end of a connection.
const DETECTION: Duration = Duration::from_secs(2);

/// Checks the gripper at an address and returns the exit status.
pub(crate) fn run(
    address: &Address,
    recorder: Option<Recorder>,
    signals: &Signals,
    output: &Output,
    try_disconnect: bool,
) -> Result<u8, Trouble> {
    let mut report = Report::new(output.is_json);
    let checked = check(address, recorder, signals, &mut report, try_disconnect);
    match checked {
        // Any failed check has already been recorded.
        Ok(()) => {}
        Err(trouble @ (Trouble::Caught(_) | Trouble::Output(_) | Trouble::Panicked(_))) => {
            return Err(trouble);
        }
        Err(trouble) => report.fail_next(&trouble)?,
    }
    report.finish()
}

fn check(
    address: &Address,
    recorder: Option<Recorder>,
    signals: &Signals,
    report: &mut Report,
    try_disconnect: bool,
) -> Result<(), Trouble> {
    let mut line = match Connection::open(address, recorder, signals.clone()) {
        Ok(line) => line,
        Err(error) => return no_line(address, &error, report),
    };
    let is_datagram = matches!(address, Address::Udp { .. } | Address::GclUdp { .. });
    if !is_datagram {
        report.ok(Check::Reachability, &format!("{address} opened"))?;
        let is_tcp = matches!(address, Address::Tcp(_) | Address::Gcl { .. });
        report
            .ok(Check::Port, if is_tcp { "accepts a connection" } else { "not applicable to this line" })?;
    }
    let peer = probe::speech(&mut line, address);
    let peer = peer.inspect_err(|_| probe::leave(&mut line))?;
    if !matches!(peer, Peer::Answers(_)) {
        probe::leave(&mut line);
    }
    if is_datagram {
        match peer {
            Peer::Answers(_) => {
                report.ok(Check::Reachability, "the host responds")?;
                report.ok(Check::Port, "receives datagrams")?;
            }
            Peer::HasClosed => {
                report.ok(Check::Reachability, "the host responds")?;
                return report.fail(Check::Port, &format!("{address}: no program receives datagrams"));
            }
            Peer::IsSilent => return report.fail(Check::Reachability, &format!("{address}: no answer")),
        }
    }
    let speech = match peer {
        Peer::Answers(speech) => speech,
        Peer::IsSilent => {
            report.fail(Check::Protocol, "no answer to queries of the binary protocol or GCL")?;
            report.skip(Check::Checksum, EARLIER)?;
            return report
                .fail(Check::OtherClients, "the line is open but silent: another client may hold it");
        }
        Peer::HasClosed => {
            report.fail(Check::Protocol, "the peer closed the connection without answering")?;
            report.skip(Check::Checksum, EARLIER)?;
            return report.fail(Check::OtherClients, "the peer closed at once: it is busy or not a gripper");
        }
    };
    if (speech == Speech::Gcl) == address.is_gcl() {
        report.ok(Check::Protocol, speech.name())?;
    } else {
        let found = format!("{}, which is not the protocol of {address}", speech.name());
        report.fail(Check::Protocol, &found)?;
    }
    let is_idle = match speech {
        Speech::Gcl => {
            report.ok(Check::Checksum, "not used by GCL")?;
            examine(GclGripper::new(line, StdClock::new()), signals, report)?
        }
        Speech::Binary => {
            let checksums = probe::checksums(&mut line);
            match checksums.inspect_err(|_| probe::leave(&mut line))? {
                Checksums::Evaluated => report.ok(Check::Checksum, "evaluated")?,
                Checksums::Ignored => {
                    report.warn(Check::Checksum, "not evaluated: the gripper executes corrupted commands")?;
                }
            }
            examine(BinaryGripper::new(line, StdClock::new()), signals, report)?
        }
    };
    match address {
        Address::Tcp(host) | Address::Gcl { gripper: host, .. } if try_disconnect && is_idle => {
            probe::lose_connection(host, speech).map_err(|error| Trouble::NoLine(error.into()))?;
            let line = Connection::open(address, None, signals.clone()).map_err(Trouble::NoLine)?;
            let is_stopped = match speech {
                Speech::Gcl => enters_fast_stop(GclGripper::new(line, StdClock::new()), signals)?,
                Speech::Binary => enters_fast_stop(BinaryGripper::new(line, StdClock::new()), signals)?,
            };
            if is_stopped {
                report.ok(
                    Check::TcpDisconnect,
                    "a lost connection causes FAST STOP, which is latched now: run `ack` when it is safe to move the fingers",
                )
            } else {
                report.warn(Check::TcpDisconnect, "a lost connection does not stop the fingers")
            }
        }
        Address::Tcp(_) | Address::Gcl { .. } if try_disconnect => {
            report.skip(Check::TcpDisconnect, "tested only at rest, without a held part and without FAST STOP")
        }
        Address::Tcp(_) | Address::Gcl { .. } => report.skip(
            Check::TcpDisconnect,
            "no client can read whether a lost connection causes FAST STOP: see Settings -> Command Interface in the web interface, or \
             run `doctor --try-disconnect`, which latches FAST STOP",
        ),
        _ => report.skip(Check::TcpDisconnect, "not applicable to this line"),
    }
}

/// Reports a line that cannot be opened. A refused connection proves that the host is reachable.
fn no_line(address: &Address, error: &anyhow::Error, report: &mut Report) -> Result<(), Trouble> {
    let cause = error.downcast_ref::<io::Error>().map(io::Error::kind);
    let root = error.root_cause();
    if cause == Some(io::ErrorKind::ConnectionRefused) {
        report.ok(Check::Reachability, "the host responds")?;
        report.fail(Check::Port, &format!("{address}: {root}"))
    } else {
        report.fail(Check::Reachability, &format!("{address}: {root}"))
    }
}

/// Runs the checks that need a responding gripper, and always announces the end of the connection. Returns whether a FAST STOP would
/// change nothing: the fingers rest, no part is held, and none is latched.
fn examine<P: ProtocolCommands>(
    mut gripper: Gripper<P>,
    signals: &Signals,
    report: &mut Report,
) -> Result<bool, Trouble> {
    let mut is_idle = false;
    super::guarded(&mut gripper, signals, |gripper| {
        let flags = gripper.system_state()?;
        if flags.contains(SystemFlags::MOVING) {
            report.warn(
                Check::OtherClients,
                "the fingers are moving: another client or a script commands them",
            )?;
        } else {
            report.ok(Check::OtherClients, "none blocks this connection; the fingers are at rest")?;
        }
        report.ok(Check::Firmware, &gripper.system_info()?.to_string())?;
        of_flags(flags, report)?;
        time_queries(gripper, report)?;
        count_updates(gripper, report)?;
        let begin = Instant::now();
        while gripper.system_state()?.contains(SystemFlags::MOVING) && begin.elapsed() < STANDSTILL {}
        let is_moving_or_stopped =
            gripper.system_state()?.intersects(SystemFlags::MOVING | SystemFlags::FAST_STOP);
        is_idle = !is_moving_or_stopped && gripper.gripper_state()? != GripperState::Holding;
        Ok(0)
    })?;
    Ok(is_idle)
}

/// Returns whether a gripper that has lost a connection enters FAST STOP.
fn enters_fast_stop<P: ProtocolCommands>(
    mut gripper: Gripper<P>,
    signals: &Signals,
) -> Result<bool, Trouble> {
    let (begin, mut is_stopped) = (Instant::now(), false);
    super::guarded(&mut gripper, signals, |gripper| {
        while !is_stopped && begin.elapsed() < DETECTION {
            is_stopped = gripper.system_state()?.contains(SystemFlags::FAST_STOP);
        }
        Ok(0)
    })?;
    Ok(is_stopped)
}

fn of_flags(flags: SystemFlags, report: &mut Report) -> Result<(), Trouble> {
    if flags.contains(SystemFlags::REFERENCED) {
        report.ok(Check::Referenced, "yes")?;
    } else {
        report.warn(Check::Referenced, "no: the gripper refuses every motion except homing")?;
    }
    if flags.contains(SystemFlags::FAST_STOP) {
        report.fail(Check::FastStop, "latched: the gripper refuses every motion")?;
    } else {
        report.ok(Check::FastStop, "not latched")?;
    }
    let faults = SystemFlags::TEMP_FAULT | SystemFlags::POWER_FAULT | SystemFlags::CURR_FAULT;
    let warnings = SystemFlags::TEMP_WARNING | SystemFlags::FINGER_FAULT;
    let shown = (flags & (faults | warnings)).to_string();
    if flags.intersects(faults) {
        report.fail(Check::Faults, &shown)?;
    } else if flags.intersects(warnings) {
        report.warn(Check::Faults, &shown)?;
    } else {
        report.ok(Check::Faults, "none")?;
    }
    if flags.contains(SystemFlags::SCRIPT_FAILURE) {
        report.warn(Check::Script, "ended with an error")
    } else if flags.contains(SystemFlags::SCRIPT_RUNNING) {
        report.ok(Check::Script, "running: it may move the fingers")
    } else {
        report.ok(Check::Script, "not running")
    }
}

fn time_queries<P: ProtocolCommands>(gripper: &mut Gripper<P>, report: &mut Report) -> Result<(), Trouble> {
    let mut times = Vec::with_capacity(QUERIES);
    for _ in 0..QUERIES {
        let begin = Instant::now();
        gripper.width()?;
        times.push(begin.elapsed());
    }
    times.sort_unstable();
    let at = |percent: usize| times.get(QUERIES * percent / 100 - 1).copied().unwrap_or_default();
    let (median, p99) = (at(50), at(99));
    let found = format!("median {} ms, p99 {} ms of {QUERIES} queries", millis(median), millis(p99));
    report.value("median_ms", median.as_secs_f64() * 1e3);
    report.value("p99_ms", p99.as_secs_f64() * 1e3);
    if median > SLOW_MEDIAN || p99 > SLOW_P99 {
        report.warn(Check::RoundTrip, &found)
    } else {
        report.ok(Check::RoundTrip, &found)
    }
}

fn millis(time: Duration) -> String {
    format!("{:.2}", time.as_secs_f64() * 1e3)
}

fn count_updates<P: ProtocolCommands>(gripper: &mut Gripper<P>, report: &mut Report) -> Result<(), Trouble> {
    let period_ms = AutoUpdate::MIN_PERIOD_MS;
    // Unlike the width, the force is also sent while the fingers are not referenced.
    gripper.subscribe(Topic::Force, AutoUpdate::every(period_ms));
    let counted = count_forces(gripper);
    gripper.subscribe(Topic::Force, AutoUpdate::once());
    // This query also sends the changed subscription.
    gripper.system_state()?;
    let rate = counted?;
    let requested = 1e3 / f64::from(period_ms);
    let found = format!("{rate:.0} updates/s of {requested:.0} requested");
    report.value("updates_per_s", rate);
    if rate < requested * FEW_UPDATES {
        report.warn(Check::UpdateRate, &found)
    } else {
        report.ok(Check::UpdateRate, &found)
    }
}

fn count_forces<P: ProtocolCommands>(gripper: &mut Gripper<P>) -> Result<f64, Error<io::Error>> {
    // This query also sends the subscription.
    gripper.system_state()?;
    let begin = Instant::now();
    let mut first = None;
    let mut intervals = 0_u32;
    while begin.elapsed() < COUNTED {
        let left = COUNTED.saturating_sub(begin.elapsed()).as_millis() as u32;
        match (gripper.next_update(left)?, first) {
            (Some(Update::Force(_)), None) => first = Some(Instant::now()),
            (Some(Update::Force(_)), Some(_)) => intervals += 1,
            _ => {}
        }
    }
    Ok(first.map_or(0.0, |first| f64::from(intervals) / first.elapsed().as_secs_f64()))
}
