//! Where the log is written: standard output, a file, or any writer, in a thread of its own.

pub use crate::control::Log;

use super::log_writer::LogWriter;
use anyhow::{Context, Result};
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

impl Log {
    /// Creates a log with this output, written in a separate thread so that a slow reader does not delay the gripper.
    /// Lines without room are dropped, and their number is logged.
    #[must_use]
    pub fn to(output: impl Write + Send + 'static) -> Self {
        Self::new(Some(LogWriter::sink(output)))
    }

    /// Creates a log on standard output.
    #[must_use]
    pub fn to_stdout() -> Self {
        Self::to(io::stdout())
    }

    /// Creates a log in this file and truncates it.
    ///
    /// # Errors
    /// Returns an error if the file cannot be created.
    pub fn to_file(path: &Path) -> Result<Self> {
        let file =
            File::create(path).with_context(|| format!("the log {} cannot be written", path.display()))?;
        Ok(Self::to(file))
    }
}
