//! The boot loader of the bridge (`docs/decisions.md`, "Updates in the field"), independent of boards: exchanges the two slots,
//! and starts an image only after its checks. A board's crate has the program: its flash, its watchdog, and the jump. [`Updater`]
//! is the firmware's side.
//!
//! The image always runs in slot A. [`Flash::start`] continues an interrupted exchange or begins a requested one, and checks slot A.
//! If the new image does not confirm itself, the next start returns the previous image. If slot A is damaged, an intact image
//! in slot B replaces it. Without any, the board stays in the boot loader with its outputs low.
//!
//! After a power failure at any time, the next start runs either the old or the new image.
#![no_std]
#![forbid(unsafe_code)]
#![deny(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::arithmetic_side_effects
)]

mod flash;
mod records;
mod slot;
mod state;
mod updater;

pub use flash::{Blocking, PolledFlash};
pub use records::Records;
pub use updater::{Firmware, FlashWithSlot, Updater};

use embassy_boot::{BootLoader, BootLoaderConfig};
use embedded_storage::nor_flash::NorFlash;
use wsg_bridge_fw::storage::{self, Store};
use wsg_update::{
    BootState, Check, Keys, Manifest, Phase, PublicKey, Refusal, Rules, SIGNATURE_LEN, Target, Trust,
};

use slot::Slot;
use state::{NotSaved, State};

/// The check of a signature in a boot loader, [`wsg_update::verify`], whose address is at the start of its flash plus
/// [`VERIFY_AT`]. The firmware calls it instead of containing it again. It uses some KiB of the caller's stack, and no other RAM.
pub type Verify = extern "C" fn(&PublicKey, &[u8; 64], &[u8; SIGNATURE_LEN]) -> bool;

/// Offset of a [`Verify`] from the boot loader's vector table (`boot/board-memory.x` of each board).
pub const VERIFY_AT: usize = 0x3FC;

/// The boot loader's [`Verify`].
#[must_use]
pub extern "C" fn verify(key: &PublicKey, digest: &[u8; 64], signature: &[u8; SIGNATURE_LEN]) -> bool {
    wsg_update::verify(key, digest, signature)
}

/// Bytes copied at once: a page of the Pico's flash. It divides every board's erase page.
const COPIED: usize = 256;

/// The flash of a board: two slots, of which slot B has one page more, and the pages of two records.
///
/// The slots must be readable from multiples of 4. Reads of damaged data fail.
pub struct Flash<A, B, S, T> {
    /// Slot A, whose image runs.
    pub a: A,
    /// Slot B, for the next or the previous image.
    pub b: B,
    /// Pages of the boot loader's state.
    pub state: S,
    /// Pages of the rollback counter.
    pub trust: T,
}

/// Reason why no image can be started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopped {
    /// Neither slot contains an acceptable image; the reason for slot A. Only a new image from a probe helps.
    NoImage(Refusal),
    /// The flash rejected an operation. A reset tries again.
    Flash,
}

impl From<NotSaved> for Stopped {
    fn from(_: NotSaved) -> Self {
        Self::Flash
    }
}

impl<A: NorFlash, B: NorFlash, S: storage::NorFlash, T: storage::NorFlash> Flash<A, B, S, T> {
    /// Prepares the start of slot A: returns the manifest of its image, which is checked and may be started.
    ///
    /// Calls `feed` at least after each operation of the slots, and before and after each check of a signature.
    ///
    /// # Errors
    /// [`Stopped`]: no image must be started.
    pub fn start(&mut self, target: Target, keys: Keys, feed: &dyn Fn()) -> Result<Manifest, Stopped> {
        let trust = load_trust(&self.trust);
        let rules = Rules { target, keys: trust.keys(keys), counter: trust.counter };
        Start { a: &mut self.a, b: &mut self.b, state: State::load(&mut self.state), rules, feed }.run()
    }
}

/// Returns the stored trust; the initial one without a record.
fn load_trust(pages: &impl storage::NorFlash) -> Trust {
    let mut store = Store::<{ Trust::LEN }>::new();
    let record = store.load(pages).ok();
    record.and_then(|record| Trust::decode(record.version, record.payload)).unwrap_or_default()
}

