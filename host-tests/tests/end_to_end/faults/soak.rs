//! The emulated image and a virtual gripper with a faulty line between them: `cargo xtask soak`.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use host_tests::emulator::Emulator;
use host_tests::faulty_link::{Counts, FaultyWay, Rates};
use host_tests::rig::{Rig, names};
use host_tests::trace::{Entry, Trace};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, GripperState, Kind};
use wsg_sim::{Config, Part, State};

/// Number of commands in a test run. `cargo xtask soak` sets a greater number in this variable.
const COMMANDS: usize = 200;
const COMMANDS_VARIABLE: &str = "WSG_SOAK_COMMANDS";
const SEED_VARIABLE: &str = "WSG_SOAK_SEED";

const BYTE_ERRORS: f64 = 1e-4;
/// The short run has a higher error rate, so that faults occur in it.
const BYTE_ERRORS_SHORT: f64 = 5e-4;

/// Minimum share of commands, in percent, that are executed and reported as such.
const DONE_PERCENT: usize = 95;

/// An input wire, the command of its rising edge, and the resulting condition of the gripper.
type Job = (Inputs, CommandId, fn(&State) -> bool);

const MOVE: Job = (Inputs::MOVE, CommandId::PrePosition, |state| (state.width - 80.0).abs() < 0.1);
const GRIP: Job = (Inputs::GRIP, CommandId::GripPart, |state| state.gripper == GripperState::Holding);
const RELEASE: Job = (Inputs::RELEASE, CommandId::ReleasePart, |state| (state.width - 40.0).abs() < 0.1);

/// The recipe with a large width, for MOVE.
const WIDE: u8 = 1;

/// Time limit of every wait. A lost link recovers in seconds, but may fail repeatedly on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Number of entries of the recording that a failure lists from the begin and from the end.
const LISTED: usize = 24;

