//! The firmware's side of the agreement: it requests an update, and confirms itself.

use wsg_bridge_fw::storage::{self, NorFlash, Progress, Store};
use wsg_protocol::Instant;
use wsg_update::{BootState, Manifest, Phase, RECORD_VERSION, Trust};

/// The records of the boot loader's state and of the rollback counter, written step by step in turns of the main loop.
///
/// Only one of them exists for a board, because each record continues the previous one.
#[derive(Clone)]
pub struct Records {
    state: Store<{ BootState::LEN }>,
    /// The last complete state.
    now: BootState,
    trust: Store<{ Trust::LEN }>,
    /// The last complete trust.
    trusted: Trust,
    goal: Goal,
    /// The record in progress.
    writing: Writing,
}

/// The last request of the firmware.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Goal {
    Nothing,
    /// Saves the state again.
    Settle,
    Request,
    Confirm(Manifest),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Writing {
    Nothing,
    State(BootState),
    Trust(Trust),
}

impl Records {
    /// Loads both records. Reads all pages, so call it at the start.
    #[must_use]
    pub fn load(state: &impl NorFlash, trust: &impl NorFlash) -> Self {
        let (mut states, mut trusts) = (Store::new(), Store::new());
        let now = states.load(state).ok().and_then(|it| BootState::decode(it.version, it.payload));
        let trusted = trusts.load(trust).ok().and_then(|it| Trust::decode(it.version, it.payload));
        Self {
            state: states,
            now: now.unwrap_or(BootState::INITIAL),
            trust: trusts,
            trusted: trusted.unwrap_or_default(),
            goal: Goal::Nothing,
            writing: Writing::Nothing,
        }
    }

    /// Returns whether the running image is on trial: it has not confirmed itself, so it must store no settings, and nothing may
    /// be written to slot B, which contains the previous image.
    #[must_use]
    pub const fn is_trial(&self) -> bool {
        self.now.is_trial()
    }

    /// Returns whether the boot loader has restored this image, because the new one did not confirm itself.
    #[must_use]
    pub const fn is_restored(&self) -> bool {
        matches!(self.now.phase, Phase::Restored)
    }

    /// Returns the stored trust, for checks of an image.
    #[must_use]
    pub const fn trusted(&self) -> &Trust {
        &self.trusted
    }

    /// Prepares slot B for writing, which must wait until [`poll`](Self::poll) returns [`Progress::Saved`]: the request of an
    /// earlier image must not apply to the next one.
    pub const fn settle(&mut self) {
        self.goal = Goal::Settle;
    }

    /// Requests the exchange of the slots at the next reset, which must wait until [`poll`](Self::poll) returns
    /// [`Progress::Saved`].
    pub const fn request(&mut self) {
        self.goal = Goal::Request;
    }

    /// Confirms the running image, whose manifest this is: it stays, and its rollback counter and its successor key apply. Without
    /// effect if that is already stored. Called after 10 s of faultless operation after each start.
    pub const fn confirm(&mut self, image: Manifest) {
        self.goal = Goal::Confirm(image);
    }

    /// Continues the work and returns its progress. Called in every turn of the main loop; starts at most one operation of the flash.
    /// After a failure, the work starts again at the next call of [`settle`](Self::settle), [`request`](Self::request) or
    /// [`confirm`](Self::confirm).
    pub fn poll(&mut self, state: &mut impl NorFlash, trust: &mut impl NorFlash, now: Instant) -> Progress {
        let progress = match self.writing {
            Writing::Nothing => Progress::Idle,
            Writing::State(_) => self.state.poll(state, now),
            Writing::Trust(_) => self.trust.poll(trust, now),
        };
        match progress {
            Progress::Saving => return Progress::Saving,
            Progress::Failed(_) => {
                (self.writing, self.goal) = (Writing::Nothing, Goal::Nothing);
                return progress;
            }
            Progress::Idle | Progress::Saved => {}
        }
        match core::mem::replace(&mut self.writing, Writing::Nothing) {
            Writing::Nothing => {}
            Writing::State(state) => self.now = state,
            Writing::Trust(trust) => self.trusted = trust,
        }
        let next = match self.goal {
            Goal::Nothing => return Progress::Idle,
            Goal::Settle if progress == Progress::Saved => Writing::Nothing,
            Goal::Settle => Writing::State(self.now.again()),
            Goal::Request if self.now.phase != Phase::Update => Writing::State(BootState::new(Phase::Update)),
            Goal::Confirm(_) if self.now.is_trial() => Writing::State(BootState::new(Phase::Confirmed)),
            // Twice, because after a power failure the first record may be incomplete at one of the next starts.
            Goal::Request | Goal::Confirm(_) if self.now.repeats == 0 => Writing::State(self.now.again()),
            Goal::Request => Writing::Nothing,
            Goal::Confirm(image) => match self.trusted.after(&image) {
                trust if trust == self.trusted => Writing::Nothing,
                trust => Writing::Trust(trust),
            },
        };
        let begun = match &next {
            Writing::Nothing => {
                self.goal = Goal::Nothing;
                return Progress::Saved;
            }
            Writing::State(state) => self.state.begin(RECORD_VERSION, &state.encode()),
            Writing::Trust(trust) => self.trust.begin(RECORD_VERSION, &trust.encode()),
        };
        if begun.is_err() {
            // All numbers of saves are used up.
            self.goal = Goal::Nothing;
            return Progress::Failed(storage::SaveError::NotWritten);
        }
        self.writing = next;
        Progress::Saving
    }
}
