//! The events for pages: what has changed since the last time.

use super::age::as_of;
use super::bench::Bench;
use super::json::{Json, object};
use super::latest_script::ScriptReport;
use super::state::{self, static_data};
use crate::time::Time;

/// Interval of the heartbeat to pages while nothing changes. A page shows after a second that it receives nothing.
const HEARTBEAT_MS: u64 = 200;

/// Kind and JSON of an event.
pub(crate) type Event = (&'static str, String);

/// Returns the event with which each page begins: the static data.
pub(crate) fn hello(bench: &Bench) -> Event {
    ("hello", static_data(bench))
}

/// What the open pages know.
#[derive(Debug, Default)]
pub(crate) struct Publisher {
    /// The next entry of the system log, frame of the editor, and line of the script.
    next_entry: u64,
    next_frame: u64,
    next_line: u64,
    script: Option<ScriptReport>,
    settings: u64,
    /// The latest state, and when the next one is due.
    state: String,
    due: Time,
}

impl Publisher {
    /// Begins with the first page.
    pub(crate) fn begin(&mut self, bench: &mut Bench) {
        bench.watch_log(true);
        // A page that opens reads the settings by itself.
        self.settings = bench.settings_revision();
        self.state.clear();
    }

    /// Returns the events that are due now.
    pub(crate) fn events(&mut self, bench: &mut Bench, now: Time) -> Vec<Event> {
        let mut events = Vec::new();
        let report = bench.report(now);
        let state = state::of(bench, &report, None);
        if state != self.state || now >= self.due {
            let json =
                object! { "time_s": report.now, "as_of": as_of(bench, report.now), "state": Json(&state) };
            events.push(("state", json));
            (self.state, self.due) = (state, now.plus_millis(HEARTBEAT_MS));
        }
        let entries = bench.system_log().entries_from(self.next_entry);
        if let Some(latest) = entries.last() {
            self.next_entry = latest.number + 1;
            events.push(("system_log", object! { "entries": entries }));
        }
        let frames = bench.frames_from(self.next_frame);
        if let Some(latest) = frames.last() {
            self.next_frame = latest.number + 1;
            events.push(("editor", object! { "frames": frames }));
        }
        let (report, lines) = bench.script.report(self.next_line);
        if !lines.is_empty() || self.script.as_ref() != Some(&report) {
            self.next_line = lines.last().map_or(self.next_line, |line| line.number + 1);
            events.push(("script", object! { "latest": report, "lines": lines }));
            self.script = Some(report);
        }
        if self.settings != bench.settings_revision() {
            self.settings = bench.settings_revision();
            events.push(("settings", object! { "revision": self.settings }));
        }
        let log = bench.take_watched();
        if !log.lines.is_empty() {
            events.push(("log", object! { "lines": log.lines, "lost": log.lost }));
        }
        events
    }
}
