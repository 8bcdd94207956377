//! Board, gripper and PLC together: what a machine builder has on the bench.

use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, Kind};
use wsg_sim::Config;

use crate::emulator::{Emulator, OutputChange};
use crate::gripper_end::GripperEnd;
use crate::trace::{Entry, Trace, frame_id};

/// How long anything may take that is not a motion: connecting, a reconnect, an acknowledgement.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// How long a motion may take, at the real gripper's speed.
pub const MOTION_PATIENCE: Duration = Duration::from_secs(120);

/// How long an acknowledgement may take before it is given again.
pub const ACKNOWLEDGED_WITHIN: Duration = Duration::from_secs(2);

/// How long a wire is held so that the bridge counts it, in the board's milliseconds: 2 ms of debouncing, 5 ms until
/// FAST_STOP_OK counts as high, and the turn of the main loop before and after.
const HOLD_MS: u32 = 8;

/// The bench.
#[derive(Debug)]
pub struct Rig {
    board: Emulator,
    gripper: GripperEnd,
    trace: Trace,
    /// Changes of the bridge's wires that the PLC has not looked at yet, and how they were at the last one.
    changes: Mutex<(Receiver<OutputChange>, Outputs)>,
}

impl std::fmt::Debug for GripperEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GripperEnd").finish_non_exhaustive()
    }
}

impl Rig {
    /// Powers board and gripper. The PLC is not there yet: all its wires are low, the one of FAST STOP as well.
    ///
    /// # Errors
    /// When the emulator does not start.
    pub fn power_up(elf: &Path, config: Config, trace: Trace) -> Result<Self> {
        let mut board = Emulator::start(elf)?;
        let line = board.take_gripper_line().context("the board's line was taken")?;
        let gripper = GripperEnd::start(line, board.clock(), config, &trace)?;
        let changes = Mutex::new((board.output_changes(), Outputs::empty()));
        let (traced, watched) = (trace.clone(), board.output_changes());
        thread::spawn(move || {
            let mut before = Outputs::empty();
            for change in watched {
                traced.add(Entry::Bridge(before, change.outputs));
                before = change.outputs;
            }
        });
        Ok(Self { board, gripper, trace, changes })
    }

    /// The board.
    #[must_use]
    pub fn board(&self) -> &Emulator {
        &self.board
    }

    /// The gripper and its line.
    #[must_use]
    pub fn gripper(&self) -> &GripperEnd {
        &self.gripper
    }

    /// The recording.
    #[must_use]
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// Sets wires of the PLC high or low.
    ///
    /// # Errors
    /// When the board is off.
    pub fn set(&self, wires: Inputs, high: bool) -> Result<()> {
        let before = self.board.inputs();
        let after = if high { before | wires } else { before - wires };
        if before != after {
            self.trace.add(Entry::Plc(before, after));
        }
        self.board.set_input(wires, high)
    }

    /// Lets the board's clock advance by `ms` milliseconds.
    ///
    /// # Errors
    /// When the board is off, or its clock stands still.
    pub fn pass(&self, ms: u32) -> Result<()> {
        let start = self.board.now_ms()?;
        let bound = Instant::now() + PATIENCE + Duration::from_millis(ms.into());
        while self.board.now_ms()?.wrapping_sub(start) <= ms {
            ensure!(Instant::now() < bound, "the board's clock stands still");
        }
        Ok(())
    }

    /// Raises wires for long enough to count, and lowers them for as long.
    ///
    /// # Errors
    /// When the board is off.
    pub fn pulse(&self, wires: Inputs) -> Result<()> {
        self.set(wires, true)?;
        self.pass(HOLD_MS)?;
        self.set(wires, false)?;
        self.pass(HOLD_MS)
    }

    /// Selects a recipe, 0 to 3.
    ///
    /// # Errors
    /// When the board is off.
    pub fn select_recipe(&self, number: u8) -> Result<()> {
        self.set(Inputs::RECIPE0, number & 1 != 0)?;
        self.set(Inputs::RECIPE1, number & 2 != 0)
    }

    /// Follows the bridge's wires, from where the PLC looked last, until they are as `wanted`; none of their states is
    /// skipped. At once when the last one was as wanted. Returns the state.
    ///
    /// # Errors
    /// When `timeout` passes first, or the board goes off.
    pub fn await_outputs(&self, timeout: Duration, wanted: impl Fn(Outputs) -> bool) -> Result<Outputs> {
        let mut changes = self.changes.lock().unwrap_or_else(PoisonError::into_inner);
        let (receiver, current) = &mut *changes;
        let bound = Instant::now() + timeout;
        while !wanted(*current) {
            *current = match receiver.recv_timeout(bound.saturating_duration_since(Instant::now())) {
                Ok(change) => change.outputs,
                Err(RecvTimeoutError::Timeout) => bail!("waited {timeout:?}; high are {}", names(*current)),
                Err(RecvTimeoutError::Disconnected) => bail!("the board went off"),
            };
        }
        Ok(*current)
    }

