//! Where the system log is written, and the date of its entries.

pub(super) use crate::control::{Severity, SystemLog};

use super::log_writer::LogWriter;
use ::time::OffsetDateTime;
use ::time::format_description::well_known::Rfc3339;
use anyhow::{Context, Result};
use std::fs::OpenOptions;
use std::path::Path;

/// Creates a log that also appends its entries to this file, if one is given.
///
/// # Errors
/// Returns an error if the file cannot be opened.
pub(super) fn open(path: Option<&Path>) -> Result<SystemLog> {
    let file = path.map(|path| {
        let file = OpenOptions::new().create(true).append(true).open(path);
        let file = file.with_context(|| format!("the system log {} cannot be written", path.display()))?;
        anyhow::Ok(LogWriter::sink(file))
    });
    Ok(SystemLog::new(date, file.transpose()?))
}

fn date() -> String {
    let date = OffsetDateTime::now_utc().replace_nanosecond(0).unwrap_or(OffsetDateTime::UNIX_EPOCH);
    date.format(&Rfc3339).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Time;

    #[test]
    fn file_is_appended_to_and_holds_one_line_for_each_entry() {
        let path = std::env::temp_dir().join(format!("wsg-system-log-{}", std::process::id()));
        std::fs::write(&path, "before\n").unwrap();
        let log = open(Some(&path)).unwrap();
        log.write(Time::from_millis(1_500), Severity::Warning, "script", "two\nlines\u{1b}[2J");
        // Dropping the log writes the rest.
        drop(log);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let (before, line) = text.split_once('\n').unwrap();
        assert_eq!(before, "before");
        assert!(line.ends_with("Z 1.500 s warning script: two\\nlines\\u{1b}[2J\n"), "{line}");
        assert!(open(Some(Path::new("/no/such/folder/log"))).is_err());
    }
}
