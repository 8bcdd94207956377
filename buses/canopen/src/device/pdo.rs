//! PDO state: when a PDO takes effect or is sent (CiA 301, 7.2.2), and its communication parameters.

use crate::Pdo;
use crate::clock::age;

/// Communication parameters of a PDO, set by the master.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setup {
    /// Whether bit 31 of the COB-ID is 0.
    pub(super) is_enabled: bool,
    /// Whether the mapping is in place; false after a master cleared it. Always true while the PDO is enabled.
    pub(super) is_mapped: bool,
    /// Transmission type: 0 to 240 with SYNC, 254 and 255 event-driven.
    pub(super) transmission: u8,
}

impl Setup {
    const NEW: Self = Self { is_enabled: true, is_mapped: true, transmission: Pdo::EVENT_DRIVEN };
    const LAST_SYNCHRONOUS: u8 = 240;

    /// Returns whether this transmission type is supported. 241 to 253 are reserved or require remote frames.
    pub(super) const fn has(transmission: u8) -> bool {
        matches!(transmission, 0..=Self::LAST_SYNCHRONOUS | 254..=255)
    }

    const fn waits_for_sync(&self) -> bool {
        self.transmission <= Self::LAST_SYNCHRONOUS
    }
}

/// State of one RPDO.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rpdo {
    pub(super) setup: Setup,
    /// Data in effect: of the last PDO, or of the last SYNC for synchronous ones.
    pub(super) taken: [u8; 8],
    /// Data received and pending until the next SYNC.
    pub(super) waiting: Option<[u8; 8]>,
}

impl Rpdo {
    pub(super) const NEW: Self = Self { setup: Setup::NEW, taken: [0; 8], waiting: None };

    /// Receives an RPDO. Returns its data if it takes effect immediately. Data with any bit of `keep` set
    /// never waits for a SYNC.
    pub(super) fn receive(&mut self, data: [u8; 8], keep: [u8; 8]) -> Option<[u8; 8]> {
        let is_urgent = data.iter().zip(keep).any(|(byte, keep)| byte & keep != 0);
        if self.setup.waits_for_sync() && !is_urgent {
            self.waiting = Some(data);
            return None;
        }
        (self.taken, self.waiting) = (data, None);
        Some(data)
    }

    /// Returns the data that takes effect with this SYNC, if any.
    pub(super) fn on_sync(&mut self) -> Option<[u8; 8]> {
        let data = self.waiting.take()?;
        self.taken = data;
        Some(data)
    }
}

/// State of one TPDO.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tpdo {
    pub(super) setup: Setup,
    pub(super) shown: [u8; 8],
    sent: [u8; 8],
    /// Time of the last transmission. `None`: send at the next opportunity for the transmission type.
    sent_at: Option<u32>,
    /// Number of SYNCs since the last transmission.
    syncs: u8,
    /// Whether the last SYNC requested a transmission.
    is_requested: bool,
}

impl Tpdo {
    pub(super) const NEW: Self =
        Self { setup: Setup::NEW, shown: [0; 8], sent: [0; 8], sent_at: None, syncs: 0, is_requested: false };

    /// Resets the transmission state, as if the TPDO had never been sent.
    pub(super) const fn send_again(&mut self) {
        (self.sent_at, self.syncs, self.is_requested) = (None, 0, false);
    }

    pub(super) fn on_sync(&mut self) {
        if !self.setup.waits_for_sync() {
            return;
        }
        self.syncs = self.syncs.saturating_add(1);
        self.is_requested = match self.setup.transmission {
            0 => self.sent_at.is_none() || self.sent != self.shown,
            every => self.syncs >= every,
        };
    }

    /// Returns the data to send now, if any.
    pub(super) fn due(&mut self, now_ms: u32, inhibit_ms: u32, event_ms: u32) -> Option<[u8; 8]> {
        let is_due = if self.setup.waits_for_sync() {
            self.is_requested
        } else {
            self.sent_at.as_mut().is_none_or(|at| {
                let passed_ms = age(now_ms, at);
                (self.sent != self.shown && passed_ms >= inhibit_ms)
                    || (event_ms > 0 && passed_ms >= event_ms)
            })
        };
        if !self.setup.is_enabled || !is_due {
            return None;
        }
        (self.syncs, self.is_requested) = (0, false);
        (self.sent, self.sent_at) = (self.shown, Some(now_ms));
        Some(self.sent)
    }
}
