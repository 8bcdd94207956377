//! Emulated board, gripper and PLC together, as on a machine builder's desk.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, Kind};
use wsg_sim::Config;

use crate::emulator::{Emulator, OutputChange};
use crate::gripper_end::GripperEnd;
use crate::modbus_master::Master;
use crate::socket::Socket;
use crate::trace::{Entry, Trace};

/// Time limit for everything except motions: connecting, reconnecting, acknowledging.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Time limit for a motion at the real gripper's speed.
pub const MOTION_PATIENCE: Duration = Duration::from_secs(120);

/// Time after which an unanswered acknowledgement is repeated.
pub const ACKNOWLEDGED_WITHIN: Duration = Duration::from_secs(2);

/// Milliseconds on the board's clock for which a wire is held to be recognized: 2 ms of debouncing, 5 ms until
/// FAST_STOP_OK counts as high, and one turn of the main loop before and after.
const HOLD_MS: u32 = 8;

thread_local! {
    /// Whether a rig of this thread has lost its link in a test that failed, because the machine withheld the harness.
    static IS_DISTURBED: Cell<bool> = const { Cell::new(false) };
}

/// When a thread of the harness continued the last time that the machine had withheld it.
static WITHHELD: LazyLock<Mutex<Option<Instant>>> = LazyLock::new(|| {
    thread::spawn(|| {
        loop {
            let start = Instant::now();
            thread::sleep(Duration::from_millis(1));
            if start.elapsed() > QUIET {
                *withheld() = Some(Instant::now());
            }
        }
    });
    Mutex::new(None)
});

fn withheld() -> MutexGuard<'static, Option<Instant>> {
    WITHHELD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Longest time for which a machine withholds a thread if it does not disturb a test.
const QUIET: Duration = Duration::from_millis(50);

/// Runs a test, and again if it fails on a machine that withholds the harness, and with it the gripper, so that the bridge rightly loses
/// the link. At most five times.
pub fn unless_disturbed(test: impl Fn()) {
    for _ in 1..5 {
        IS_DISTURBED.set(false);
        match catch_unwind(AssertUnwindSafe(&test)) {
            Ok(()) => return,
            Err(_) if IS_DISTURBED.get() => {}
            Err(panic) => resume_unwind(panic),
        }
    }
    test();
}

/// The test rig.
#[derive(Debug)]
pub struct Rig {
    started: Instant,
    board: Emulator,
    gripper: GripperEnd,
    trace: Trace,
    /// Changes of the bridge's outputs that the PLC has not processed, and the outputs before them.
    changes: Mutex<(Receiver<OutputChange>, Outputs)>,
}

impl std::fmt::Debug for GripperEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GripperEnd").finish_non_exhaustive()
    }
}

impl Rig {
    /// Connects a gripper to a board that is on: to this line, or without one to the board's serial line. The PLC is off, so all
    /// its wires are low, including FAST_STOP_OK.
    ///
    /// # Errors
    /// Fails when the board's line is already taken.
    pub fn of(mut board: Emulator, line: Option<Socket>, config: Config, trace: Trace) -> Result<Self> {
        let line = line.or_else(|| board.take_gripper_line()).context("the board's line is already taken")?;
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
        LazyLock::force(&WITHHELD);
        Ok(Self { started: Instant::now(), board, gripper, trace, changes })
    }

    /// Returns the board.
    #[must_use]
    pub fn board(&self) -> &Emulator {
        &self.board
    }

    /// Returns the board, to take a line.
    pub fn board_mut(&mut self) -> &mut Emulator {
        &mut self.board
    }

    /// Returns a Modbus master on the board's bus, for this unit.
    ///
    /// # Errors
    /// Fails when the bus is already taken.
    pub fn master(&mut self, unit: u8) -> Result<Master> {
        let line = self.board.take_modbus_line().context("the board's bus is already taken")?;
        Ok(Master::new(line, self.board.clock(), unit))
    }

    /// Returns the gripper and its line.
    #[must_use]
    pub fn gripper(&self) -> &GripperEnd {
        &self.gripper
    }

