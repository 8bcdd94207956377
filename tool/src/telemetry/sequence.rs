//! bdSeq: the number that links NDEATH to NBIRTH. It increases with each connection, across restarts (Sparkplug, 6.4.5).

use std::{
    fs::{self, File},
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use wsg_sim::text;

use crate::print_error;

/// Text before the number in the file.
const KEY: &str = "bdSeq = ";

#[derive(Debug)]
pub(super) struct Sequence {
    path: PathBuf,
    next: u8,
}

impl Sequence {
    /// Reads the state file. Starts at 0 if the file is missing, or invalid, which is reported.
    ///
    /// # Errors
    /// An existing file cannot be read, or the file cannot be written.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let next = match text::read(path) {
            Ok(text) => last_of(&text).map_or_else(
                || {
                    print_error(format_args!(
                        "{} is not a valid state file (expected \"{KEY}0\" to 255); bdSeq starts at 0",
                        path.display()
                    ));
                    0
                },
                |last| last.wrapping_add(1),
            ),
            Err(error) if error.kind() == ErrorKind::NotFound => 0,
            Err(error) if error.kind() == ErrorKind::InvalidData => {
                let path = path.display();
                print_error(format_args!("{path} is not a valid state file ({error}); bdSeq starts at 0"));
                0
            }
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read the state file {}", path.display()));
            }
        };
        let sequence = Self { path: path.to_owned(), next };
        // Detect a file that cannot be written at start-up rather than on connection.
        let draft = sequence.draft();
        File::create(&draft)
            .and_then(|_| fs::remove_file(&draft))
            .with_context(|| format!("cannot write the state file {}", path.display()))?;
        Ok(sequence)
    }

    /// Returns the number for a new connection. The number is stored before it is used, by replacing the file atomically.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn advance(&mut self) -> Result<u8> {
        let number = self.next;
        let draft = self.draft();
        let write = || -> std::io::Result<()> {
            let mut file = File::create(&draft)?;
            writeln!(file, "{KEY}{number}")?;
            file.sync_all()?;
            fs::rename(&draft, &self.path)
        };
        write().with_context(|| format!("cannot write the state file {}", self.path.display()))?;
        self.next = number.wrapping_add(1);
        Ok(number)
    }

    /// Returns the path of the new file before it replaces the old one.
    fn draft(&self) -> PathBuf {
        let mut draft = self.path.clone().into_os_string();
        draft.push(".new");
        draft.into()
    }
}

/// Parses the number in the file.
fn last_of(text: &str) -> Option<u8> {
    text.trim_end().strip_prefix(KEY)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path_of(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("wsg-telemetry-{}-{name}", std::process::id()))
    }

    #[test]
    fn number_continues_after_a_restart_and_wraps_at_255() {
        let path = path_of("continues");
        fs::write(&path, "bdSeq = 254\n").unwrap();

        let mut first = Sequence::open(&path).unwrap();
        assert_eq!(first.advance().unwrap(), 255);
        let mut second = Sequence::open(&path).unwrap();
        assert_eq!((second.advance().unwrap(), second.advance().unwrap()), (0, 1));

        assert_eq!(fs::read_to_string(&path).unwrap(), "bdSeq = 1\n");
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn missing_or_invalid_file_starts_at_0() {
        let path = path_of("starts");
        assert_eq!(Sequence::open(&path).unwrap().next, 0);
        for content in [&b""[..], b"bdSeq = 256\n", b"7", b"\xFF\xFE"] {
            fs::write(&path, content).unwrap();
            assert_eq!(Sequence::open(&path).unwrap().next, 0);
        }
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn unwritable_file_is_reported_at_start_up() {
        let error = format!("{:#}", Sequence::open(&path_of("none").join("state")).unwrap_err());
        assert!(error.contains("cannot write the state file") && !error.contains('\n'), "{error}");
    }
}
