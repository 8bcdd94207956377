//! The flash of a bridge without a board: the settings of `wsg demo --bus` and of `wsg gateway` in a file.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};

use anyhow::{Context, Result, ensure};
use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Unreadable, ends_record};

/// Flash for the settings in memory, with a copy in a file.
pub(crate) struct FileFlash {
    pages: [Vec<u64>; 2],
    file: Option<PathBuf>,
    /// Writes the file in a thread: no bridge waits for a slow disk.
    writer: Option<JoinHandle<io::Result<()>>>,
}

/// Double words of a page.
const PAGE_LEN: usize = 256;

impl FileFlash {
    /// Returns the flash stored in a file, or erased flash without one.
    pub(crate) fn open(file: Option<&Path>) -> Result<Self> {
        let mut flash =
            Self { pages: [vec![u64::MAX; PAGE_LEN], vec![u64::MAX; PAGE_LEN]], file: None, writer: None };
        let Some(file) = file else { return Ok(flash) };
        flash.file = Some(file.to_owned());
        match fs::read(file) {
            Ok(bytes) => {
                let (words, rest) = bytes.as_chunks::<8>();
                ensure!(
                    words.len() == 2 * PAGE_LEN && rest.is_empty(),
                    "{} is no file with settings of a bridge; expected {} bytes or a new file",
                    file.display(),
                    2 * PAGE_LEN * 8
                );
                let all = flash.pages.iter_mut().flatten();
                all.zip(words).for_each(|(word, bytes)| *word = u64::from_le_bytes(*bytes));
            }
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let folder = folder_of(file);
                ensure!(folder.is_dir(), "cannot create {}: there is no such folder", file.display());
            }
            Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
        }
        Ok(flash)
    }

    /// Starts to write the pages to the file.
    fn store(&mut self) -> io::Result<()> {
        if let Some(file) = self.file.clone() {
            let bytes: Vec<u8> = self.pages.iter().flatten().flat_map(|word| word.to_le_bytes()).collect();
            self.writer = Some(thread::Builder::new().spawn(move || replace(&file, &bytes))?);
        }
        Ok(())
    }

    fn page(&mut self, page: Page) -> &mut Vec<u64> {
        let [first, second] = &mut self.pages;
        match page {
            Page::First => first,
            Page::Second => second,
        }
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Replaces a file through a temporary file: after a power failure, it has the old or the new content.
pub(crate) fn replace(file: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut new = file.as_os_str().to_owned();
    new.push(".new");
    let mut written = File::create(&new)?;
    written.write_all(bytes)?;
    written.sync_all()?;
    fs::rename(&new, file)?;
    // The new name is stored as well. Some systems cannot do this for a folder.
    let _ = File::open(folder_of(file)).and_then(|folder| folder.sync_all());
    Ok(())
}

impl NorFlash for FileFlash {
    const PAGE_LEN: usize = PAGE_LEN;

    /// A slow disk is no failure.
    const OPERATION_TIMEOUT_MS: u32 = 10_000;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        let [first, second] = &self.pages;
        let words = if page == Page::First { first } else { second };
        words.get(index).copied().ok_or(Unreadable)
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        let word = self.page(page).get_mut(index).ok_or(FlashError::Failed)?;
        if *word != u64::MAX && value != 0 {
            return Err(FlashError::NotErased);
        }
        *word = value;
        // Once per save: a record without its last double word is not read.
        if ends_record(value) {
            self.store().map_err(|_| FlashError::Failed)?;
        }
        Ok(())
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.page(page).fill(u64::MAX);
        Ok(())
    }

    /// A file that cannot be written is a failed operation: SAVE fails, and an event shows it.
    fn poll(&mut self) -> nb::Result<(), FlashError> {
        if self.writer.as_ref().is_some_and(|writer| !writer.is_finished()) {
            return Err(nb::Error::WouldBlock);
        }
        match self.writer.take().map(JoinHandle::join) {
            None | Some(Ok(Ok(()))) => Ok(()),
            Some(_) => Err(nb::Error::Other(FlashError::Failed)),
        }
    }
}
