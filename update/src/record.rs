//! Payloads of the records with which firmware and boot loader agree, each in two pages of its own, in the format of the
//! settings' records (`bridge-fw/src/storage`).

use crate::{Keys, Manifest, PublicKey};

/// Version of both payloads in their records.
pub const RECORD_VERSION: u16 = 1;

/// State of the slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Phase {
    /// The image in slot A is confirmed.
    Confirmed = 1,
    /// The slots are to be exchanged, are being exchanged, or were exchanged and the image in slot A is on trial. A reset during
    /// the trial returns the previous image.
    Update = 2,
    /// The previous image was restored.
    Restored = 3,
}

/// Record of the boot loader's state: written by the firmware to request an update and to confirm it, otherwise by the boot
/// loader.
///
/// A record interrupted by a power failure can read complete at one start and incomplete at the next. So a state is saved
/// [`again`](Self::again) before anything else is changed on its account: slots, settings or [`Trust`]. The boot loader does
/// so at its start, and the firmware after it has requested or confirmed an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BootState {
    /// The phase.
    pub phase: Phase,
    /// Pages to exchange; 0 before the boot loader has checked the image in slot B.
    pub pages: u16,
    /// Finished steps of the exchange and of the return, two for each page.
    pub progress: u16,
    /// Number of times that the state was saved again; distinguishes its records.
    pub repeats: u8,
}

impl BootState {
    /// Bytes of the payload.
    pub const LEN: usize = 8;

    /// State of a board without a record.
    pub const INITIAL: Self = Self { repeats: 1, ..Self::new(Phase::Confirmed) };

    /// Returns a state without pages and progress: the request of an update, or its confirmation.
    #[must_use]
    pub const fn new(phase: Phase) -> Self {
        Self { phase, pages: 0, progress: 0, repeats: 0 }
    }

    /// Returns whether the image in slot A is on trial, as seen by the firmware.
    #[must_use]
    pub const fn is_trial(&self) -> bool {
        matches!(self.phase, Phase::Update) && self.pages > 0
    }

    /// Returns the same state for another record.
    #[must_use]
    pub const fn again(self) -> Self {
        Self { repeats: self.repeats.wrapping_add(1), ..self }
    }

    /// Returns the payload.
    #[must_use]
    pub const fn encode(&self) -> [u8; Self::LEN] {
        let ([p0, p1], [s0, s1]) = (self.pages.to_le_bytes(), self.progress.to_le_bytes());
        [self.phase as u8, self.repeats, p0, p1, s0, s1, 0, 0]
    }

    /// Parses a payload. Returns `None` if it is not a state of this version.
    #[must_use]
    pub fn decode(version: u16, payload: &[u8]) -> Option<Self> {
        let &[phase, repeats, p0, p1, s0, s1, 0, 0] = payload else { return None };
        let phases = [Phase::Confirmed, Phase::Update, Phase::Restored];
        let phase = phases.into_iter().find(|known| *known as u8 == phase)?;
        let (pages, progress) = (u16::from_le_bytes([p0, p1]), u16::from_le_bytes([s0, s1]));
        (version == RECORD_VERSION).then_some(Self { phase, pages, progress, repeats })
    }
}

/// Record of the trust of a board, in the pages of the rollback counter: written by the firmware after it has confirmed itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Trust {
    /// Lowest accepted rollback counter.
    pub counter: u32,
    /// Successor of the boot loader's second key.
    pub successor: Option<PublicKey>,
}

impl Trust {
    /// Bytes of the payload.
    pub const LEN: usize = 36;

    /// Returns the trust after a confirmed image. Save it if it differs.
    #[must_use]
    pub fn after(&self, image: &Manifest) -> Self {
        Self { counter: self.counter.max(image.counter), successor: image.successor.or(self.successor) }
    }

    /// Returns the trusted keys with these of the boot loader.
    #[must_use]
    pub fn keys(&self, built_in: Keys) -> Keys {
        Keys { second: self.successor.unwrap_or(built_in.second), ..built_in }
    }

    /// Returns the payload.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut bytes = [0; Self::LEN];
        let key = self.successor.unwrap_or_default();
        for (place, byte) in bytes.iter_mut().zip(self.counter.to_le_bytes().into_iter().chain(key)) {
            *place = byte;
        }
        bytes
    }

    /// Parses a payload. Returns `None` if it is not a record of this version.
    #[must_use]
    pub fn decode(version: u16, payload: &[u8]) -> Option<Self> {
        let bytes: &[u8; Self::LEN] = payload.try_into().ok()?;
        let (counter, key) = (u32::from_le_bytes(*bytes.first_chunk()?), *bytes.last_chunk()?);
        (version == RECORD_VERSION).then_some(Self { counter, successor: (key != [0; 32]).then_some(key) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_parsed_again_and_other_payloads_are_not() {
        let requested = BootState::new(Phase::Update);
        let trial = BootState { pages: 96, progress: 300, ..requested };
        assert!(trial.is_trial() && !requested.is_trial() && !BootState::new(Phase::Restored).is_trial());
        for state in [BootState::INITIAL, requested, trial, trial.again()] {
            assert_eq!(BootState::decode(RECORD_VERSION, &state.encode()), Some(state));
            assert_ne!(state.encode(), state.again().encode());
            assert_eq!(BootState::decode(RECORD_VERSION + 1, &state.encode()), None);
            assert_eq!(BootState::decode(RECORD_VERSION, &state.encode()[..7]), None);
        }
        assert_eq!(BootState::decode(RECORD_VERSION, &[0; 8]), None);
    }
}
