//! bdSeq: the number that ties a death to its birth, one further at each connection, also after a restart (Sparkplug, 6.4.5).

use std::{
    fs::{self, File},
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};

/// What stands before the number in the file.
const KEY: &str = "bdSeq = ";

#[derive(Debug)]
pub(super) struct Sequence {
    path: PathBuf,
    next: u8,
}

impl Sequence {
    /// Reads the file; there need be none. One that cannot be understood is told, and counting starts at 0.
    ///
    /// # Errors
    /// The file cannot be read or written; that it is not there yet is no error.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let next = match fs::read_to_string(path) {
            Ok(text) => last_of(&text).map_or_else(
                || {
                    eprintln!(
                        "wsg: {} is no state file (\"{KEY}0\" to 255): bdSeq starts at 0",
                        path.display()
                    );
                    0
                },
                |last| last.wrapping_add(1),
            ),
            Err(error) if error.kind() == ErrorKind::NotFound => 0,
            Err(error) if error.kind() == ErrorKind::InvalidData => {
                eprintln!("wsg: {} is no state file (no text): bdSeq starts at 0", path.display());
                0
            }
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read the state file {}", path.display()));
            }
        };
        let sequence = Self { path: path.to_owned(), next };
        // Better now than when the broker is there.
        let draft = sequence.draft();
        File::create(&draft)
            .and_then(|_| fs::remove_file(&draft))
            .with_context(|| format!("cannot write the state file {}", path.display()))?;
        Ok(sequence)
    }

    /// The number for a connection that is about to be made, stored before it is used. A crash leaves the old file or the
    /// new one.
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

    /// The new file before it takes the old one's place.
    fn draft(&self) -> PathBuf {
        let mut draft = self.path.clone().into_os_string();
        draft.push(".new");
        draft.into()
    }
}

/// The number in the file.
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
    fn the_number_goes_on_after_a_restart_and_wraps_at_255() {
        let path = path_of("goes-on");
        fs::write(&path, "bdSeq = 254\n").unwrap();

        let mut first = Sequence::open(&path).unwrap();
        assert_eq!(first.advance().unwrap(), 255);
        let mut second = Sequence::open(&path).unwrap();
        assert_eq!((second.advance().unwrap(), second.advance().unwrap()), (0, 1));

        assert_eq!(fs::read_to_string(&path).unwrap(), "bdSeq = 1\n");
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_file_that_is_not_there_or_not_understood_starts_at_0() {
        let path = path_of("starts");
        assert_eq!(Sequence::open(&path).unwrap().next, 0);
        for content in [&b""[..], b"bdSeq = 256\n", b"7", b"\xFF\xFE"] {
            fs::write(&path, content).unwrap();
            assert_eq!(Sequence::open(&path).unwrap().next, 0);
        }
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_place_that_cannot_be_written_is_told_at_the_start() {
        let error = format!("{:#}", Sequence::open(&path_of("none").join("state")).unwrap_err());
        assert!(error.contains("cannot write the state file") && !error.contains('\n'), "{error}");
    }
}
