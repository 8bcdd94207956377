//! The system log: what happened to the gripper, with time, severity and source (command set, 3.2.4 and 3.3.8).
//!
//! It holds operator events, not frames; those are in the [`Log`](super::log::Log).

use super::json::{ToJson, members};
use super::log::Sink;
use crate::text::one_line;
use crate::time::Time;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Maximum number of entries in memory. A further entry replaces the oldest.
const MAX_ENTRIES: usize = 500;
/// Maximum length of a text in characters. A script or a file name can be longer.
const MAX_TEXT_LEN: usize = 300;

/// How much an entry matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Severity {
    Info,
    /// Someone must look: motion is locked or a limit is near.
    Warning,
    /// A fault, or a connection lost without an announcement.
    Error,
}

impl Severity {
    const fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

impl ToJson for Severity {
    fn write(&self, json: &mut String) {
        self.name().write(json);
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Entry {
    /// Counts all entries since the start of the program.
    pub(crate) number: u64,
    /// Date and time of the system, in UTC.
    pub(crate) date: String,
    /// Seconds since power-up.
    pub(crate) time_s: Time,
    pub(crate) severity: Severity,
    /// The origin, such as `tcp 127.0.0.1:50124`, `page` or `script`.
    pub(crate) source: String,
    pub(crate) text: String,
}
members!(Entry: number, date, time_s, severity, source, text);

impl std::fmt::Display for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { date, time_s, severity, source, text, .. } = self;
        let millis = (time_s.as_micros() + 500) / 1_000;
        let (seconds, millis) = (millis / 1_000, millis % 1_000);
        write!(f, "{date} {seconds}.{millis:03} s {:7} {source}: {text}", severity.name())
    }
}

/// The log, shared by everything that writes to it. It outlives a restart of the gripper.
#[derive(Clone, Debug)]
pub(crate) struct SystemLog(Arc<Mutex<Entries>>);

/// Returns date and time in UTC, to the second.
pub(crate) type Date = fn() -> String;

struct Entries {
    entries: VecDeque<Entry>,
    next: u64,
    date: Date,
    file: Option<Sink>,
}

impl SystemLog {
    /// Creates a log that takes its dates from `date`, and also appends its entries to `file`.
    pub(crate) fn new(date: Date, file: Option<Sink>) -> Self {
        Self(Arc::new(Mutex::new(Entries { entries: VecDeque::new(), next: 0, date, file })))
    }

    pub(crate) fn write(&self, now: Time, severity: Severity, source: &str, text: &str) {
        let mut entries = self.lock();
        let entry = Entry {
            number: entries.next,
            date: (entries.date)(),
            time_s: now,
            severity,
            source: one_line(source).into_owned(),
            text: one_line(&text.chars().take(MAX_TEXT_LEN).collect::<String>()).into_owned(),
        };
        entries.next += 1;
        if let Some(file) = &mut entries.file {
            file(format!("{entry}\n"));
        }
        if entries.entries.len() >= MAX_ENTRIES {
            entries.entries.pop_front();
        }
        entries.entries.push_back(entry);
    }

    /// Returns the entries from this number on, oldest first.
    pub(crate) fn entries_from(&self, number: u64) -> Vec<Entry> {
        self.lock().entries.iter().filter(|entry| entry.number >= number).cloned().collect()
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl std::fmt::Debug for Entries {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Entries").field("next", &self.next).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oldest_entries_give_way_and_numbers_continue() {
        let log = SystemLog::new(String::new, None);
        for number in 0..MAX_ENTRIES as u64 + 3 {
            log.write(Time::from_millis(number), Severity::Info, "page", &format!("entry {number}"));
        }
        let entries = log.entries_from(0);
        assert_eq!((entries.len(), entries[0].number), (MAX_ENTRIES, 3));
        let latest = log.entries_from(MAX_ENTRIES as u64 + 2);
        assert_eq!((latest.len(), &latest[0].text[..]), (1, "entry 502"));
    }
}
