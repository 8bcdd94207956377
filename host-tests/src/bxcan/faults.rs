//! ESR: error counters, state and last error code (RM0351, 46.7.6, 46.9.2).

use crate::can_controller::{Confinement, ErrorCode};

/// Bits of ESR.
const EWGF: u32 = 1 << 0;
const EPVF: u32 = 1 << 1;
const BOFF: u32 = 1 << 2;
const LEC_AT: u32 = 4;

#[derive(Clone, Debug, Default)]
pub(super) struct Faults {
    pub(super) confinement: Confinement,
    last: u32,
}

impl Faults {
    /// TEC holds the lower 8 of 9 bits, so it shows 0 when 256 causes bus-off.
    pub(super) fn esr(&self) -> u32 {
        let Confinement { transmit, receive, .. } = self.confinement;
        let states = self.confinement.states([EWGF, EPVF, BOFF]);
        states | self.last << LEC_AT | u32::from(transmit as u8) << 16 | u32::from(receive) << 24
    }

    pub(super) fn transmitted(&mut self) {
        self.confinement.transmitted();
        self.last = 0;
    }

    pub(super) fn received(&mut self) {
        self.confinement.received();
        self.last = 0;
    }

    pub(super) fn transmit_error(&mut self, why: ErrorCode) {
        self.confinement.transmit_error(why);
        self.last = why as u32;
    }

    pub(super) fn receive_error(&mut self, why: ErrorCode) {
        self.confinement.receive_error();
        self.last = why as u32;
    }
}
