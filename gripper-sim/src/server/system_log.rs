//! The system log: what happened to the gripper, with time, severity and source (command set, 3.2.4 and 3.3.8).
//!
//! It holds operator events, not frames; those are in the [`Log`](super::Log).

use super::log_writer::LogWriter;
use crate::text::one_line;
use crate::time::Time;
use ::time::OffsetDateTime;
use ::time::format_description::well_known::Rfc3339;
use anyhow::{Context, Result};
use serde::Serialize;
use std::collections::VecDeque;
use std::fs::OpenOptions;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Maximum number of entries in memory. A further entry replaces the oldest.
const MAX_ENTRIES: usize = 500;
/// Maximum length of a text in characters. A script or a file name can be longer.
const MAX_TEXT_LEN: usize = 300;

/// How much an entry matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Severity {
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

#[derive(Clone, Debug, Serialize)]
pub(super) struct Entry {
    /// Counts all entries since the start of the program.
    pub(super) number: u64,
    /// Date and time of the system, in UTC.
    pub(super) date: String,
    /// Seconds since power-up.
    pub(super) time_s: f64,
    pub(super) severity: Severity,
    /// The origin, such as `tcp 127.0.0.1:50124`, `page` or `script`.
    pub(super) source: String,
    pub(super) text: String,
}

impl std::fmt::Display for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { date, time_s, severity, source, text, .. } = self;
        write!(f, "{date} {time_s:.3} s {:7} {source}: {text}", severity.name())
    }
}

/// The log, shared by everything that writes to it. It outlives a restart of the gripper.
#[derive(Clone, Debug, Default)]
pub(super) struct SystemLog(Arc<Mutex<Entries>>);

#[derive(Default)]
struct Entries {
    entries: VecDeque<Entry>,
    next: u64,
    file: Option<LogWriter>,
}

impl SystemLog {
    /// Creates a log that also appends its entries to this file, if one is given.
    ///
    /// # Errors
    /// Returns an error if the file cannot be opened.
    pub(super) fn open(path: Option<&Path>) -> Result<Self> {
        let Some(path) = path else { return Ok(Self::default()) };
        let file = OpenOptions::new().create(true).append(true).open(path);
        let file = file.with_context(|| format!("the system log {} cannot be written", path.display()))?;
        let entries = Entries { file: Some(LogWriter::new(file)), ..Entries::default() };
        Ok(Self(Arc::new(Mutex::new(entries))))
    }

    pub(super) fn write(&self, now: Time, severity: Severity, source: &str, text: &str) {
        let date = OffsetDateTime::now_utc().replace_nanosecond(0).unwrap_or(OffsetDateTime::UNIX_EPOCH);
        let mut entries = self.lock();
        let entry = Entry {
            number: entries.next,
            date: date.format(&Rfc3339).unwrap_or_default(),
            time_s: now.as_micros() as f64 / 1e6,
            severity,
            source: one_line(source).into_owned(),
            text: one_line(&text.chars().take(MAX_TEXT_LEN).collect::<String>()).into_owned(),
        };
        entries.next += 1;
        if let Some(file) = &mut entries.file {
            file.write(format!("{entry}\n"));
        }
        if entries.entries.len() >= MAX_ENTRIES {
            entries.entries.pop_front();
        }
        entries.entries.push_back(entry);
    }

    /// Returns the entries from this number on, oldest first.
    pub(super) fn entries_from(&self, number: u64) -> Vec<Entry> {
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
        let log = SystemLog::default();
        for number in 0..MAX_ENTRIES as u64 + 3 {
            log.write(Time::from_millis(number), Severity::Info, "page", &format!("entry {number}"));
        }
        let entries = log.entries_from(0);
        assert_eq!((entries.len(), entries[0].number), (MAX_ENTRIES, 3));
        let latest = log.entries_from(MAX_ENTRIES as u64 + 2);
        assert_eq!((latest.len(), &latest[0].text[..]), (1, "entry 502"));
    }

    #[test]
    fn file_is_appended_to_and_holds_one_line_for_each_entry() {
        let path = std::env::temp_dir().join(format!("wsg-system-log-{}", std::process::id()));
        std::fs::write(&path, "before\n").unwrap();
        let log = SystemLog::open(Some(&path)).unwrap();
        log.write(Time::from_millis(1_500), Severity::Warning, "script", "two\nlines\u{1b}[2J");
        // Dropping the log writes the rest.
        drop(log);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let (before, line) = text.split_once('\n').unwrap();
        assert_eq!(before, "before");
        assert!(line.ends_with("Z 1.500 s warning script: two\\nlines\\u{1b}[2J\n"), "{line}");
        assert!(SystemLog::open(Some(Path::new("/no/such/folder/log"))).is_err());
    }
}
