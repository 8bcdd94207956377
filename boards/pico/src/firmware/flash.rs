//! The settings' two sectors: none yet.

use wsg_bridge_fw::storage::{FlashError, NorFlash, Page, Unreadable};

/// The two sectors.
pub(crate) struct SettingsSectors(());

/// The two sectors. To be asked for once.
pub(crate) const fn settings_sectors() -> SettingsSectors {
    SettingsSectors(())
}

impl NorFlash for SettingsSectors {
    const PAGE_LEN: usize = 4096 / 8;

    fn read(&self, _: Page, _: usize) -> Result<u64, Unreadable> {
        Ok(0)
    }

    fn start_program(&mut self, _: Page, _: usize, _: u64) -> Result<(), FlashError> {
        Err(FlashError::Failed)
    }

    fn start_erase(&mut self, _: Page) -> Result<(), FlashError> {
        Err(FlashError::Failed)
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        Ok(())
    }
}
