//! PDOs: when one is taken or sent (CiA 301, 7.2.2), and what a master sets of it.

use crate::Pdo;
use crate::clock::since;

/// What a master sets of a PDO.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setup {
    /// Bit 31 of the COB-ID is 0.
    pub(super) is_enabled: bool,
    /// It carries what its mapping says, not nothing. An enabled one always does.
    pub(super) is_mapped: bool,
    /// 0 to 240: with SYNC; 254 and 255: at once.
    pub(super) transmission: u8,
}

impl Setup {
    const NEW: Self = Self { is_enabled: true, is_mapped: true, transmission: Pdo::EVENT_DRIVEN };
    const LAST_SYNCHRONOUS: u8 = 240;

    /// Whether a PDO can have this type. Those in between are reserved, or want remote frames.
    pub(super) const fn has(transmission: u8) -> bool {
        matches!(transmission, 0..=Self::LAST_SYNCHRONOUS | 254..=255)
    }

    const fn waits_for_sync(&self) -> bool {
        self.transmission <= Self::LAST_SYNCHRONOUS
    }
}

/// One RPDO.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rpdo {
    pub(super) setup: Setup,
    /// What counts.
    pub(super) taken: [u8; 8],
    /// What came and waits for a SYNC.
    pub(super) waiting: Option<[u8; 8]>,
}

impl Rpdo {
    pub(super) const NEW: Self = Self { setup: Setup::NEW, taken: [0; 8], waiting: None };

    /// What came; the image that counts from now on, if any. One with a bit of `keep` does not wait for a SYNC.
    pub(super) fn receive(&mut self, data: [u8; 8], keep: [u8; 8]) -> Option<[u8; 8]> {
        let is_urgent = data.iter().zip(keep).any(|(byte, keep)| byte & keep != 0);
        if self.setup.waits_for_sync() && !is_urgent {
            self.waiting = Some(data);
            return None;
        }
        (self.taken, self.waiting) = (data, None);
        Some(data)
    }

    /// The image that counts from this SYNC on.
    pub(super) fn on_sync(&mut self) -> Option<[u8; 8]> {
        let data = self.waiting.take()?;
        self.taken = data;
        Some(data)
    }
}

/// One TPDO.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tpdo {
    pub(super) setup: Setup,
    pub(super) shown: [u8; 8],
    sent: [u8; 8],
    /// None: it is due, as far as its type lets it.
    sent_at: Option<u32>,
    /// SYNCs since it was sent.
    syncs: u8,
    /// A SYNC asked for it.
    is_asked: bool,
}

impl Tpdo {
    pub(super) const NEW: Self =
        Self { setup: Setup::NEW, shown: [0; 8], sent: [0; 8], sent_at: None, syncs: 0, is_asked: false };

    /// As if it had never been sent.
    pub(super) const fn send_again(&mut self) {
        (self.sent_at, self.syncs, self.is_asked) = (None, 0, false);
    }

    pub(super) fn on_sync(&mut self) {
        if !self.setup.waits_for_sync() {
            return;
        }
        self.syncs = self.syncs.saturating_add(1);
        self.is_asked = match self.setup.transmission {
            0 => self.sent_at.is_none() || self.sent != self.shown,
            every => self.syncs >= every,
        };
    }

    /// What is to be sent now.
    pub(super) fn due(&mut self, now_ms: u32, inhibit_ms: u32, event_ms: u32) -> Option<[u8; 8]> {
        let is_due = if self.setup.waits_for_sync() {
            self.is_asked
        } else {
            self.sent_at.is_none_or(|at| {
                let passed_ms = since(now_ms, at);
                (self.sent != self.shown && passed_ms >= inhibit_ms)
                    || (event_ms > 0 && passed_ms >= event_ms)
            })
        };
        if !self.setup.is_enabled || !is_due {
            return None;
        }
        (self.syncs, self.is_asked) = (0, false);
        (self.sent, self.sent_at) = (self.shown, Some(now_ms));
        Some(self.sent)
    }
}
