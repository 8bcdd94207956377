//! What the gripper knows about its script: one at a time, in a thread of its own, with its output and how it ended.

use super::{Hub, Shared, lock};
pub(in crate::server) use crate::control::{OutputLine, Run, ScriptReport};
use crate::control::{PAGE, RunState, SCRIPT, Severity};
use crate::port::PortId;
use crate::script::{ScriptRequest, ScriptState};
use std::path::PathBuf;
use std::sync::PoisonError;
use tokio::time::Duration;

impl Hub {
    /// Begins a run. It ends the earlier one, if that still runs.
    pub(in crate::server) fn begin_script(&self, name: &str) -> Run {
        self.stop_script();
        let mut shared = self.lock();
        let latest = &mut shared.bench.script;
        latest.run += 1;
        latest.output.clear();
        latest.report =
            ScriptReport { name: name.to_owned(), state: RunState::Running, ..ScriptReport::default() };
        let run = latest.run;
        drop(shared);
        self.report_event(Severity::Info, SCRIPT, &format!("{name} started"));
        self.act(|gripper, now| gripper.set_script_state(ScriptState::Running, now));
        run
    }

    /// Ends a run that has come to its end by itself, or by an error. Does nothing if it is over already.
    pub(in crate::server) fn end_script(&self, run: Run, error: Option<&str>) {
        let mut shared = self.lock();
        if is_over(&shared, run) {
            return;
        }
        let report = &mut shared.bench.script.report;
        report.state = if error.is_some() { RunState::Failed } else { RunState::Ended };
        report.error = error.map(str::to_owned);
        report.line = error.and_then(|error| line_of(&report.name, error));
        shared.bench.script.run += 1;
        drop(shared);
        let (severity, text) = match error {
            None => (Severity::Info, "ended".to_owned()),
            Some(error) => (Severity::Error, format!("failed: {error}")),
        };
        self.note_of(SCRIPT, format_args!("{text}"));
        self.report_event(severity, SCRIPT, &text);
        let state = if error.is_some() { ScriptState::Failed } else { ScriptState::None };
        self.act(|gripper, now| gripper.set_script_state(state, now));
    }

    /// Stops the running script at its next call. Returns whether one ran.
    pub(in crate::server) fn stop_script(&self) -> bool {
        let _gate = lock(&self.script_gate);
        let mut shared = self.lock();
        let latest = &mut shared.bench.script;
        if latest.report.state != RunState::Running {
            return false;
        }
        latest.report.state = RunState::Stopped;
        latest.run += 1;
        let text = format!("{} stopped", latest.report.name);
        drop(shared);
        self.script_waits.notify_all();
        self.report_event(Severity::Info, PAGE, &text);
        self.act(|gripper, now| gripper.set_script_state(ScriptState::None, now));
        true
    }

    /// Calls `act`, which must not block, for a run; `None` once the run is over.
    pub(in crate::server) fn act_for_script<T>(&self, run: Run, act: impl FnOnce(&Self) -> T) -> Option<T> {
        let _gate = lock(&self.script_gate);
        (!self.script_is_over(run)).then(|| act(self))
    }

    /// Returns whether a run is over, because the script was stopped or the gripper is powered off.
    pub(in crate::server) fn script_is_over(&self, run: Run) -> bool {
        is_over(&self.lock(), run)
    }

    /// Writes a line of output to the log, and keeps it for pages.
    pub(in crate::server) fn script_output(&self, text: &str) {
        self.note_of(SCRIPT, format_args!("{text}"));
        self.lock().bench.script.keep(text);
    }

    /// Returns the state of the latest script, and its output from this line on.
    pub(in crate::server) fn script_report(&self, from: u64) -> (ScriptReport, Vec<OutputLine>) {
        self.lock().bench.script.report(from)
    }

    /// Returns the folder with the scripts that the page may use.
    pub(in crate::server) fn script_folder(&self) -> Option<PathBuf> {
        super::lock(self.running.as_ref()?).options.lines.scripts.clone()
    }

    /// Returns the script that runs at the start.
    pub(in crate::server) fn start_up_script(&self) -> Option<PathBuf> {
        super::lock(self.running.as_ref()?).options.lines.script.clone()
    }

    /// Blocks until there is a request for the script; `None` once the run is over.
    pub(in crate::server) fn script_request(&self, run: Run) -> Option<ScriptRequest> {
        let mut shared = self.lock();
        loop {
            if is_over(&shared, run) {
                return None;
            }
            if let Some(request) = shared.bench.gripper_mut().take_script_request() {
                return Some(request);
            }
            shared = self.script_waits.wait(shared).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Blocks for `duration`, or until the run is over.
    pub(in crate::server) fn script_sleeps(&self, run: Run, duration: Duration) {
        let is_running = |shared: &mut Shared| !is_over(shared, run);
        // Neither the guard nor the time-out flag is needed.
        drop(self.script_waits.wait_timeout_while(self.lock(), duration, is_running));
    }

    /// Returns this client and its interface, or, after its end, the first client of the binary protocol and its interface.
    pub(in crate::server) fn script_client(&self, id: Option<PortId>) -> Option<(PortId, String)> {
        self.lock().bench.script_client(id)
    }
}

fn is_over(shared: &Shared, run: Run) -> bool {
    shared.bench.is_off || shared.bench.script.run != run
}

/// Returns the line of an error in this script: `NAME:LINE: TEXT`.
fn line_of(name: &str, error: &str) -> Option<u32> {
    error.strip_prefix(name)?.strip_prefix(':')?.split(':').next()?.parse().ok()
}
