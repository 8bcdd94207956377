//! State bits of EFLG (register 6-3).

use crate::can_controller::Confinement;

pub(super) const TXBO: u8 = 1 << 5;
pub(super) const TXEP: u8 = 1 << 4;
pub(super) const RXEP: u8 = 1 << 3;
pub(super) const TXWAR: u8 = 1 << 2;
pub(super) const RXWAR: u8 = 1 << 1;
pub(super) const EWARN: u8 = 1 << 0;

/// Returns the state bits.
pub(super) fn flags(&Confinement { transmit, receive, is_off, .. }: &Confinement) -> u8 {
    let states = [
        (TXBO, is_off),
        (TXEP, Confinement::is_passive(transmit)),
        (RXEP, Confinement::is_passive(receive)),
        (TXWAR, Confinement::warns(transmit)),
        (RXWAR, Confinement::warns(receive)),
        (EWARN, Confinement::warns(transmit.max(receive))),
    ];
    states.iter().fold(0, |bits, (bit, is_set)| if *is_set { bits | bit } else { bits })
}
