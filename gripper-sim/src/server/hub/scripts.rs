//! What the gripper knows about its script: one at a time, in a thread of its own, with its output and how it ended.

use super::{Hub, PAGE, SCRIPT, Shared, lock};
use crate::port::PortId;
use crate::script::{ScriptRequest, ScriptState};
use crate::server::system_log::Severity;
use serde::Serialize;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::PoisonError;
use tokio::time::Duration;

/// Maximum number of lines of output that are kept.
const MAX_LINES: usize = 200;

/// Identifies one run of a script. Only the latest run has access to the gripper.
pub(in crate::server) type Run = u64;

/// The script that runs or ran last.
#[derive(Debug, Default)]
pub(super) struct LatestScript {
    run: Run,
    report: ScriptReport,
    output: VecDeque<OutputLine>,
    /// The number of the next line of output.
    next_line: u64,
}

/// The state of the latest script.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(in crate::server) struct ScriptReport {
    /// Grows with each change, so that an answer and an event can be put in order.
    revision: u64,
    /// Empty before the first script.
    name: String,
    state: RunState,
    /// The error that ended the script.
    error: Option<String>,
    /// The line of that error, if it is in the script.
    line: Option<u32>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum RunState {
    #[default]
    None,
    Running,
    Ended,
    Stopped,
    Failed,
}

/// A line of output.
#[derive(Clone, Debug, Serialize)]
pub(in crate::server) struct OutputLine {
    pub(in crate::server) number: u64,
    text: String,
}

impl Hub {
    /// Begins a run. It ends the earlier one, if that still runs.
    pub(in crate::server) fn begin_script(&self, name: &str) -> Run {
        self.stop_script();
        let mut shared = self.lock();
        let latest = &mut shared.script;
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
        let report = &mut shared.script.report;
        report.state = if error.is_some() { RunState::Failed } else { RunState::Ended };
        report.error = error.map(str::to_owned);
        report.line = error.and_then(|error| line_of(&report.name, error));
        shared.script.run += 1;
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
        let latest = &mut shared.script;
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
        let LatestScript { output, next_line, .. } = &mut self.lock().script;
        if output.len() >= MAX_LINES {
            output.pop_front();
        }
        output.push_back(OutputLine { number: *next_line, text: text.to_owned() });
        *next_line += 1;
    }

    /// Returns the state of the latest script, and its output from this line on.
    pub(in crate::server) fn script_report(&self, from: u64) -> (ScriptReport, Vec<OutputLine>) {
        let shared = self.lock();
        let LatestScript { run, report, output, .. } = &shared.script;
        let report = ScriptReport { revision: *run, ..report.clone() };
        (report, output.iter().filter(|line| line.number >= from).cloned().collect())
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
            if let Some(request) = shared.gripper.take_script_request() {
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
        let shared = self.lock();
        let mut clients = shared.clients.values();
        let client = clients.clone().find(|client| Some(client.id) == id);
        let client = client.or_else(|| clients.find(|client| client.kind.is_binary()));
        client.map(|client| (client.id, client.kind.to_string()))
    }
}

fn is_over(shared: &Shared, run: Run) -> bool {
    shared.is_off || shared.script.run != run
}

/// Returns the line of an error in this script: `NAME:LINE: TEXT`.
fn line_of(name: &str, error: &str) -> Option<u32> {
    error.strip_prefix(name)?.strip_prefix(':')?.split(':').next()?.parse().ok()
}