    /// Returns the recording.
    #[must_use]
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// Sets PLC wires high or low.
    ///
    /// # Errors
    /// Fails when the board is off.
    pub fn set(&self, wires: Inputs, high: bool) -> Result<()> {
        let before = self.board.inputs();
        let after = if high { before | wires } else { before - wires };
        if before != after {
            self.trace.add(Entry::Plc(before, after));
        }
        self.board.set_input(wires, high)
    }

    /// Waits until the board's clock has advanced by `ms` milliseconds.
    ///
    /// # Errors
    /// Fails when the board is off or its clock has stopped.
    pub fn pass(&self, ms: u32) -> Result<()> {
        let start = self.board.now_ms()?;
        let bound = Instant::now() + PATIENCE + Duration::from_millis(ms.into());
        while self.board.now_ms()?.wrapping_sub(start) <= ms {
            ensure!(Instant::now() < bound, "the board's clock has stopped");
        }
        Ok(())
    }

    /// Raises wires long enough to be recognized, and lowers them for the same time.
    ///
    /// # Errors
    /// Fails when the board is off.
    pub fn pulse(&self, wires: Inputs) -> Result<()> {
        self.set(wires, true)?;
        self.pass(HOLD_MS)?;
        self.set(wires, false)?;
        self.pass(HOLD_MS)
    }

    /// Selects a recipe, 0 to 3.
    ///
    /// # Errors
    /// Fails when the board is off.
    pub fn select_recipe(&self, number: u8) -> Result<()> {
        self.set(Inputs::RECIPE0, number & 1 != 0)?;
        self.set(Inputs::RECIPE1, number & 2 != 0)
    }

    /// Follows the outputs, without skipping a state, from the end of the previous call until one satisfies `wanted`;
    /// at once if the last one does. Returns that state.
    ///
    /// # Errors
    /// Fails after `timeout`, or when the board is switched off.
    pub fn await_outputs(&self, timeout: Duration, wanted: impl Fn(Outputs) -> bool) -> Result<Outputs> {
        let mut changes = self.changes.lock().unwrap_or_else(PoisonError::into_inner);
        let (receiver, current) = &mut *changes;
        let bound = Instant::now() + timeout;
        while !wanted(*current) {
            *current = match receiver.recv_timeout(bound.saturating_duration_since(Instant::now())) {
                Ok(change) => change.outputs,
                Err(RecvTimeoutError::Timeout) => {
                    bail!("timed out after {timeout:?}; high outputs: {}", names(*current))
                }
                Err(RecvTimeoutError::Disconnected) => bail!("the board was switched off"),
            };
        }
        Ok(*current)
    }

    /// Issues a motion command as a PLC does: raises the wire until BUSY confirms it, then waits for the end. Returns
    /// the bridge's outputs at the end.
    ///
    /// # Errors
    /// Fails when the bridge is not READY, does not accept the command, or does not complete it in time.
    pub fn command(&self, wire: Inputs) -> Result<Outputs> {
        self.begin(wire)?;
        self.await_outputs(MOTION_PATIENCE, |outputs| !outputs.contains(Outputs::BUSY))
            .with_context(|| format!("{} does not complete", input_names(wire)))
    }

    /// Returns whether LINK_OK has been low since it was high for the first time.
    fn has_lost_link(&self) -> bool {
        let changes = self.board.output_changes();
        let links = changes.try_iter().map(|change| change.outputs.contains(Outputs::LINK_OK));
        links.skip_while(|is_linked| !is_linked).any(|is_linked| !is_linked)
    }

