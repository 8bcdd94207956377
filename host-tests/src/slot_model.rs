//! A board with a boot loader and test keys in virtual time.

use embedded_storage::nor_flash::{NorFlash as _, ReadNorFlash as _};
use wsg_boot::{Blocking, Firmware, Stopped, Updater};
use wsg_bridge_fw::registers::UpdateRefusal;
use wsg_bridge_fw::storage::{FlashError, ImageVersion, SLOT_PAGE_LEN, Slot, Unreadable};
use wsg_protocol::Instant;
use wsg_update::sign::{SigningKey, file};
use wsg_update::{Keys, Manifest, SLOT_LEN, Target, Version};

use crate::slot_flash::{Part, Parts, SlotFlash};

/// Name of the board in virtual time.
pub const BOARD_NAME: &str = "virtual";

/// Bytes of a sector, as on the STM32 boards.
pub const SECTOR_LEN: usize = 2_048;

/// Lowest accepted rollback counter.
const COUNTER: u32 = 3;

/// Returns the public keys of the boot loader.
#[must_use]
pub const fn keys() -> [[u8; 32]; 2] {
    [Keys::BUILT_IN.first, Keys::BUILT_IN.second]
}

/// Returns an image of about this length for this board with its signature by the second key.
///
/// # Panics
/// Panics when it exceeds a slot.
#[must_use]
pub fn signed(len: usize, board: &str, version: [u8; 3]) -> Vec<u8> {
    let program: Vec<u8> = (0..len).map(|at| (at * 7 % 251) as u8).collect();
    let (target, version) = (Target::of(board), Version(version));
    let manifest = Manifest { target, version, length: 0, counter: COUNTER, successor: None };
    file(&program, manifest, &SigningKey::from_bytes(&[2; 32])).expect("it fits into a slot")
}

/// The driver of slot B of a bridge in virtual time, on flash with both slots.
#[derive(Clone)]
pub struct SlotModel {
    /// The flash.
    pub flash: SlotFlash<SECTOR_LEN, 8>,
    updater: Updater<SlotPart, SlotPart, SlotPart>,
    /// Number of requests to exchange the slots.
    pub marks: u32,
    /// Number of resets.
    pub restarts: u32,
}

type SlotPart = Part<SECTOR_LEN, 8>;

/// Version of the image in slot A of new flash.
pub const RUNNING: [u8; 3] = [1, 0, 0];

impl SlotModel {
    /// Creates flash with a confirmed image in slot A, and old data in slot B.
    ///
    /// # Panics
    /// Panics if the boot loader does not start the image.
    #[must_use]
    pub fn new() -> Self {
        const PAGES: usize = SLOT_LEN as usize / SECTOR_LEN;
        let flash = SlotFlash::new(PAGES);
        let Parts { mut a, mut b, .. } = flash.parts();
        a.write(0, &signed(1_000, BOARD_NAME, RUNNING)).expect("the flash is erased");
        b.write(0, &[0x55; 2 * SECTOR_LEN]).expect("the flash is erased");
        let mut slot = Self::started(flash).expect("the image is signed");
        while slot.updater.confirm(Instant::from_millis(0)) == Err(nb::Error::WouldBlock) {}
        Self::started(SlotFlash::with(slot.flash.content(), PAGES)).expect("it started before")
    }

    /// Lets the boot loader start an image as after a reset.
    ///
    /// # Errors
    /// The reason why none can be started.
    ///
    /// # Panics
    /// Panics when slot A contains no image.
    pub fn started(flash: SlotFlash<SECTOR_LEN, 8>) -> Result<Self, Stopped> {
        let mut parts = flash.parts();
        parts.start(Target::of(BOARD_NAME), Keys::BUILT_IN, &|| {})?;
        let Parts { a: Blocking(a), b: Blocking(b), state, trust } = parts;
        let firmware = Firmware::of(&a, BOARD_NAME, Some(wsg_boot::verify), || {}).expect("it was started");
        Ok(Self { flash, updater: Updater::new(b, state, trust, firmware), marks: 0, restarts: 0 })
    }

    /// Returns the version of the image in slot A.
    ///
    /// # Panics
    /// Panics when it contains none.
    #[must_use]
    pub fn running(&self) -> [u8; 3] {
        let Blocking(a) = self.flash.parts().a;
        Firmware::of(&a, BOARD_NAME, Some(wsg_boot::verify), || {})
            .expect("slot A has an image")
            .image
            .version
            .0
    }

    /// Returns the first bytes of slot B.
    ///
    /// # Panics
    /// Panics when they cannot be read.
    #[must_use]
    pub fn bytes(&self, len: usize) -> Vec<u8> {
        let mut bytes = vec![0; len];
        self.flash.parts().b.read(0, &mut bytes).expect("the slot is readable");
        bytes
    }
}

impl Default for SlotModel {
    fn default() -> Self {
        Self::new()
    }
}

impl Slot for SlotModel {
    fn len(&self) -> u32 {
        self.updater.len()
    }

    fn sector_len(&self) -> u32 {
        self.updater.sector_len()
    }

    fn target(&self) -> u32 {
        self.updater.target()
    }

    fn version(&self) -> ImageVersion {
        self.updater.version()
    }

    fn is_on_trial(&self) -> bool {
        self.updater.is_on_trial()
    }

    fn start_erase(&mut self, at: u32) -> Result<(), FlashError> {
        self.updater.start_erase(at)
    }

    fn start_program(&mut self, at: u32, page: &[u8; SLOT_PAGE_LEN]) -> Result<(), FlashError> {
        self.updater.start_program(at, page)
    }

    fn poll(&mut self, now: Instant) -> nb::Result<(), FlashError> {
        self.updater.poll(now)
    }

    fn read(&self, at: u32) -> Result<u64, Unreadable> {
        self.updater.read(at)
    }

    fn check(&mut self, len: u32) -> nb::Result<ImageVersion, UpdateRefusal> {
        self.updater.check(len)
    }

    fn mark(&mut self, now: Instant) -> nb::Result<(), FlashError> {
        self.updater.mark(now).inspect(|()| self.marks += 1)
    }

    fn confirm(&mut self, now: Instant) -> nb::Result<(), FlashError> {
        self.updater.confirm(now)
    }

    fn restart(&mut self) {
        self.updater.restart();
        self.restarts += 1;
    }
}