/// Results that the PLC has read.
#[derive(Debug, Default)]
struct Tally {
    done: usize,
    trouble: usize,
    /// The link was lost at the time of the edge.
    not_taken: usize,
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn soak_on_a_faulty_line_loses_nothing_and_does_nothing_twice() {
    let number = |name: &str| std::env::var(name).ok().map(|value| value.parse().expect("a number"));
    let asked: Option<u64> = number(COMMANDS_VARIABLE);
    let commands = asked.map_or(COMMANDS, |commands| commands as usize);
    let rate = if asked.is_some() { BYTE_ERRORS } else { BYTE_ERRORS_SHORT };
    let seed = number(SEED_VARIABLE).unwrap_or(1);

    let (tally, counts, seconds) = soak(commands, rate, seed).unwrap();

    println!(
        "soak: {commands} commands at {rate:e} wrong bytes, seed {seed}, in {seconds} s: {} done, {} reported as failed, \
         {} refused; {} of {} bytes damaged; no command repeated, sent without an edge, or lost without a report",
        tally.done,
        tally.trouble,
        tally.not_taken,
        counts.iter().map(|way| way.faults).sum::<u64>(),
        counts.iter().map(|way| way.bytes).sum::<u64>(),
    );
    assert_eq!(tally.done + tally.trouble + tally.not_taken, commands);
    assert!(counts.iter().all(|way| way.faults > 0), "{counts:?}");
    assert!(tally.done * 100 >= commands * DONE_PERCENT, "fewer than {DONE_PERCENT} % done: {tally:?}");
}

fn soak(commands: usize, rate: f64, seed: u64) -> Result<(Tally, [Counts; 2], u64)> {
    let start = Instant::now();
    let elf = std::env::var_os("WSG_FIRMWARE_ELF")
        .context("WSG_FIRMWARE_ELF must hold the path of the firmware image")?;
    let config = Config { part: Part::of_width(20.0), time_scale: 20.0, ..Config::default() };
    let rig = Rig::of(Emulator::start(elf.as_ref())?, None, config, Trace::new(vec![]))?;
    rig.release_fast_stop()?;
    rig.command(Inputs::HOME)?;
    rig.catch_up()?;
    let mark = rig.trace().mark();
    let rates = Rates::of_bytes(rate);
    rig.gripper().disturb(Some((FaultyWay::new(rates, seed), FaultyWay::new(rates, !seed))));

    let mut tally = Tally::default();
    let mut rest = rig.gripper().state().width;
    for number in 0..commands {
        let before = rig.gripper().state();
        if (before.width - rest).abs() > 0.02 {
            bail!("before command {number} the fingers moved from {rest} mm to {} mm", before.width);
        }
        let outputs = recover(&rig).with_context(|| format!("before command {number}"))?;
        let must_open = outputs.intersects(Outputs::HOLDING | Outputs::PART_FAULT);
        let job = match (must_open, number % 2) {
            (true, _) => RELEASE,
            (false, 0) => MOVE,
            (false, _) => GRIP,
        };
        let sent = rig.trace().mark();
        command(&rig, job, &mut tally)
            .with_context(|| format!("command {number}, {:?}; {}", job.0, found(&rig, sent)))?;
        rest = settle(&rig).with_context(|| format!("after command {number}, {:?}", job.0))?;
    }
    let ways = rig.gripper().disturb(None).context("the disturbance is still installed")?;
    rig.catch_up()?;
    once_for_each_edge(&rig.trace().since(mark))?;
    Ok((tally, [ways.0.counts(), ways.1.counts()], start.elapsed().as_secs()))
}

/// Reaches READY without ERROR through the wires alone, as docs/wiring.md describes: STOP_ACK ends an error.
fn recover(rig: &Rig) -> Result<Outputs> {
    let ready = |outputs: Outputs| outputs.contains(Outputs::READY);
    let outputs = rig.await_outputs(PATIENCE, |outputs| {
        ready(outputs)
            || outputs.contains(Outputs::ERROR | Outputs::LINK_OK) && !outputs.contains(Outputs::BUSY)
    });
    if !outputs.context("neither READY nor ERROR")?.contains(Outputs::ERROR) {
        return rig.await_outputs(PATIENCE, ready).context("not READY");
    }
    rig.acknowledge()?;
    rig.await_outputs(PATIENCE, ready).context("not READY after STOP_ACK")
}

/// Issues a command as a PLC does, and compares the reported result with the gripper.
fn command(rig: &Rig, (wire, _, is_done): Job, tally: &mut Tally) -> Result<()> {
    rig.select_recipe(if wire == Inputs::MOVE { WIDE } else { 0 })?;
    rig.set(wire, true)?;
    // If the link is lost at this time, READY goes low.
    let shown = |outputs: Outputs| outputs.contains(Outputs::BUSY) || !outputs.contains(Outputs::READY);
    let taken = rig.await_outputs(PATIENCE, shown).context("neither BUSY nor READY low")?;
    rig.set(wire, false)?;
    if !taken.contains(Outputs::BUSY) {
        tally.not_taken += 1;
        return Ok(());
    }
    let end = rig.await_outputs(PATIENCE, |outputs| !outputs.contains(Outputs::BUSY))?;
    if end.intersects(Outputs::ERROR | Outputs::PART_FAULT) || !end.contains(Outputs::LINK_OK) {
        tally.trouble += 1;
        return Ok(());
    }
    let state = rig.gripper().state();
    let is_shown = end.contains(Outputs::HOLDING) == (wire == Inputs::GRIP);
    if !is_shown || !is_done(&state) {
        bail!("{} is shown, but the gripper is {state:?}", names(end));
    }
    tally.done += 1;
    Ok(())
}

/// Describes the rig after a failure: whether the board runs, the gripper, and the recording from `mark` on.
fn found(rig: &Rig, mark: usize) -> String {
    let [before, after] = [(), ()].map(|()| {
        thread::sleep(Duration::from_secs(1));
        rig.board().now_ms()
    });
    let entries = rig.trace().since(mark);
    let (first, last) = (entries.iter().take(LISTED), entries.iter().rev().take(LISTED));
    let (first, last): (Vec<_>, Vec<_>) = (first.collect(), last.rev().collect());
    format!(
        "board's clock {before:?}, a second later {after:?}; {:?}; {} entries: {first:?} ... {last:?}",
        rig.gripper().state(),
        entries.len()
    )
}

/// Waits for standstill and returns the width.
fn settle(rig: &Rig) -> Result<f32> {
    let bound = Instant::now() + PATIENCE;
    loop {
        rig.pass(5)?;
        let state = rig.gripper().state();
        if state.speed == 0.0 {
            return Ok(state.width);
        }
        if Instant::now() > bound {
            bail!("the motion does not end: {state:?}");
        }
    }
}

/// Checks that the bridge has sent at most one motion for each edge, and only after it.
fn once_for_each_edge(entries: &[Entry]) -> Result<()> {
    let mut asked: Option<CommandId> = None;
    for entry in entries {
        match entry {
            Entry::Plc(before, after) => {
                let rising = after.difference(*before);
                if let Some((_, id, _)) =
                    [MOVE, GRIP, RELEASE].iter().find(|(wire, ..)| rising.contains(*wire))
                {
                    asked = Some(*id);
                }
            }
            Entry::ToGripper(frame) => {
                let id = CommandId::from_code(frame[3]);
                if id.kind() == Kind::Motion && asked.take() != Some(id) {
                    bail!("{id} was sent without an edge, or twice");
                }
            }
            Entry::Note(note) => bail!("{note}"),
            _ => {}
        }
    }
    Ok(())
}
