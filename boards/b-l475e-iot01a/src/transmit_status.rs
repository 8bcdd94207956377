//! The status of bxCAN's three transmit mailboxes in TSR (RM0351, 46.9.2).

use wsg_bridge_fw::can::Withdrawal;

/// Number of transmit mailboxes.
pub const MAILBOXES: usize = 3;

/// Bits that are set while mailboxes 0, 1 and 2 are empty.
pub const TME: [u32; MAILBOXES] = [1 << 26, 1 << 27, 1 << 28];

/// Bits that are set if a mailbox's last frame was sent. A new request clears them, and so does writing RQCP.
const TXOK: [u32; MAILBOXES] = [1 << 1, 1 << 9, 1 << 17];

/// Returns the outcome of a frame that was aborted by ABRQ, from the value of TSR after the abort.
#[must_use]
pub fn withdrawal(tsr: u32, mailbox: usize) -> Withdrawal {
    let has = |bits: [u32; MAILBOXES]| bits.get(mailbox).is_some_and(|bit| tsr & bit != 0);
    Withdrawal::of(!has(TME), has(TXOK))
}
