//! The boot loader's state: a record in the format of the settings, presented to `embassy-boot` as the flash that it expects.
//!
//! `embassy-boot` 0.7 keeps a magic number and a byte for each step in flash. If power fails while it writes one of them, that
//! number may read differently at each start, or may be impossible to write again. The records here do not have these faults.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use wsg_bridge_fw::storage::{self, Progress, Store};
use wsg_protocol::Instant;
use wsg_update::{BootState, Phase, RECORD_VERSION};

/// `embassy-boot`'s number for an exchange. Its only other effect here is the end of a return.
const SWAP_MAGIC: u8 = 0xF0;

/// Layout of `embassy-boot`'s state, with units of one byte: its number, a flag that invalidates progress, and a byte for each
/// step, which is 0 after the step.
const MAGIC_AT: u32 = 0;
const FIRST_STEP: u32 = 2;

const ERASED: u8 = 0xFF;

/// Error: the state was not saved. The previous record is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NotSaved;

pub(crate) struct State<'a, S> {
    pub(crate) now: BootState,
    store: Store<{ BootState::LEN }>,
    pages: &'a mut S,
}

impl<'a, S: storage::NorFlash> State<'a, S> {
    /// Loads the state. A damaged record is the initial state, because no power failure causes it, and the check of slot A
    /// decides.
    pub(crate) fn load(pages: &'a mut S) -> Self {
        let mut store = Store::new();
        let record = store.load(pages).ok();
        let state = record.and_then(|record| BootState::decode(record.version, record.payload));
        Self { now: state.unwrap_or(BootState::INITIAL), store, pages }
    }

    /// Saves the state and waits. If the flash never ends, the watchdog resets the board.
    pub(crate) fn save(&mut self, state: BootState) -> Result<(), NotSaved> {
        self.store.begin(RECORD_VERSION, &state.encode()).map_err(|_| NotSaved)?;
        loop {
            match self.store.poll(self.pages, Instant::from_millis(0)) {
                Progress::Saving => {}
                Progress::Saved | Progress::Idle => break,
                Progress::Failed(_) => return Err(NotSaved),
            }
        }
        self.now = state;
        Ok(())
    }

    fn byte(&self, at: u32) -> u8 {
        match at.checked_sub(FIRST_STEP) {
            None if at == MAGIC_AT && self.now.phase == Phase::Update => SWAP_MAGIC,
            None => ERASED,
            Some(step) if step < self.now.progress.into() => 0,
            Some(_) => ERASED,
        }
    }
}

impl<S> ErrorType for &mut State<'_, S> {
    type Error = NorFlashErrorKind;
}

impl<S: storage::NorFlash> ReadNorFlash for &mut State<'_, S> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        for (byte, at) in bytes.iter_mut().zip(offset..) {
            *byte = self.byte(at);
        }
        Ok(())
    }

    /// Returns bytes for the steps of exchange and return, and one more.
    fn capacity(&self) -> usize {
        usize::from(self.now.pages).saturating_mul(4).saturating_add(4)
    }
}

impl<S: storage::NorFlash> NorFlash for &mut State<'_, S> {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = 1;

    /// Without effect: after a return, the next write replaces the complete state.
    fn erase(&mut self, _: u32, _: u32) -> Result<(), NorFlashErrorKind> {
        Ok(())
    }

    fn write(&mut self, offset: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> {
        let state = match offset.checked_sub(FIRST_STEP) {
            Some(step) => BootState { progress: (step as u16).saturating_add(1), ..self.now },
            None if offset == MAGIC_AT => BootState::new(Phase::Restored),
            None => return Ok(()),
        };
        self.save(state).map_err(|NotSaved| NorFlashErrorKind::Other)
    }
}
