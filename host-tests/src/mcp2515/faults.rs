//! Error counters and fault confinement (6.0; ISO 11898-1).

use crate::can_controller::ErrorCode;

/// State bits of EFLG (register 6-3).
pub(super) const TXBO: u8 = 1 << 5;
pub(super) const TXEP: u8 = 1 << 4;
pub(super) const RXEP: u8 = 1 << 3;
pub(super) const TXWAR: u8 = 1 << 2;
pub(super) const RXWAR: u8 = 1 << 1;
pub(super) const EWARN: u8 = 1 << 0;

/// Counter limits: first value with a warning, last error-active value, last value before bus-off.
const WARNING: u16 = 96;
const LAST_ACTIVE: u16 = 127;
const LAST_ON: u16 = 255;

/// Value of the receive counter after a success while error passive (ISO 11898-1: 119 to 127).
const PASSIVE_RETURN: u16 = 120;

/// Sequences of 11 recessive bits that end bus-off without a request (6.6).
const RECOVERY: u32 = 128;

#[derive(Clone, Debug, Default)]
pub(super) struct Faults {
    transmit: u16,
    receive: u16,
    /// Remaining sequences until bus-off ends.
    to_recover: Option<u32>,
}

impl Faults {
    pub(super) const fn is_off(&self) -> bool {
        self.to_recover.is_some()
    }

    pub(super) fn transmit(&self) -> u8 {
        self.transmit.min(LAST_ON) as u8
    }

    pub(super) fn receive(&self) -> u8 {
        self.receive as u8
    }

    pub(super) fn flags(&self) -> u8 {
        let (transmit, receive) = (self.transmit, self.receive);
        let states = [
            (TXBO, self.is_off()),
            (TXEP, transmit > LAST_ACTIVE),
            (RXEP, receive > LAST_ACTIVE),
            (TXWAR, transmit >= WARNING),
            (RXWAR, receive >= WARNING),
            (EWARN, transmit >= WARNING || receive >= WARNING),
        ];
        states.iter().fold(0, |bits, (bit, is_set)| if *is_set { bits | bit } else { bits })
    }

    pub(super) fn transmitted(&mut self) {
        self.transmit = self.transmit.saturating_sub(1);
    }

    pub(super) fn received(&mut self) {
        self.receive =
            if self.receive > LAST_ACTIVE { PASSIVE_RETURN } else { self.receive.saturating_sub(1) };
    }

    pub(super) fn transmit_error(&mut self, why: ErrorCode) {
        // ISO 11898-1: an error-passive transmitter does not count missing acknowledgements.
        if why != ErrorCode::Acknowledgement || self.transmit <= LAST_ACTIVE {
            self.transmit += 8;
        }
        if self.transmit > LAST_ON {
            self.to_recover = Some(RECOVERY);
        }
    }

    pub(super) fn receive_error(&mut self) {
        self.receive = (self.receive + 1).min(LAST_ON);
    }

    /// Counts received sequences of 11 recessive bits.
    pub(super) fn heard_recessive(&mut self, sequences: u32) {
        let Some(left) = &mut self.to_recover else { return };
        *left = left.saturating_sub(sequences);
        if *left == 0 {
            *self = Self::default();
        }
    }
}