/// A start in progress.
struct Start<'a, A, B, S> {
    a: &'a mut A,
    b: &'a mut B,
    state: State<'a, S>,
    rules: Rules,
    feed: &'a dyn Fn(),
}

impl<A: NorFlash, B: NorFlash, S: storage::NorFlash> Start<'_, A, B, S> {
    /// Bytes of a page, the unit of the exchange.
    const PAGE_LEN: u32 = if A::ERASE_SIZE > B::ERASE_SIZE { A::ERASE_SIZE } else { B::ERASE_SIZE } as u32;

    fn run(mut self) -> Result<Manifest, Stopped> {
        // A state that may be half written must not read differently at the next start.
        if self.state.now.phase == Phase::Update || self.state.now.repeats == 0 {
            self.state.save(self.state.now.again())?;
        }
        // At most: an exchange, its return, and an exchange for a damaged slot A.
        for _ in 0..3 {
            if self.state.now.phase == Phase::Update && self.state.now.pages == 0 {
                self.begin_exchange()?;
            }
            if self.state.now.phase == Phase::Update {
                self.exchange()?;
            }
            match check(self.a, 0, self.rules, self.feed) {
                Ok(manifest) => return Ok(manifest),
                // The previous image returns.
                Err(_) if self.state.now.phase == Phase::Update => {}
                Err(refusal) => {
                    let replacement = self.replacement().ok_or(Stopped::NoImage(refusal))?;
                    self.state.save(replacement)?;
                }
            }
        }
        Err(Stopped::Flash)
    }

    /// Checks the image in slot B. Saves the number of pages to exchange, or withdraws the request.
    fn begin_exchange(&mut self) -> Result<(), NotSaved> {
        let state = match check(self.b, 0, self.rules, self.feed) {
            Ok(new) => {
                // The previous image must return completely. A damaged one need not.
                let previous = check(self.a, 0, self.rules, self.feed).map_or(0, |manifest| manifest.length);
                let pages = Self::pages(new.length.max(previous));
                BootState { pages, ..BootState::new(Phase::Update) }
            }
            Err(_) => BootState::new(Phase::Confirmed),
        };
        self.state.save(state)
    }

    /// Continues the exchange of the slots or, after the complete exchange, returns the previous image.
    fn exchange(&mut self) -> Result<(), Stopped> {
        let page_len = Self::PAGE_LEN as usize;
        let len = usize::from(self.state.now.pages).saturating_mul(page_len);
        let active = Slot::new(self.a, len, self.feed);
        let dfu = Slot::new(self.b, len.saturating_add(page_len), self.feed);
        let mut engine = BootLoader::new(BootLoaderConfig { active, dfu, state: &mut self.state });
        engine.prepare_boot(&mut [0; COPIED]).map(|_| ()).map_err(|_| Stopped::Flash)
    }

    /// Returns the state with which an intact image in slot B replaces a damaged one in slot A.
    fn replacement(&mut self) -> Option<BootState> {
        let update = BootState::new(Phase::Update);
        // An exchange leaves the previous image one page further, from where its return takes it.
        if let Ok(previous) = check(self.b, Self::PAGE_LEN, self.rules, self.feed) {
            let pages = Self::pages(previous.length);
            return Some(BootState { pages, progress: pages.saturating_mul(2), ..update });
        }
        check(self.b, 0, self.rules, self.feed).ok().map(|_| update)
    }

    /// Returns the pages of the file of an image.
    const fn pages(length: u32) -> u16 {
        length.saturating_add(SIGNATURE_LEN as u32).div_ceil(Self::PAGE_LEN) as u16
    }
}

/// Checks the image in a slot, from this offset.
fn check(slot: &mut impl NorFlash, from: u32, rules: Rules, feed: &dyn Fn()) -> Result<Manifest, Refusal> {
    let mut slot = slot::Reader { slot, from };
    let mut check = Check::begin(&mut slot, rules)?;
    loop {
        feed();
        if let Some(manifest) = check.step(&mut slot)? {
            feed();
            return Ok(manifest);
        }
    }
}
