//! The flash of a bridge without a board: the settings of `wsg demo --bus` and of `wsg gateway` in a file.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Unreadable};

/// Flash for the settings in memory, with a copy in a file.
pub(crate) struct FileFlash {
    pages: [Vec<u64>; 2],
    file: Option<PathBuf>,
    is_changed: bool,
}

/// Double words of a page.
const PAGE_LEN: usize = 256;

impl FileFlash {
    /// Returns the flash stored in a file, or erased flash without one.
    pub(crate) fn open(file: Option<&Path>) -> Result<Self> {
        let mut flash = Self {
            pages: [vec![u64::MAX; PAGE_LEN], vec![u64::MAX; PAGE_LEN]],
            file: None,
            is_changed: false,
        };
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
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
        }
        Ok(flash)
    }

    /// Writes a change to the file.
    fn store(&mut self) -> io::Result<()> {
        if let (true, Some(file)) = (self.is_changed, &self.file) {
            let bytes: Vec<u8> = self.pages.iter().flatten().flat_map(|word| word.to_le_bytes()).collect();
            replace(file, &bytes)?;
        }
        self.is_changed = false;
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

/// Replaces the content of a file: writes it to another one first, so that a power failure leaves a whole file.
pub(crate) fn replace(file: &Path, content: &[u8]) -> io::Result<()> {
    let mut new = file.to_owned().into_os_string();
    new.push(".new");
    fs::write(&new, content).and_then(|()| fs::rename(&new, file))
}

impl NorFlash for FileFlash {
    const PAGE_LEN: usize = PAGE_LEN;

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
        self.is_changed = true;
        Ok(())
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.page(page).fill(u64::MAX);
        self.is_changed = true;
        Ok(())
    }

    /// A file that cannot be written is a failed operation: SAVE fails, and an event shows it.
    fn poll(&mut self) -> nb::Result<(), FlashError> {
        self.store().map_err(|_| nb::Error::Other(FlashError::Failed))
    }
}
