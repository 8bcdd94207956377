//! Error counters and fault confinement (RM0351, 46.7.6; ISO 11898-1).

use crate::can_controller::ErrorCode;

/// Bits of ESR (46.9.2).
const EWGF: u32 = 1 << 0;
const EPVF: u32 = 1 << 1;
const BOFF: u32 = 1 << 2;
const LEC_AT: u32 = 4;

/// Counter limits: first value with a warning, last error-active value, last value before bus-off.
const WARNING: u16 = 96;
const LAST_ACTIVE: u16 = 127;
const LAST_ON: u16 = 255;

/// Value of the receive counter after a success while error passive (46.9.2).
const PASSIVE_RETURN: u16 = 120;

/// Sequences of 11 recessive bits that end bus-off.
const RECOVERY: u32 = 128;

#[derive(Clone, Debug)]
pub(super) struct Faults {
    transmit: u16,
    receive: u16,
    is_off: bool,
    last: u32,
    /// Remaining sequences until bus-off ends; `None` while no recovery is requested.
    to_recover: Option<u32>,
}

impl Faults {
    pub(super) const fn new() -> Self {
        Self { transmit: 0, receive: 0, is_off: false, last: 0, to_recover: None }
    }

    pub(super) const fn is_off(&self) -> bool {
        self.is_off
    }

    const fn is_passive(&self) -> bool {
        self.transmit > LAST_ACTIVE || self.receive > LAST_ACTIVE
    }

    /// TEC holds the lower 8 of 9 bits, so it shows 0 when 256 causes bus-off.
    pub(super) fn esr(&self) -> u32 {
        let counters = u32::from(self.transmit as u8) << 16 | u32::from(self.receive.min(255)) << 24;
        self.status() | self.last << LEC_AT | counters
    }

    fn status(&self) -> u32 {
        let warns = self.transmit >= WARNING || self.receive >= WARNING;
        [(EWGF, warns), (EPVF, self.is_passive()), (BOFF, self.is_off)]
            .iter()
            .fold(0, |bits, (bit, is_set)| if *is_set { bits | bit } else { bits })
    }

    pub(super) fn transmitted(&mut self) {
        self.transmit = self.transmit.saturating_sub(1);
        self.last = 0;
    }

    pub(super) fn received(&mut self) {
        self.receive =
            if self.receive > LAST_ACTIVE { PASSIVE_RETURN } else { self.receive.saturating_sub(1) };
        self.last = 0;
    }

    pub(super) fn transmit_error(&mut self, why: ErrorCode) {
        self.last = why as u32;
        // ISO 11898-1: an error-passive transmitter does not count missing acknowledgements.
        if why != ErrorCode::Acknowledgement || self.transmit <= LAST_ACTIVE {
            self.transmit += 8;
        }
        self.is_off |= self.transmit > LAST_ON;
    }

    pub(super) fn receive_error(&mut self, why: ErrorCode) {
        self.last = why as u32;
        self.receive = (self.receive + 1).min(LAST_ON);
    }

    /// Initialisation mode was entered and left (46.7.6).
    pub(super) fn begin_recovery(&mut self) {
        if self.is_off {
            self.to_recover = Some(RECOVERY);
        }
    }

    /// Counts received sequences of 11 recessive bits.
    pub(super) fn heard_recessive(&mut self, sequences: u32) {
        let Some(left) = &mut self.to_recover else { return };
        *left = left.saturating_sub(sequences);
        if *left == 0 {
            *self = Self { last: self.last, ..Self::new() };
        }
    }
}
