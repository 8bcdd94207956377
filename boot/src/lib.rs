//! The boot loader of the bridge (`docs/decisions.md`, "Updates in the field"), independent of boards: exchanges the two slots,
//! and starts an image only after its checks. A board's crate has the program: its flash, its watchdog, and the jump.
//!
//! The image always runs in slot A. [`start`] continues an interrupted exchange or begins a requested one, and checks slot A.
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

mod slot;
mod state;

use embassy_boot::{BootLoader, BootLoaderConfig};
use embedded_storage::nor_flash::NorFlash;
use wsg_bridge_fw::storage::{self, Store};
use wsg_update::{BootState, Check, Keys, Manifest, Phase, Refusal, Rules, SIGNATURE_LEN, Target, Trust};

use slot::Slot;
use state::{NotSaved, State};

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
    /// Bytes of a page, the unit of the exchange.
    const PAGE_LEN: u32 = if A::ERASE_SIZE > B::ERASE_SIZE { A::ERASE_SIZE } else { B::ERASE_SIZE } as u32;

    /// Prepares the start of slot A: returns the manifest of its image, which is checked and may be started.
    ///
    /// Calls `feed` at least after each operation of the slots, and before and after each check of a signature.
    ///
    /// # Errors
    /// [`Stopped`]: no image must be started.
    pub fn start(&mut self, target: Target, keys: Keys, feed: &dyn Fn()) -> Result<Manifest, Stopped> {
        let trust = load_trust(&self.trust);
        let rules = Rules { target, keys: trust.keys(keys), counter: trust.counter };
        let mut state = State::load(&mut self.state);
        // A state that may be half written must not read differently at the next start.
        if state.now.phase == Phase::Update || state.now.repeats == 0 {
            state.save(state.now.again())?;
        }
        // At most: an exchange, its return, and an exchange for a damaged slot A.
        for _ in 0..3 {
            if state.now.phase == Phase::Update {
                let is_requested = state.now.pages == 0;
                if is_requested && !begin_exchange(&mut self.a, &mut self.b, &mut state, rules, feed)? {
                    continue;
                }
                exchange(&mut self.a, &mut self.b, &mut state, Self::PAGE_LEN, feed)?;
            }
            let refusal = match check(&mut self.a, rules, feed) {
                Ok(manifest) => return Ok(manifest),
                Err(refusal) => refusal,
            };
            if state.now.phase != Phase::Update {
                if check(&mut self.b, rules, feed).is_err() {
                    return Err(Stopped::NoImage(refusal));
                }
                state.save(BootState::new(Phase::Update))?;
            }
        }
        Err(Stopped::Flash)
    }
}

/// Checks the image in slot B and saves the number of pages to exchange. Returns `false` if the request is refused.
fn begin_exchange<A: NorFlash, B: NorFlash, S: storage::NorFlash>(
    a: &mut A,
    b: &mut B,
    state: &mut State<'_, S>,
    rules: Rules,
    feed: &dyn Fn(),
) -> Result<bool, NotSaved> {
    let Ok(new) = check(b, rules, feed) else {
        state.save(BootState::new(Phase::Confirmed))?;
        return Ok(false);
    };
    // The previous image must return completely. A damaged one need not.
    let previous = check(a, rules, feed).map_or(0, |manifest| manifest.length);
    let file = new.length.max(previous).saturating_add(SIGNATURE_LEN as u32);
    let pages =
        file.div_ceil(if A::ERASE_SIZE > B::ERASE_SIZE { A::ERASE_SIZE } else { B::ERASE_SIZE } as u32);
    state.save(BootState { pages: pages as u16, ..BootState::new(Phase::Update) })?;
    Ok(true)
}

/// Continues the exchange of the slots or, after the complete exchange, returns the previous image.
fn exchange<A: NorFlash, B: NorFlash, S: storage::NorFlash>(
    a: &mut A,
    b: &mut B,
    state: &mut State<'_, S>,
    page_len: u32,
    feed: &dyn Fn(),
) -> Result<(), Stopped> {
    let len = usize::from(state.now.pages).saturating_mul(page_len as usize);
    let active = Slot::new(a, len, feed);
    let dfu = Slot::new(b, len.saturating_add(page_len as usize), feed);
    let mut engine = BootLoader::new(BootLoaderConfig { active, dfu, state });
    engine.prepare_boot(&mut [0; COPIED]).map(|_| ()).map_err(|_| Stopped::Flash)
}

/// Checks the image in a slot.
fn check(slot: &mut impl NorFlash, rules: Rules, feed: &dyn Fn()) -> Result<Manifest, Refusal> {
    let mut slot = slot::Reader(slot);
    let mut check = Check::begin(&mut slot, rules)?;
    loop {
        feed();
        if let Some(manifest) = check.step(&mut slot)? {
            feed();
            return Ok(manifest);
        }
    }
}

/// Returns the stored trust; the initial one without a record.
fn load_trust(pages: &impl storage::NorFlash) -> Trust {
    let mut store = Store::<{ Trust::LEN }>::new();
    let record = store.load(pages).ok();
    record.and_then(|record| Trust::decode(record.version, record.payload)).unwrap_or_default()
}