    /// Issues a motion [`command`](Self::command), and returns at BUSY.
    ///
    /// # Errors
    /// See [`command`](Self::command).
    pub fn begin(&self, wire: Inputs) -> Result<()> {
        let named = input_names(wire);
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::READY))
            .with_context(|| format!("not READY for {named}"))?;
        self.set(wire, true)?;
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::BUSY))
            .with_context(|| format!("{named} is not accepted"))?;
        self.set(wire, false)?;
        self.pass(HOLD_MS)
    }

    /// Raises FAST_STOP_OK, [acknowledges](Self::acknowledge), and waits for READY.
    ///
    /// # Errors
    /// Fails when READY does not become high in time.
    pub fn release_fast_stop(&self) -> Result<()> {
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).context("no link")?;
        self.set(Inputs::FAST_STOP_OK, true)?;
        self.pass(HOLD_MS)?;
        self.acknowledge()?;
        self.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::READY))
            .context("not READY after the acknowledgement")?;
        Ok(())
    }

    /// Acknowledges an error or FAST STOP as a PLC does: raises STOP_ACK until ERROR is low, and repeats if
    /// necessary.
    ///
    /// # Errors
    /// Fails when ERROR stays high.
    pub fn acknowledge(&self) -> Result<()> {
        let bound = Instant::now() + PATIENCE;
        loop {
            self.set(Inputs::STOP_ACK, true)?;
            let outputs =
                self.await_outputs(ACKNOWLEDGED_WITHIN, |outputs| !outputs.contains(Outputs::ERROR));
            self.set(Inputs::STOP_ACK, false)?;
            match outputs {
                Ok(_) => return Ok(()),
                // On a busy host the edge may precede the confirmation of the FAST STOP and is then ignored.
                Err(_) if Instant::now() < bound => self.pass(HOLD_MS)?,
                Err(error) => return Err(error).context("STOP_ACK does not clear ERROR"),
            }
        }
    }

    /// Waits until the recording contains everything that the bridge has sent so far. The bridge polls at least every
    /// 250 ms, also while connecting, and earlier frames precede the next poll.
    ///
    /// # Errors
    /// Fails when the bridge stops polling.
    pub fn catch_up(&self) -> Result<()> {
        let mark = self.trace.mark();
        let seen = self.trace.wait(mark, PATIENCE, |entry| matches!(entry, Entry::ToGripper(_)));
        ensure!(seen, "the bridge has stopped polling");
        let changes = self.board.output_changes().try_iter().count();
        let seen =
            self.trace.wait_for_count(0, changes, PATIENCE, |entry| matches!(entry, Entry::Bridge(..)));
        ensure!(seen, "the recording misses output changes");
        Ok(())
    }

    /// Returns the motion commands that the bridge has sent since `mark`.
    ///
    /// # Errors
    /// Fails when the bridge stops polling.
    pub fn motions_since(&self, mark: usize) -> Result<Vec<CommandId>> {
        self.catch_up()?;
        Ok(motions(&self.trace.since(mark)))
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        if thread::panicking() && self.has_lost_link() {
            IS_DISTURBED.set(withheld().is_some_and(|at| at > self.started));
        }
    }
}

/// Returns the motion commands among these entries.
#[must_use]
pub fn motions(entries: &[Entry]) -> Vec<CommandId> {
    entries.iter().filter_map(Entry::command).filter(|id| id.kind() == Kind::Motion).collect()
}

/// Formats outputs as in `[READY, LINK_OK]`.
#[must_use]
pub fn names(outputs: Outputs) -> String {
    let names: Vec<&str> = outputs.iter_names().map(|(name, _)| name).collect();
    format!("[{}]", names.join(", "))
}

fn input_names(inputs: Inputs) -> String {
    let names: Vec<&str> = inputs.iter_names().map(|(name, _)| name).collect();
    names.join("+")
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::world::quick;

    /// Runs a test that fails on a machine that withholds the harness, and returns how many times it ran.
    fn attempts(loses_link: bool) -> u32 {
        let count = Cell::new(0);
        let failing = || {
            count.set(count.get() + 1);
            let library = Emulator::start_library().unwrap();
            let rig = Rig::of(library, None, quick(), Trace::new(vec![])).unwrap();
            rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
            if loses_link {
                rig.gripper().cut(true);
                rig.await_outputs(PATIENCE, |outputs| !outputs.contains(Outputs::LINK_OK)).unwrap();
            }
            *withheld() = Some(Instant::now());
            panic!("the test fails");
        };
        assert!(catch_unwind(AssertUnwindSafe(|| unless_disturbed(failing))).is_err());
        count.get()
    }

    #[test]
    fn lost_link_excuses_four_failures_and_a_kept_one_none() {
        assert_eq!(attempts(true), 5);
        assert_eq!(attempts(false), 1);
    }
}
