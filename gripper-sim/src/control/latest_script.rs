//! The script that runs on the gripper or ran last: its state and its output.

use super::json::{members, names};
use std::collections::VecDeque;

/// Maximum number of lines of output that are kept.
const MAX_LINES: usize = 200;

/// Identifies one run of a script. Only the latest run has access to the gripper.
pub(crate) type Run = u64;

/// The script that runs or ran last.
#[derive(Debug, Default)]
pub(crate) struct LatestScript {
    pub(crate) run: Run,
    pub(crate) report: ScriptReport,
    pub(crate) output: VecDeque<OutputLine>,
    /// The number of the next line of output.
    pub(crate) next_line: u64,
}

/// The state of the latest script.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct ScriptReport {
    /// Grows with each change, so that an answer and an event can be put in order.
    pub(crate) revision: u64,
    /// Empty before the first script.
    pub(crate) name: String,
    pub(crate) state: RunState,
    /// The error that ended the script.
    pub(crate) error: Option<String>,
    /// The line of that error, if it is in the script.
    pub(crate) line: Option<u32>,
}
members!(ScriptReport: revision, name, state, error, line);

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum RunState {
    #[default]
    None,
    Running,
    Ended,
    Stopped,
    Failed,
}
names!(RunState: None "none", Running "running", Ended "ended", Stopped "stopped", Failed "failed");

/// A line of output.
#[derive(Clone, Debug)]
pub(crate) struct OutputLine {
    pub(crate) number: u64,
    pub(crate) text: String,
}
members!(OutputLine: number, text);

impl LatestScript {
    /// Keeps a line of output for pages.
    pub(crate) fn keep(&mut self, text: &str) {
        if self.output.len() >= MAX_LINES {
            self.output.pop_front();
        }
        self.output.push_back(OutputLine { number: self.next_line, text: text.to_owned() });
        self.next_line += 1;
    }

    /// Returns the state of the script, and its output from this line on.
    pub(crate) fn report(&self, from: u64) -> (ScriptReport, Vec<OutputLine>) {
        let report = ScriptReport { revision: self.run, ..self.report.clone() };
        (report, self.output.iter().filter(|line| line.number >= from).cloned().collect())
    }
}