    /// Gives a motion command as a PLC does: the wire up, until BUSY says that it is taken; then waits for the end.
    /// Returns the bridge's wires at the end.
    ///
    /// # Errors
    /// When the bridge is not READY before, does not take the command, or does not end it in time.
    pub fn command(&self, wire: Inputs) -> Result<Outputs> {
        self.begin(wire)?;
        self.await_outputs(MOTION_PATIENCE, |outputs| !outputs.contains(Outputs::BUSY))
            .with_context(|| format!("{} does not end", input_names(wire)))
    }

    /// The first half of [`command`](Self::command): up to BUSY.
    ///
    /// # Errors
    /// As [`command`](Self::command).
    pub fn begin(&self, wire: Inputs) -> Result<()> {
        let named = input_names(wire);
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::READY))
            .with_context(|| format!("not READY for {named}"))?;
        self.set(wire, true)?;
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::BUSY))
            .with_context(|| format!("{named} is not taken"))?;
        self.set(wire, false)?;
        self.pass(HOLD_MS)
    }

    /// Raises the wire of FAST STOP, [acknowledges](Self::acknowledge), and waits for READY.
    ///
    /// # Errors
    /// When it does not in time.
    pub fn release_fast_stop(&self) -> Result<()> {
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).context("no link")?;
        self.set(Inputs::FAST_STOP_OK, true)?;
        self.pass(HOLD_MS)?;
        self.acknowledge()?;
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::READY))
            .context("not READY after the acknowledgement")?;
        Ok(())
    }

    /// Acknowledges an error or a FAST STOP as a PLC does: raises STOP_ACK until ERROR is low, and again when it stays high.
    ///
    /// # Errors
    /// When ERROR stays high.
    pub fn acknowledge(&self) -> Result<()> {
        let bound = Instant::now() + PATIENCE;
        loop {
            self.set(Inputs::STOP_ACK, true)?;
            let outputs =
                self.await_outputs(ACKNOWLEDGED_WITHIN, |outputs| !outputs.contains(Outputs::ERROR));
            self.set(Inputs::STOP_ACK, false)?;
            match outputs {
                Ok(_) => return Ok(()),
                // On a busy host the edge may come before the FAST STOP is confirmed, and counts for nothing then.
                Err(_) if Instant::now() < bound => self.pass(HOLD_MS)?,
                Err(error) => return Err(error).context("STOP_ACK does not end ERROR"),
            }
        }
    }

    /// Waits until the recording has everything that the bridge has sent and shown so far. Its regular questions come at
    /// least every 250 ms while it is connected or tries to be, and what it sent before comes before them.
    ///
    /// # Errors
    /// When the bridge falls silent.
    pub fn catch_up(&self) -> Result<()> {
        let mark = self.trace.mark();
        let seen = self.trace.wait(mark, PATIENCE, |entry| matches!(entry, Entry::ToGripper(_)));
        ensure!(seen, "the bridge has fallen silent");
        let changes = self.board.output_changes().try_iter().count();
        let seen =
            self.trace.wait_for_count(0, changes, PATIENCE, |entry| matches!(entry, Entry::Bridge(..)));
        ensure!(seen, "the recording lags behind");
        Ok(())
    }

    /// The motion commands that the bridge has sent since `mark`.
    ///
    /// # Errors
    /// When the bridge falls silent.
    pub fn motions_since(&self, mark: usize) -> Result<Vec<CommandId>> {
        self.catch_up()?;
        Ok(motions(&self.trace.since(mark)))
    }
}

/// The motion commands among these entries.
#[must_use]
pub fn motions(entries: &[Entry]) -> Vec<CommandId> {
    entries
        .iter()
        .filter_map(|entry| match entry {
            Entry::ToGripper(bytes) => frame_id(bytes).map(CommandId::from_code),
            _ => None,
        })
        .filter(|id| id.kind() == Kind::Motion)
        .collect()
}

/// `[READY, LINK_OK]`.
#[must_use]
pub fn names(outputs: Outputs) -> String {
    let names: Vec<&str> = outputs.iter_names().map(|(name, _)| name).collect();
    format!("[{}]", names.join(", "))
}

fn input_names(inputs: Inputs) -> String {
    let names: Vec<&str> = inputs.iter_names().map(|(name, _)| name).collect();
    names.join("+")
}
